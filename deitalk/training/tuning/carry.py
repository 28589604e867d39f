"""How much of each control of the base is in each of another rig: what carries its emotions.

Of a public rig it follows from the conversion of curves (`rig.conversion`), at the face at rest; of
a user's own from their table of the rig's curves to board, raw curves or ARKit
(`deitalk.data.captures.columns`), whose inverse of least squares it is. Nothing else tells which
control of an unknown rig is a brow: neutral speech hardly moves one.
"""

import numpy as np

from deitalk.data.captures.columns import RigMapping, describe_columns
from deitalk.errors import DataError
from rig import ControlSet, RigCurves
from rig.arrays import Float64
from rig.controls import DEFAULT_ID
from rig.conversion.convert import KNOWN, convert, known_controls

STEP = 0.5
"""Share of a control's range by which it is moved from rest."""
LEAST = 1e-3
"""Least share that counts; smaller ones are rounding of a conversion's fit."""
CONFIDENT = 0.05
"""Penalty of the inverse, over the largest square of the table's weights."""


def carry_matrix(
    base: ControlSet, controls: ControlSet, mapping: RigMapping | None = None
) -> Float64 | None:
    """Shares of the base's controls in those of a rig [shape=(C, base)].

    Parameters
    ----------
    base, controls : ControlSet
        Of the base model, and of the captures.
    mapping : RigMapping or None
        The user's table from curves of the rig to a known set.

    Returns
    -------
    array or None
        None where nothing relates the two.

    Raises
    ------
    DataError
        If the table names curves that the rig has not.
    """
    if base.names == controls.names:
        return np.eye(len(base))
    if base.id != DEFAULT_ID:
        return None
    if mapping is not None:
        # Shares of the board in the targets of a table.
        target = KNOWN[mapping.control_set]()
        slopes = _slopes(base, target)
        return (
            _inverse(mapping, controls) @ slopes[[target.index(name) for name in mapping.targets]]
        )
    known = known_controls(controls.id)
    if known is None or known.names != controls.names:
        return None
    return _slopes(base, known)


def _slopes(base: ControlSet, target: ControlSet) -> Float64:
    """Change of a known set's controls by each of the board's, at rest."""
    if base.id == target.id:
        return np.eye(len(base))
    up = base.maximum > base.rest
    steps = STEP * np.where(up, base.maximum - base.rest, base.minimum - base.rest)
    rows = np.concatenate((base.rest[None], base.rest + np.diag(steps))).astype(np.float32)
    curves = RigCurves(rows, base.names, 30.0, control_set=base.id)
    moved = convert(curves, target.id).reorder(target).values.astype(np.float64)
    slopes = (moved[1:] - moved[0]).T / np.where(steps == 0, 1, steps)
    return np.where(np.abs(slopes) < LEAST, 0, slopes)


def _inverse(mapping: RigMapping, controls: ControlSet) -> Float64:
    """Curves of the rig that give the targets of a table, nearest to none [shape=(C, targets)]."""
    unknown = sorted(mapping.sources - set(controls.names))
    if unknown:
        raise DataError(
            f"{mapping.path}: {describe_columns(unknown)} is no control of {controls.id}; mend "
            "the table",
            parameter="mapping",
        )
    table = np.zeros((len(mapping.targets), len(controls)))
    for row in mapping.rows:
        for name in row.sources:
            share = row.weight / len(row.sources)
            table[mapping.targets.index(row.target), controls.index(name)] += share
    penalty = CONFIDENT * np.square(table).max() * np.eye(len(table))
    return np.asarray(np.linalg.solve(table @ table.T + penalty, table).T)
