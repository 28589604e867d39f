"""Blinks and small motions of the gaze, from a seed.

Their times do not follow from the voice: a network that regresses blinks learns half-closed eyes.
They are left out of its training curves and added here.
"""

import numpy as np

from deitalk.config import Idle
from rig import ControlSet
from rig.arrays import Float32
from rig.controls import DEFAULT_ID

BLINK = np.array([0.0, 0.45, 0.95, 1.0, 0.75, 0.45, 0.2, 0.06, 0.0])
"""Closure of the lids at 30 Hz: shut in 0.1 s, open again in 0.17 s (Trutoiu et al. 2011)."""
IDLE_CONTROLS = ("_eye_blink.", "_eye.t")
"""Parts of the names of controls that blinks and gaze move."""
REST_SECONDS = 0.5
"""No blinks and no gaze motion so long before the end of a clip."""


def add_idle_motion(
    curves: Float32,
    controls: ControlSet,
    *,
    fps: float,
    rng: np.random.Generator,
    idle: Idle = Idle(),
) -> None:
    """Add blinks and gaze motion to curves, in place; a rig without the board's lids stays still.

    Parameters
    ----------
    curves : array [shape=(T, C)]
        Changed.
    controls : ControlSet
        Names of the columns.
    fps : float
        Frames per second.
    rng : numpy.random.Generator
        Equal generators give equal blinks, whatever the emotion.
    idle : Idle
        Intervals of the blinks.
    """
    if controls.id != DEFAULT_ID:
        return
    lids = blink_track(len(curves), fps, rng, idle)
    gaze = gaze_track(len(curves), fps, rng)
    for side in "LR":
        lid = controls.index(f"CTRL_{side}_eye_blink.ty")
        curves[:, lid] += lids * (1 - curves[:, lid])
        for axis in (0, 1):
            curves[:, controls.index(f"CTRL_{side}_eye.t{'xy'[axis]}")] += gaze[:, axis]


def blink_track(
    n_frames: int, fps: float, rng: np.random.Generator, idle: Idle = Idle()
) -> Float32:
    """Closure of the lids [shape=(T,), range 0 to 1]."""
    shape_times = np.arange(len(BLINK)) / 30
    shape = np.interp(np.arange(0, shape_times[-1] + 1 / fps, 1 / fps), shape_times, BLINK)
    track = np.zeros(n_frames, np.float32)
    time = rng.uniform(0.6, 2.5)
    while True:
        start = round(time * fps)
        if start + len(shape) > n_frames - REST_SECONDS * fps:
            return track
        track[start : start + len(shape)] = shape
        interval = idle.interval_seconds * np.exp(idle.interval_spread * rng.standard_normal())
        time += max(interval, 0.6)


def gaze_track(n_frames: int, fps: float, rng: np.random.Generator) -> Float32:
    """Small saccades, left-right and up-down, in control units [shape=(T, 2)]."""
    track = np.zeros((n_frames, 2), np.float32)
    time, gaze = 0.4, np.zeros(2)
    while time * fps < n_frames:
        gaze = 0.3 * gaze + rng.normal(0, (0.035, 0.02))
        track[round(time * fps) :] = gaze
        time += rng.uniform(0.4, 1.6)
    edge = max(int(REST_SECONDS * fps), 1)
    fade = np.clip((n_frames - edge - np.arange(n_frames)) / edge, 0, 1)
    return (track * fade[:, None]).astype(np.float32)
