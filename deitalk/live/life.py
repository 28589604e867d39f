"""Blinks, gaze, brows, head and neck of a voice that has not ended.

The motion is that of `deitalk.postprocess.life.motion`; here are its cues as they become known,
the causal form of `deitalk.postprocess.life.voice`. An accent is a peak of level and pitch over
their means so far, a stress one of the sonority; both are known a frame or two after the peak.
Phrases are known when they have ended for `JOINED_SECONDS`.

Letters: n frames of a call, S styles.
"""

import math
from collections.abc import Iterator

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.vocal_strength import LEVEL_DB, PITCH_SEMITONES, VOICED
from deitalk.config.rules import Idle
from deitalk.live.intensity import FORGET_FRAMES, Measures
from deitalk.postprocess.life.amounts import Life
from deitalk.postprocess.life.motion import Motion, MotionStream
from deitalk.postprocess.life.voice import (
    ACCENT_DISTANCE,
    FULL_PROMINENCE,
    FULL_STRESS_DB,
    JOINED_SECONDS,
    LEAST_PROMINENCE,
    LEAST_STRESS_DB,
    SONORITY_DB,
    STRESS_DISTANCE,
    Cue,
    Seeds,
    pause_lengths,
)
from rig.arrays import Bool, Float32

SMOOTHING, SONORITY_SMOOTHING = 0.4, 0.6
"""Share of a new frame in level and pitch, which smooths over a syllable, and in the sonority."""
LOUDEST_FALLS_DB = 0.75 / FRAME_RATE
"""Decrease per frame of the loudest sonority, from which `SONORITY_DB` counts."""


class Mean:
    """Running mean whose older values count less and less.

    Parameters
    ----------
    value : float
        At the start.
    weight : float
        Frames that it counts for.
    """

    def __init__(self, value: float = 0.0, weight: float = 0.0) -> None:
        self.value, self.weight = value, weight

    def add(self, value: float) -> float:
        """Take a value; return its distance from the mean with it."""
        self.weight = min(self.weight + 1, FORGET_FRAMES)
        self.value += (value - self.value) / self.weight
        return value - self.value


class RunningPeaks:
    """Peaks of a value that rise far enough above the lowest one since the last peak.

    Parameters
    ----------
    smoothing : float
        Share of a new frame in the value.
    distance : int
        Least frames from peak to peak.
    least, full : float
        Rise from which a peak counts, and that of a strength of 1.
    """

    def __init__(self, smoothing: float, distance: int, least: float, full: float) -> None:
        self.smoothing, self.distance, self.least, self.full = smoothing, distance, least, full
        self.value: float | None = None
        self.before = self.valley = 0.0
        self.since = distance

    def next(self, target: float) -> float:
        """Strength of a peak that was at the frame before, 0 to 1; 0 if there was none."""
        if self.value is None:
            self.value = self.before = self.valley = target
        last = self.value
        self.value += self.smoothing * (target - self.value)
        rise, is_peak = last - self.valley, self.before < last > self.value
        self.before, self.since = last, self.since + 1
        self.valley = min(self.valley, self.value)
        if not is_peak or self.since < self.distance or rise < self.least:
            return 0.0
        self.valley, self.since = self.value, 0
        return min(rise / self.full, 1.0)


class RunningVoice:
    """Cues of one stream, frame by frame.

    Parameters
    ----------
    ahead : int
        Frames by which a frame is measured before its curves are given.
    """

    def __init__(self, ahead: int) -> None:
        self.level, self.pitch = Mean(), Mean()
        self.accents = RunningPeaks(SMOOTHING, ACCENT_DISTANCE, LEAST_PROMINENCE, FULL_PROMINENCE)
        self.accents.value = 0.0
        self.stresses = RunningPeaks(
            SONORITY_SMOOTHING, STRESS_DISTANCE, LEAST_STRESS_DB, FULL_STRESS_DB
        )
        self.loudest = -100.0
        self.frame, self.ahead = 0, ahead
        self.begun: float | None = None
        """Seconds at which the phrase began; None in none."""
        self.spoken: int | None = None
        """Last frame of speech; None before any."""

    def feed(self, measures: Measures, speaking: Bool) -> Iterator[Cue]:
        """Cues that the next frames [shape=(n,)] make known."""
        for row in zip(*measures, speaking.tolist(), strict=True):
            yield from self._next(*row)
            self.frame += 1

    def _next(
        self,
        level: float,
        tilt: float,
        pitch: float,
        periodicity: float,
        sonority: float,
        speaks: bool,
    ) -> Iterator[Cue]:
        known, before = self._seconds(self.frame - self.ahead), self._seconds(self.frame - 1)
        yield from self._phrases(known, speaks)
        target = 0.0
        if speaks:
            target = self.level.add(level) / LEVEL_DB
            if periodicity > VOICED:
                target += self.pitch.add(pitch) / PITCH_SEMITONES
        if size := self.accents.next(max(-3.0, min(3.0, target / 2**0.5))):
            yield Cue("accent", before, known, size)
        self.loudest = max(self.loudest - LOUDEST_FALLS_DB, sonority)
        size = self.stresses.next(max(sonority, self.loudest - SONORITY_DB))
        if size and self.begun is not None:
            yield Cue("stress", before, known, size, self.accents.value or 0.0)

    def _phrases(self, known: float, speaks: bool) -> Iterator[Cue]:
        """Cues of phrases and pauses."""
        now = self._seconds(self.frame)
        if speaks:
            self.spoken = self.frame
            if self.begun is None:
                self.begun = now
                yield Cue("start", now, known, math.inf)
            elif _passes(length := now - self.begun, round(length)):
                yield Cue("speech", now, known, round(length))
        elif self.spoken is not None:
            start = self._seconds(self.spoken + 1)
            length = (self.frame - self.spoken) / FRAME_RATE
            if self.begun is not None and length > JOINED_SECONDS:
                yield Cue("end", start, known, start - self.begun)
                self.begun = None
            last = [*pause_lengths(length + 0.5 / FRAME_RATE)][-1:]
            yield from (Cue("pause", start, known, s) for s in last if _passes(length, s))

    def _seconds(self, frame: int) -> float:
        return max(frame, 0) / FRAME_RATE


def _passes(length: float, size: float) -> bool:
    """Whether something lasts so long just now; not at 0."""
    return size > 0 and round(length * FRAME_RATE) == round(size * FRAME_RATE)


class RunningLife:
    """Motion of one stream above the mouth.

    Parameters
    ----------
    idle : Idle
        The model's own numbers.
    life : Life
        Factors on them, and the listener's place.
    seed : int
        Equal seeds give equal motion.
    ahead : int
        Frames measured before a frame's curves are given.
    """

    def __init__(self, idle: Idle, life: Life, seed: int, ahead: int) -> None:
        self.stream = MotionStream(Seeds((0, 0, seed)), idle, life)
        self.look_at = self.stream.look_at
        self.voice = RunningVoice(ahead)
        self.speaking: Bool = np.zeros(0, bool)
        """Of the frames that were not given yet."""

    def feed(self, measures: Measures, speaking: Bool) -> None:
        """Take the voice of the next frames [shape=(n,)]."""
        for cue in self.voice.feed(measures, speaking):
            self.stream.cue(cue)
        self.speaking = np.concatenate((self.speaking, speaking))

    def take(self, mixture: Float32) -> Motion:
        """Motion of the next frames, for the emotion that is shown [shape=(n, S)]."""
        speaking, self.speaking = np.split(self.speaking, [len(mixture)])
        return self.stream.take(speaking.astype(np.float32), mixture)
