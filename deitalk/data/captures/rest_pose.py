"""The pose of an actor's face at rest, and its removal.

Captures of an uncalibrated face have a mouth a little open, a brow a little raised. A model
would learn that pose as a part of every expression. It is the median of silent frames; where an
actor is captured in several emotions, of each control the one nearest to rest, so that an
expression held in silence is not removed.

Letters: T frames, C controls.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from rig import ControlSet, RigCurves
from rig.arrays import Bool, Float32, Float64

LEAST_SECONDS = 3.0
"""Silence of an emotion from which on its pose is known."""
NOTICEABLE = 0.03
"""Distance from rest that is removed."""
NOT_REST = ("eye.tx", "eye.ty")
"""Ends of the names of gaze: where somebody looks is no pose of rest."""


def rest_pose(
    silent: Mapping[str, Float32], fps: Mapping[str, float], controls: ControlSet
) -> Float32 | None:
    """Pose of an actor at rest [shape=(C,)]; None if there is too little silence.

    Parameters
    ----------
    silent : mapping of str to array [shape=(T, C)]
        Silent frames of the actor's clips by emotion.
    fps : mapping of str to float
        Frames per second by emotion.
    controls : ControlSet
        Columns.
    """
    poses = []
    for emotion, frames in silent.items():
        if len(frames) >= LEAST_SECONDS * fps[emotion]:
            poses.append(np.median(frames, axis=0))
    if not poses:
        return None
    stacked = np.stack(poses)
    nearest = np.abs(stacked - controls.rest).argmin(axis=0)
    pose: Float32 = stacked[nearest, np.arange(len(controls))].astype(np.float32)
    small = np.abs(pose - controls.rest) < NOTICEABLE
    gaze = np.array([name.endswith(NOT_REST) for name in controls.names])
    return np.where(small | gaze, controls.rest, pose).astype(np.float32)


def without_rest(curves: RigCurves, pose: Float32, known: Bool, controls: ControlSet) -> RigCurves:
    """Return curves whose pose at rest is the controls' rest.

    Of every known control the pose goes to rest, the ends of its range stay: linear between.
    """
    values = curves.reorder(controls).values.astype(np.float64)
    low, high, rest = (
        a.astype(np.float64) for a in (controls.minimum, controls.maximum, controls.rest)
    )
    moved = np.where(
        values >= pose,
        rest + (values - pose) * _ratio(high - rest, high - pose),
        rest - (pose - values) * _ratio(rest - low, pose - low),
    )
    changed = known & (pose != controls.rest)
    result = np.where(changed, np.clip(moved, low, high), values).astype(np.float32)
    return replace(curves, values=result, names=controls.names, control_set=controls.id)


def _ratio(above: Float64, below: Float64) -> Float64:
    ratio: Float64 = np.divide(above, below, out=np.zeros_like(above), where=below > 1e-6)
    return ratio
