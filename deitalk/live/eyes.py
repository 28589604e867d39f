"""Blinks and gaze of a face whose end is not known.

The causal form of `deitalk.postprocess.life.blinks` and `gaze`: a blink that is near is drawn to
the end of a phrase when that is known, 0.2 s after it; the gaze is averted when a phrase begins or
a pause has lasted.
"""

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.config import Idle
from deitalk.live.voice import VoiceRow
from deitalk.postprocess.life.blinks import (
    DOUBLE_SECONDS,
    DOUBLE_SHARE,
    DRAWN_SECONDS,
    DRAWN_SHARE,
    FIRST_SECONDS,
    LEAST_INTERVAL,
    SIDE_SPREAD,
    Blink,
    draw_blink,
)
from deitalk.postprocess.life.gaze import (
    AVERSION_SECONDS,
    FACE_DEGREES,
    FIXATION_SECONDS,
    LEAST_BETWEEN,
    MICRO_DEGREES,
    MICRO_PER_SECOND,
    PAUSE_SHARE,
    START_SHARE,
    WITHIN_SHARE,
    draw_direction,
    draw_wait,
)
from deitalk.postprocess.life.traits import Traits
from rig.arrays import Float64

AVERTED_PAUSE = 0.45
"""Seconds of a pause after which the gaze may be averted."""
SACCADE = 0.75
"""Share of a turn of the eyes within a frame: the largest take two or three."""


class RunningEyes:
    """Lids and gaze of one stream.

    Parameters
    ----------
    idle : Idle
        Intervals of the blinks.
    factor : float
        On the intervals.
    traits : Traits
        Of the character.
    rng : numpy.random.Generator
        Equal generators give equal motion.
    """

    def __init__(self, idle: Idle, factor: float, traits: Traits, rng: np.random.Generator) -> None:
        self.idle, self.factor, self.traits = idle, factor, traits
        self.blinks, self.gazes = rng.spawn(2)
        self.blink = draw_blink(self.blinks.uniform(*FIRST_SECONDS), self.blinks)
        self.second: float | None = None
        """Time of the second one of a double blink."""
        self.uneven = 0.0
        self.averted: tuple[float, Float64] | None = None
        """End of an aversion, and its direction."""
        self.free_at, self.fixation_at = 0.0, 0.3
        self.within_at = 0.0
        """Time of the next aversion within a phrase, if it lasts until then."""
        self.target, self.micro, self.gaze = np.zeros(2), np.zeros(2), np.zeros(2)

    def begin(self, row: VoiceRow, time: float) -> None:
        """Begin the events of a frame."""
        if row.ends:
            is_near = 0 < self.blink.time - time < DRAWN_SECONDS
            if self.blinks.random() < DRAWN_SHARE and is_near:
                self.blink = self.blink._replace(time=time)
        goes_on = row.pause == 0 and self.within_at > 0 and time >= self.within_at
        if row.begins or goes_on:
            self.within_at = time + draw_wait(self.gazes)
            self._avert(time, START_SHARE if row.begins else WITHIN_SHARE)
        elif round(row.pause * FRAME_RATE) == round(AVERTED_PAUSE * FRAME_RATE):
            self._avert(time, PAUSE_SHARE)

    def _avert(self, time: float, share: float) -> None:
        """Begin an aversion, so often."""
        length = AVERSION_SECONDS[0] * np.exp(AVERSION_SECONDS[1] * self.gazes.standard_normal())
        is_drawn = self.gazes.random() < share
        direction = np.array(draw_direction(self.gazes, self.traits.avoids))
        if is_drawn and time >= max(self.free_at, 0.3):
            self.averted, self.fixation_at = (time + length, direction), time
            self.free_at = time + length + LEAST_BETWEEN

    def at(self, time: float) -> Float64:
        """Closure of both lids, and degrees to the left and up, each frame once [shape=(4,)]."""
        return np.concatenate((self._lids(time), self._gaze(time)))

    def _lids(self, time: float) -> Float64:
        while time >= self.blink.end:
            self.blink = self._next_blink()
        sides = 1 + self.uneven * np.array([1, -1])
        return np.clip(self.blink.closure(np.array([time])) * sides, 0, 1)

    def _next_blink(self) -> Blink:
        """Draw the blink after the one that has ended."""
        last, rng = self.blink, self.blinks
        if self.second is None and rng.random() < DOUBLE_SHARE:
            self.second = last.time + float(rng.uniform(*DOUBLE_SECONDS))
            new = draw_blink(max(self.second, last.end), rng)
        else:
            self.second = None
            spread = self.idle.interval_spread * rng.standard_normal()
            interval = self.idle.interval_seconds * np.exp(spread) * self.factor
            new = draw_blink(max(last.time + max(interval, LEAST_INTERVAL), last.end), rng)
        self.uneven = SIDE_SPREAD * rng.standard_normal() if new.depth < 1 else 0.0
        return new

    def _gaze(self, time: float) -> Float64:
        rng = self.gazes
        if self.averted is not None and time >= self.averted[0]:
            self.averted, self.fixation_at = None, time
        if time >= self.fixation_at:
            if self.averted is None:
                self.target = rng.normal(0, FACE_DEGREES)
                spread = FIXATION_SECONDS[1] * rng.standard_normal()
                self.fixation_at = time + max(FIXATION_SECONDS[0] * np.exp(spread), 0.3)
            else:
                self.target = self.averted[1] + rng.normal(0, 0.5, 2)
                self.fixation_at = time + rng.uniform(0.4, 1.1)
        if rng.random() < MICRO_PER_SECOND / FRAME_RATE:
            self.micro = 0.4 * self.micro + rng.normal(0, MICRO_DEGREES, 2)
        self.gaze = self.gaze + SACCADE * (self.target + self.micro - self.gaze)
        return self.gaze
