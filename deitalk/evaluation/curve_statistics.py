"""Steps and jerk of curves, for comparison with captured curves.

Letters: T frames, C controls.
"""

from pathlib import Path

import numpy as np

from deitalk.errors import DataError
from rig import ControlSet, read_curves
from rig.arrays import Float32

MOVING = 0.02
"""Least standard deviation of a moving control."""


def smoothness(curves: Float32, fps: float = 30.0) -> dict[str, float]:
    """Steps and jerk of the controls that move.

    Parameters
    ----------
    curves : ndarray [shape=(T, C)]
        Values.
    fps : float
        Frames per second.

    Returns
    -------
    dict
        ``largest_step`` (control units per frame), ``step_p99`` (99th percentile of steps), and
        ``jerk_per_speed``: RMS of the third derivative over RMS of the first, 1/s², median of
        the controls; independent of their range.
    """
    moving = curves[:, curves.std(axis=0) > MOVING].astype(np.float64)
    if len(moving) < 4 or not moving.shape[1]:
        return {}
    steps = np.diff(moving, axis=0)
    speed = np.sqrt(np.square(steps).mean(axis=0)) * fps
    jerk = np.sqrt(np.square(np.diff(moving, 3, axis=0)).mean(axis=0)) * fps**3
    return {
        "largest_step": float(np.abs(steps).max()),
        "step_p99": float(np.percentile(np.abs(steps), 99)),
        "jerk_per_speed": float(np.median(jerk / speed)),
    }


def captured_smoothness(path: Path, controls: ControlSet) -> dict[str, float]:
    """`smoothness` of captured curves at 30 frames per second, over controls of the rig.

    Raises
    ------
    DataError
        If no control moves.
    """
    curves = read_curves(path).resample(30.0)
    places = [i for i, name in enumerate(curves.names) if name in controls.names]
    measured = smoothness(curves.values[:, places]) if places else {}
    if not measured:
        raise DataError(f"{path}: no control of {controls.id} moves; give a take of speech")
    return measured
