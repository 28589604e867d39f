"""The 15 Oculus visemes over time as JSON, schema ``deitalk.visemes/1``."""

import json
from pathlib import Path

import numpy as np

from rig.controls import ControlSet
from rig.conversion.visemes import OCULUS, names, weights, weights_to_curves
from rig.curves import RigCurves
from rig.errors import FormatError
from rig.formats.curves_json import read_object, write_object
from rig.formats.decimal_text import Block

SCHEMA = "deitalk.visemes/1"
DECIMALS = 4
MOST_OFF = 0.01
"""Largest distance of the sum of a row from 1: weights are rounded."""
FASTEST = 1000.0


def write(path: Path, curves: RigCurves) -> None:
    """Write one row of weights per frame; each row sums to 1."""
    head = {"schema": SCHEMA, "fps": curves.fps, "n_frames": len(curves), "names": names(OCULUS)}
    write_object(path, json.dumps(head, indent=1), {"values": Block(weights(curves), DECIMALS)})


def read(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read weights and pose the mouth: each frame is the mean of the poses by their weights.

    Raises
    ------
    FormatError
        If the file is of another schema, names other visemes, or a row does not sum to 1.
    """
    data = read_object(path, SCHEMA)
    rate, values = data.get("fps"), data.get("values")
    if data.get("names") != list(names(OCULUS)):
        raise FormatError(f"{path} needs 'names' {', '.join(names(OCULUS))}")
    if not isinstance(rate, (int, float)) or not 0 < rate <= FASTEST:
        raise FormatError(f"{path}: 'fps' is {rate!r}; it must be above 0, at most {FASTEST:g}")
    try:
        with np.errstate(over="ignore"):  # a sum that is not 1
            shares = np.array(values, dtype=np.float32)
    except (TypeError, ValueError, OverflowError):
        shares = np.empty(0, np.float32)
    if shares.ndim != 2 or shares.shape[1] != len(names(OCULUS)):
        raise FormatError(f"{path}: 'values' must be rows of {len(names(OCULUS))} numbers")
    off = ~((np.abs(shares.sum(axis=1) - 1) <= MOST_OFF) & (shares >= 0).all(axis=1))
    if off.any():
        raise FormatError(f"{path}: data row {int(np.argmax(off)) + 1} does not sum to 1")
    return weights_to_curves(shares, fps or float(rate))
