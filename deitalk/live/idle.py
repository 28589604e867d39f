"""Blinks and gaze of a face whose end is not known.

A plain form of `deitalk.postprocess.life`, which places its events on a voice that is known.
"""

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.config import Idle
from deitalk.postprocess.life.blinks import LEAST_INTERVAL, Blink
from rig import ControlSet
from rig.arrays import Float32, Float64
from rig.controls import DEFAULT_ID

CLOSING, HELD, OPENING = 0.1, 0.034, 0.17
"""Seconds of a blink."""
FIRST_SECONDS = (0.6, 2.5)
"""The first blink comes so long after the start."""
FIXATION_SECONDS = (0.4, 1.6)
GAZE_SPREAD = (0.035, 0.02)
"""Standard deviation of a glance left-right and up-down, in control units."""
RETURN = 0.3
"""Share of a glance that is left at the next."""


class RunningIdle:
    """Blinks and small motions of the gaze of one stream.

    Parameters
    ----------
    controls : ControlSet
        Columns of the curves; a rig without the board's lids stays still.
    idle : Idle
        Intervals of the blinks, and factors.
    seed : int
        Equal seeds give equal motion.
    """

    def __init__(self, controls: ControlSet, idle: Idle, seed: int) -> None:
        self.idle, self.n_frames = idle, 0
        self.blinks, self.glances = np.random.default_rng(seed).spawn(2)
        self.blink = _blink(self.blinks.uniform(*FIRST_SECONDS))
        self.glance_at, self.gaze = 0.4, np.zeros(2)
        self.moves = controls.id == DEFAULT_ID
        if self.moves:
            self.lids = [controls.index(f"CTRL_{side}_eye_blink.ty") for side in "LR"]
            self.eyes = [[controls.index(f"CTRL_{s}_eye.t{axis}") for axis in "xy"] for s in "LR"]

    def add_to(self, curves: Float32) -> None:
        """Add the motion of the next frames, in place [shape=(n, C)]."""
        for row in curves if self.moves else ():
            lid, gaze = self._next()
            row[self.lids] += lid * (1 - row[self.lids])
            for eye in self.eyes:
                row[eye] += gaze

    def _next(self) -> tuple[float, Float64]:
        time = self.n_frames / FRAME_RATE
        self.n_frames += 1
        if time >= self.blink.end:
            spread = self.idle.interval_spread * self.blinks.standard_normal()
            interval = self.idle.interval_seconds * np.exp(spread) / max(self.idle.blinks, 0.05)
            self.blink = _blink(max(self.blink.time + max(interval, LEAST_INTERVAL), time))
        if time >= self.glance_at:
            self.gaze = RETURN * self.gaze + self.glances.normal(0, GAZE_SPREAD)
            self.glance_at += self.glances.uniform(*FIXATION_SECONDS)
        lid = float(self.blink.closure(np.array([time]))[0]) if self.idle.blinks else 0.0
        return lid, self.gaze * self.idle.gaze


def _blink(time: float) -> Blink:
    return Blink(time, CLOSING, HELD, OPENING, 1.0)
