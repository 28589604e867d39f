"""What somebody changed in curves by hand, as a layer of few keys."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np

from rig.arrays import Float32
from rig.controls import ControlSet, default_controls
from rig.curves.apply_layers import Closures, apply_layers
from rig.curves.layers import HEAD_TARGETS, Edit, Layer
from rig.curves.rig_curves import RigCurves
from rig.errors import CurveError
from rig.unreal.deitalk_clip import fit_segment, split_curve

TOLERANCE: Final = 0.01
"""How far curves with the layer may be from the edited ones."""
NOISE_SHARE, FIT_SHARE = 0.5, 0.4
"""Shares of the tolerance: for what is no change, and for a cubic between keys."""
GAP_SECONDS = 0.2
"""Unchanged time between two changes of a control that are one edit."""
HEAD_UNITS = 10.0
"""Degrees or cm that count as 1 of a control."""


def layer_of_changes(
    base: RigCurves,
    edited: RigCurves,
    controls: ControlSet | None = None,
    closures: Closures | None = None,
    tolerance: float = TOLERANCE,
) -> Layer:
    """The layer that makes edited curves of others, but for changes as small as noise.

    Each change is an offset within its own span. One that `apply_layers` would take back where
    lips meet owns its control.

    Parameters
    ----------
    base, edited : RigCurves
        All controls of the set in its order, with one rate; where one is longer, its end is not
        compared. The head is compared where both have it.
    controls : ControlSet, optional
        The default board.
    closures : Closures, optional
        Those with which the layer will be applied.
    tolerance : float
        In units of the controls; changes up to half of it are noise.

    Raises
    ------
    CurveError
        If rates or controls differ.
    """
    controls = controls or default_controls()
    if base.fps != edited.fps or base.names != edited.names or base.names != controls.names:
        raise CurveError(
            "the edited curves have another rate or other controls; convert them first"
        )
    count = min(len(base), len(edited))
    base, edited = base[:count], edited[:count]
    found: list[Edit] = []
    columns = list(zip(base.names, base.values.T, edited.values.T, strict=True))
    if base.head is not None and edited.head is not None:
        columns += zip(HEAD_TARGETS, base.head.T, edited.head.T, strict=True)
    for name, was, now in columns:
        unit = HEAD_UNITS if name in HEAD_TARGETS else 1.0
        found += _edits(name, now - was, base.fps, tolerance * unit)
    found.sort(key=lambda edit: (edit.span[0], edit.target))
    layer = Layer(tuple(found))
    if closures is None or not found:
        return layer
    applied, _ = apply_layers(base, [layer], controls, closures)
    beyond = np.abs(applied.values - edited.values) > tolerance
    edits = []
    for edit in found:  # those of which the closures would take a part back own their control
        first, last = (round(second * base.fps) for second in edit.span)
        is_of_head = edit.target in HEAD_TARGETS
        owns = not is_of_head and beyond[first : last + 1, base.index(edit.target)].any()
        edits.append(replace(edit, owns=bool(owns)))
    return Layer(tuple(edits))


def _edits(name: str, change: Float32, fps: float, tolerance: float) -> Iterator[Edit]:
    """Edits of one control for its change [shape=(T,)]."""
    frames = np.flatnonzero(np.abs(change) > NOISE_SHARE * tolerance)
    if not len(frames):
        return
    breaks = np.flatnonzero(np.diff(frames) > max(round(GAP_SECONDS * fps), 2)) + 1
    for first, last in pairwise([0, *breaks.tolist(), len(frames)]):
        yield _edit(name, change, int(frames[first]), int(frames[last - 1]), fps, tolerance)


def _edit(name: str, change: Float32, first: int, last: int, fps: float, tolerance: float) -> Edit:
    """One edit: the change between two frames, 0 in the frames beside them."""
    start, stop = max(first - 1, 0), min(last + 1, len(change) - 1)
    values = change[start : stop + 1].tolist()
    if start < first:
        values[0] = 0.0
    if stop > last:
        values[-1] = 0.0
    frames = split_curve(
        [len(values) - 1] if len(values) > 1 else [],
        FIT_SHARE * tolerance,
        lambda a, b: fit_segment(values, a, b),
    )
    keys = tuple(
        ((start + frame) / fps, values[frame], arrive * fps, leave * fps)
        for frame, arrive, leave in frames
    )
    return Edit(name, keys, "offset", (start / fps, stop / fps))
