"""Blinks and gaze of a face whose end is not known: `deitalk.postprocess.blinks`, frame by frame."""

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.config import Idle
from deitalk.postprocess.blinks import BLINK
from rig import ControlSet
from rig.arrays import Float32
from rig.controls import DEFAULT_ID


class RunningIdle:
    """Blinks and small motions of the gaze of one stream.

    Parameters
    ----------
    controls : ControlSet
        Columns of the curves; a rig without the board's lids stays still.
    idle : Idle
        Intervals of the blinks.
    seed : int
        Equal seeds give equal blinks.
    """

    def __init__(self, controls: ControlSet, idle: Idle, seed: int) -> None:
        self.idle, self.n_frames = idle, 0
        self.blinks, self.glances = np.random.default_rng(seed).spawn(2)
        self.blink_at = round(self.blinks.uniform(0.6, 2.5) * FRAME_RATE)
        self.glance_at, self.gaze = round(0.4 * FRAME_RATE), np.zeros(2)
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

    def _next(self) -> tuple[float, Float32]:
        if self.n_frames == self.blink_at + len(BLINK):
            spread = self.idle.interval_spread * self.blinks.standard_normal()
            seconds = max(self.idle.interval_seconds * np.exp(spread), 0.6)
            self.blink_at += max(round(seconds * FRAME_RATE), len(BLINK) + 1)
        if self.n_frames == self.glance_at:
            self.gaze = 0.3 * self.gaze + self.glances.normal(0, (0.035, 0.02))
            self.glance_at += round(self.glances.uniform(0.4, 1.6) * FRAME_RATE)
        place = self.n_frames - self.blink_at
        self.n_frames += 1
        lid = float(BLINK[place]) if 0 <= place < len(BLINK) else 0.0
        return lid, self.gaze.astype(np.float32)
