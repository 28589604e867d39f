"""Layers on curves."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rig.arrays import Bool, Float32, Float64
from rig.controls import ControlSet, default_controls
from rig.curves.edit import members
from rig.curves.layers import HEAD_TARGETS, SEEN, SLACK, Edit, Layer, eased
from rig.curves.rig_curves import RigCurves
from rig.errors import listed

FRAME = 1 / 30
BESIDE = 0.07
"""Seconds: the frame before an edit in which it begins, and one by which it may miss its word."""
STEP = 0.05
"""Longest first or last piece of an edit, in seconds, that is a step and stays as long."""
APART = 1e-3
"""Least seconds between keys that were apart."""


@dataclass(frozen=True)
class Closures:
    """Which controls close and part the lips, and from which contact on lips that meet stay so.

    Parameters
    ----------
    seals : tuple of sequence of int
        Columns of the controls set that close the lips, by kind: lips together, lip on teeth.
    opening : sequence of int
        Columns of those that part them.
    begin, full : float
        Mean of a kind from which the contact is kept, and from which it is kept in full.
    """

    seals: tuple[Sequence[int], ...]
    opening: Sequence[int]
    begin: float
    full: float

    def closed(self, values: Float32) -> Float64:
        """How closed the lips are in curves of the whole set (T, C) [shape=(T,), 0 to 1]."""
        means = [values[:, list(kind)].mean(axis=1) for kind in self.seals if len(kind)]
        if not means:
            return np.zeros(len(values))
        share = (np.max(means, axis=0) - self.begin) / (self.full - self.begin)
        return eased(np.clip(share, 0, 1))


def apply_layers(
    curves: RigCurves,
    layers: Iterable[Layer],
    controls: ControlSet | None = None,
    closures: Closures | None = None,
) -> tuple[RigCurves, tuple[str, ...]]:
    """Apply layers in their order, then meet the closures again, then keep the ranges.

    Parameters
    ----------
    curves : RigCurves
        All controls of the set, in its order.
    layers : iterable of Layer
        Muted ones change nothing.
    controls : ControlSet, optional
        Ranges, rest values and regions; the default board.
    closures : Closures, optional
        Where the lips are closed before the layers, no edit lowers what closes them or raises what
        parts them, unless it owns its control there.

    Returns
    -------
    curves : RigCurves
        The tracks are kept; the head is changed by edits of it.
    notes : tuple of str
        A line on what closures took back, and on what was beyond a range.

    Raises
    ------
    ControlError
        If a target is neither a control, nor a set, nor a part of the head.
    """
    controls = controls or default_controls()
    edits = [edit for layer in layers if not layer.muted for edit in layer.edits]
    targets = {edit.target: target_columns(controls, edit.target) for edit in edits}
    columns = np.unique(np.concatenate([np.zeros(0, np.intp), *targets.values()]))
    before = curves.values[:, columns]
    values, owned = before.astype(float), np.zeros(before.shape, bool)
    head = None if curves.head is None else curves.head.copy()
    for edit in edits:
        start, end = edit.span
        rows = slice(*np.searchsorted(curves.times, (start - SLACK, end + SLACK)))
        times = curves.times[rows]
        if edit.target not in HEAD_TARGETS:
            part = (
                np.arange(rows.start, rows.stop)[:, None],
                np.searchsorted(columns, targets[edit.target]),
            )
            rest = controls.rest[targets[edit.target]]
            values[part] = edit.applied(times, values[part], rest)
            if edit.owns or edit.mode == "own":
                owned[part] |= edit.weight(times)[:, None] > 0
        elif head is not None:
            place = HEAD_TARGETS.index(edit.target)
            head[rows, place] = edit.applied(times, head[rows, [place]], 0.0)[:, 0]
    names, notes = [controls.names[column] for column in columns], []
    if closures is not None:
        met = _met(values, before, owned, columns, closures, closures.closed(curves.values))
        notes.append(_note(names, values, met, "were taken back, as lips meet there"))
        values = met
    inside = np.clip(values, controls.minimum[columns], controls.maximum[columns])
    notes.append(_note(names, values, inside, "were brought into their ranges"))
    changed = curves.values.copy()
    changed[:, columns] = np.where(values == before, before, inside)
    return replace(curves, values=changed, head=head), tuple(note for note in notes if note)


def _note(names: Sequence[str], asked: Float64, given: Float64, what: str) -> str:
    """A line on values that differ by more than `SEEN` from those that were asked for."""
    missed = np.abs(asked - given) > SEEN
    if not missed.any():
        return ""
    controls = [name for name, column in zip(names, missed.T, strict=True) if column.any()]
    return f"{int(missed.sum())} edited values of {listed(controls)} {what}"


def target_columns(controls: ControlSet, target: str) -> Any:
    """Columns of a target's controls; none of a part of the head.

    Raises
    ------
    ControlError
        If it is neither a control, nor a set, nor a part of the head.
    """
    if target in HEAD_TARGETS:
        return np.zeros(0, np.intp)
    return members(controls, target)


def _met(
    values: Float64, before: Float32, owned: Bool, columns: Any, closures: Closures, closed: Float64
) -> Float64:
    """Values without what parts lips that were closed (T,)."""
    met = values.copy()
    for place, column in enumerate(columns.tolist()):
        change = values[:, place] - before[:, place]
        if any(column in kind for kind in closures.seals):
            met[:, place] -= (1 - owned[:, place]) * closed * np.minimum(change, 0)
        elif column in closures.opening:
            met[:, place] -= (1 - owned[:, place]) * closed * change
    return met


def retimed(layer: Layer, old: Float64, new: Float64, begins: Bool, ends: Bool) -> Layer:
    """The layer on another time axis; times before its beginning are negative.

    Parameters
    ----------
    layer : Layer
        Its times are those of `old`.
    old, new : array [shape=(N,)]
        Rising seconds that belong together: linear between them, shifted before the first and
        after the last.
    begins, ends : array [shape=(N,)]
        Whether a word begins there, or ends. Of an edit that begins, or ends, up to `BESIDE`
        beyond it, what is beyond is as long as before.
    """
    given = old, new, old[begins], old[ends]
    return replace(layer, edits=tuple(_retimed(edit, *given) for edit in layer.edits))


def _retimed(edit: Edit, old: Float64, new: Float64, begins: Float64, ends: Float64) -> Edit:
    (start, end), (rise, fall) = edit.span, edit.ease
    first, last, middle = 0, len(old), (start + end) / 2
    near = begins[(start <= begins) & (begins <= min(start + BESIDE, middle))]
    if len(near):
        begun = near[np.abs(near - start - FRAME).argmin()]
        first = int(np.searchsorted(old, begun, "right")) - 1
    near = ends[(max(end - BESIDE, middle) <= ends) & (ends <= end)]
    if len(near):
        ended = near[np.abs(near - end + FRAME).argmin()]
        last = int(np.searchsorted(old, ended)) + 1
    old, new = old[first:last], new[first:last]

    def place(times: Any) -> Float64:
        beyond = np.minimum(times - old[0], 0) + np.maximum(times - old[-1], 0)
        placed: Float64 = np.interp(times, old, new) + beyond
        return placed

    times, values, arrive, leave = np.array(edit.keys, float).T
    at, gaps = place(times), np.diff(times)
    if len(gaps) and gaps[0] <= STEP:
        at[0] = at[1] - gaps[0]
    if len(gaps) and gaps[-1] <= STEP:
        at[-1] = at[-2] + gaps[-1]
    apart = APART * np.arange(len(at))  # two moments may be one in the other recording
    at = np.maximum.accumulate(at - apart) + apart
    rates = gaps / np.diff(at)
    slopes = arrive * np.append(1.0, rates), leave * np.append(rates, 1.0)
    keys = tuple(zip(*(row.tolist() for row in (at, values, *slopes)), strict=True))
    moments = place(np.array([start, end, start + rise, end - fall])).tolist()
    starts = float(at[0]) if start == times[0] else moments[0]
    stops = max(float(at[-1]) if end == times[-1] else moments[1], starts)
    risen, falls = moments[2:]
    ease = max(risen - starts, 0.0) if rise else 0.0, max(stops - falls, 0.0) if fall else 0.0
    return replace(edit, keys=keys, span=(starts, stops), ease=ease)
