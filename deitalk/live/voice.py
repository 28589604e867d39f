"""What of a voice that has not ended moves a face above the mouth: accents, stresses, pauses.

The causal form of `deitalk.postprocess.life.voice`. An accent is a peak of level and pitch over
their means so far, a stress one of the sonority; both are known a frame or two after the peak.
Phrases are known when they have ended for `JOINED_SECONDS`.
"""

from typing import NamedTuple

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.prosody import LEVEL_DB, PITCH_SEMITONES, VOICED
from deitalk.live.intensity import Mean, Measures
from deitalk.postprocess.life.voice import (
    ACCENT_DISTANCE,
    FULL_PROMINENCE,
    FULL_STRESS_DB,
    JOINED_SECONDS,
    LEAST_PROMINENCE,
    LEAST_STRESS_DB,
    SONORITY_DB,
    STRESS_DISTANCE,
)
from rig.arrays import Bool

SMOOTHING, SONORITY_SMOOTHING = 0.4, 0.6
"""Share of a new frame in level and pitch, which smooths over a syllable, and in the sonority."""
LOUDEST_FALLS_DB = 0.75 / FRAME_RATE
"""Decrease per frame of the loudest sonority, from which `SONORITY_DB` counts."""


class VoiceRow(NamedTuple):
    """Events of one frame."""

    accent: float
    """Strength of an accent at the frame before, 0 to 1; 0 if there was none."""
    stress: float
    """The same of a stressed syllable."""
    prominence: float
    """Level and pitch over their means so far, in standard deviations of a lively reading."""
    pause: float
    """Seconds since the last speech; 0 in speech, and before any."""
    begins: bool
    """Whether a phrase begins."""
    ends: bool
    """Whether a phrase is known to have ended."""


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
    """Events of one stream, frame by frame."""

    def __init__(self) -> None:
        self.level, self.pitch = Mean(), Mean()
        self.accents = RunningPeaks(SMOOTHING, ACCENT_DISTANCE, LEAST_PROMINENCE, FULL_PROMINENCE)
        self.accents.value = 0.0
        self.stresses = RunningPeaks(
            SONORITY_SMOOTHING, STRESS_DISTANCE, LEAST_STRESS_DB, FULL_STRESS_DB
        )
        self.loudest = -100.0
        self.silent: int | None = None
        """Frames since the last speech; None before any."""
        self.is_phrase = False

    def feed(self, measures: Measures, speaking: Bool) -> list[VoiceRow]:
        """Events of the next frames [shape=(n,)]."""
        return [self.next(*row) for row in zip(*measures, speaking, strict=True)]

    def next(
        self,
        level: float,
        tilt: float,
        pitch: float,
        periodicity: float,
        sonority: float,
        speaks: bool,
    ) -> VoiceRow:
        """Events of the next frame."""
        target = 0.0
        if speaks:
            target = self.level.add(level) / LEVEL_DB
            if periodicity > VOICED:
                target += self.pitch.add(pitch) / PITCH_SEMITONES
        accent = self.accents.next(max(-3.0, min(3.0, target / 2**0.5)))
        self.loudest = max(self.loudest - LOUDEST_FALLS_DB, sonority)
        stress = self.stresses.next(max(sonority, self.loudest - SONORITY_DB))
        begins, ends = self._follow(speaks)
        pause = (self.silent or 0) / FRAME_RATE
        prominence = self.accents.value or 0.0
        return VoiceRow(accent, stress if self.is_phrase else 0.0, prominence, pause, begins, ends)

    def _follow(self, speaks: bool) -> tuple[bool, bool]:
        """Whether a phrase begins, and whether one has ended."""
        if speaks:
            begins, self.silent, self.is_phrase = not self.is_phrase, 0, True
            return begins, False
        if self.silent is not None:
            self.silent += 1
        ends = self.is_phrase and (self.silent or 0) > JOINED_SECONDS * FRAME_RATE
        self.is_phrase = self.is_phrase and not ends
        return False, ends
