"""Accents of brows, lids and cheeks of a voice that has not ended.

The causal form of `deitalk.postprocess.life.brows`. An accent is known a frame or two after its
peak (`deitalk.live.voice`); the look-ahead of the curves makes up for that, and the brows begin to
rise near the accent instead of before it. Questions, which end with their rise, are not known in
time.

Letters: n frames of a call, K stems of control names.
"""

import numpy as np

from deitalk.live.tracks import RunningNoise, RunningSwells, begun
from deitalk.live.voice import VoiceRow
from deitalk.postprocess.life.brows import (
    ATTACK_SECONDS,
    DECAY_SECONDS,
    DRIFT,
    DRIFT_SECONDS,
    EVENT_SIDE,
    HOLD_SECONDS,
    TAKEN_SHARE,
    BrowEvents,
)
from deitalk.postprocess.life.traits import Traits
from rig.arrays import Float64


class RunningBrows:
    """Motion of one stream above the eyes, before the emotion decides what moves.

    Parameters
    ----------
    traits : Traits
        Of the character.
    rng : numpy.random.Generator
        Equal generators give equal motion.
    """

    def __init__(self, traits: Traits, rng: np.random.Generator) -> None:
        self.traits, self.swells = traits, RunningSwells(2)
        self.events, drift = rng.spawn(2)
        self.drift = RunningNoise(DRIFT, DRIFT_SECONDS, drift)

    def begin(self, row: VoiceRow, time: float) -> None:
        """Begin the motion of a frame's accent, if it has one."""
        if not row.accent:
            return
        is_taken = self.events.random() < TAKEN_SHARE[0] + TAKEN_SHARE[1] * row.accent
        spans = (ATTACK_SECONDS, HOLD_SECONDS, DECAY_SECONDS)
        attack, hold, decay = (float(self.events.uniform(*span)) for span in spans)
        height = (0.25 + 0.75 * row.accent) * self.events.uniform(0.7, 1.2)
        uneven = EVENT_SIDE * self.events.standard_normal()
        uneven = self.traits.side + float(np.clip(uneven, -0.15, 0.15))
        if is_taken:
            sides = height * np.array([1 + uneven / 2, 1 - uneven / 2])
            self.swells.begin(time, (attack, hold, decay), sides)

    def at(self, time: float) -> Float64:
        """Swells of the left and the right, and the drift of each stem [shape=(2 + K,)]."""
        shown = begun(time)
        accents = self.traits.brow_range * (1 - np.exp(-self.swells.at(time)))
        return np.concatenate((accents, self.drift.next())) * shown


def brow_events(rows: Float64) -> BrowEvents:
    """Events of consecutive frames (n, 2 + K)."""
    return BrowEvents(rows[:, :2], np.zeros(len(rows)), rows[:, 2:])
