"""Accents of brows, lids and cheeks of a voice that has not ended.

The causal form of `deitalk.postprocess.life.brows`. An accent is known a frame or two after its
peak (`deitalk.live.voice`); the look-ahead of the curves makes up for that, and the brows begin to
rise near the accent instead of before it. A frown comes half a second into a pause, whenever that
ends. Questions, which end with their rise, are not known in time.

Letters: n frames of a call, K stems of control names.
"""

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.live.tracks import RunningNoise, RunningSwells, begun
from deitalk.live.voice import VoiceRow
from deitalk.postprocess.life.brows import (
    DRIFT,
    DRIFT_SECONDS,
    FROWN_PAUSE,
    HELD_SECONDS,
    HELD_SPREAD,
    LID_DRIFT,
    LID_SECONDS,
    LIDS,
    STEMS,
    STILL_SHARE,
    BrowEvents,
    BrowMove,
    draw_accent,
    draw_frown,
)
from deitalk.postprocess.life.traits import Traits
from rig.arrays import Float64

ACCENTS, FROWNS = slice(0, 2), slice(2, 4)
SWELLS = 4
"""Accents and frowns, each on the left and the right."""
CHANNELS = SWELLS + len(STEMS) + 1
"""These, the drift of each stem and the posture."""
_SLOW = np.array([DRIFT_SECONDS] * len(STEMS) + [LID_SECONDS, HELD_SECONDS])


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
        self.traits, self.swells = traits, RunningSwells(SWELLS)
        self.events, drift = rng.spawn(2)
        self.drift = RunningNoise((*DRIFT, LID_DRIFT, HELD_SPREAD), _SLOW, drift)
        self.is_still = False
        """Whether the phrase has no accents of the brows."""

    def begin(self, row: VoiceRow, time: float) -> None:
        """Begin the motion of a frame's accent, and the frown of a pause."""
        if row.begins:
            self.is_still = bool(self.events.random() < STILL_SHARE)
        if row.accent:
            move = draw_accent(row.accent, self.traits.side, self.events)
            if not self.is_still:
                self._begin(time, move, ACCENTS)
        if round(row.pause * FRAME_RATE) == round(FROWN_PAUSE * FRAME_RATE):
            self._begin(time, draw_frown(self.traits.side, self.events), FROWNS)

    def _begin(self, time: float, move: BrowMove, places: slice) -> None:
        heights = np.zeros(SWELLS)
        heights[places] = move.sides
        self.swells.begin(time, (move.attack, move.hold, move.decay), heights)

    def at(self, time: float) -> Float64:
        """Swells of accents and frowns, drift of each stem, and posture [shape=(`CHANNELS`,)]."""
        swells = self.traits.brow_range * (1 - np.exp(-self.swells.at(time)))
        *drift, lids, posture = self.drift.next()
        drift[LIDS] += lids
        return np.array([*swells, *drift, max(1 + posture, 0.0)]) * begun(time)


def brow_events(rows: Float64) -> BrowEvents:
    """Events of consecutive frames [shape=(n, `CHANNELS`)]."""
    drift, posture = rows[:, SWELLS:-1], rows[:, -1]
    return BrowEvents(rows[:, ACCENTS], rows[:, FROWNS], np.zeros(len(rows)), drift, posture)
