"""Gates and motion of a voice that has not ended, on frames that come one after another."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.vocal_strength import LEVEL_DB, PITCH_SEMITONES, VOICED
from deitalk.audio.voice_activity import (
    BAND_EDGES_HZ,
    CLEAN_DB,
    FLOOR_PERCENTILE,
    FLOOR_SECONDS,
    KEEP_DB,
    LONGEST_CLOSURE,
    LONGEST_DROWNED,
    NOISY_DB,
    OPEN_DB,
    SHORT_FLOOR_DB,
    SPEECH_RANGE_DB,
    TOP_BANDS,
)
from deitalk.config.rules import Gates, Idle
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
from deitalk.postprocess.voice_intensity import Mean, Measures, expression_between, mouth_between
from rig.arrays import Bool, Float32

# Voice activity and gates of a voice that has not ended.
#
# The causal form of `deitalk.audio.voice_activity.speech_activity` and of the gates in
# `deitalk.postprocess.voice_intensity`: the noise floor is of the last 12 s, and a frame depends on
# `GATE_AHEAD` frames after it.
#
# Letters: K frequency bands, n frames of a call.

GATE_AHEAD = 5
"""Frames after a frame that its gates depend on (0.17 s)."""
FLOOR_EVERY = 10
"""Frames between two measurements of the noise floor."""
QUIET_ROWS = 5
"""Frames of a quiet room before the first one: until 1.5 s of sound they are the floor."""


class GateRows(NamedTuple):
    """Gates of consecutive frames [shape=(n,), range 0 to 1]."""

    mouth: Float32
    expression: Float32


class RunningActivity:
    """Activity of one stream, frame by frame.

    Parameters
    ----------
    gates : Gates or None
        Times of the gates; None: they stay open.
    """

    def __init__(self, gates: Gates | None) -> None:
        self.gates = gates
        keep = LONGEST_DROWNED + GATE_AHEAD + 2
        longest = gates or Gates()
        keep += max(longest.mouth_closes, longest.expression_holds + longest.expression_fades)
        self.keep = keep
        self.ring = np.full((QUIET_ROWS, len(BAND_EDGES_HZ) - 1), SHORT_FLOOR_DB - OPEN_DB)
        """Band levels of the last frames, dB."""
        self.loud = np.zeros(0)
        """How far the last frames were above the noise, dB."""
        self.on, self.is_on = np.zeros(keep - GATE_AHEAD, bool), False
        """Activity of the last frames, and of the very last."""
        self.gaps = np.zeros(0, int)
        """Longest gap that is no pause, at the frames whose gates are not known."""
        self.n_frames, self.gap = 0, LONGEST_CLOSURE
        self._measure_floor()

    def feed(self, levels: Float32) -> Bool:
        """Take the levels (n, K) of the next frames; return whether each is speech [shape=(n,)].

        Gaps are not bridged, and clicks not left out, in what is returned.
        """
        flags, at = [], 0
        while at < len(levels):
            take = FLOOR_EVERY - self.n_frames % FLOOR_EVERY
            block = levels[at : at + take]
            self.ring = np.concatenate((self.ring, block))[-round(FLOOR_SECONDS * FRAME_RATE) :]
            self.n_frames, at = self.n_frames + len(block), at + len(block)
            flags.append(self._speaking(block))
            self.gaps = np.append(self.gaps, np.full(len(block), self.gap))
            if self.n_frames % FLOOR_EVERY == 0:
                self._measure_floor()
        speaking = np.concatenate(flags) if flags else np.zeros(0, bool)
        self.on = np.append(self.on, speaking)
        return speaking

    def gate(self, count: int) -> GateRows:
        """Gates of the next `count` frames; levels of `GATE_AHEAD` more must be known."""
        gaps, self.gaps = self.gaps[:count], self.gaps[count:]
        width = self.keep + 1
        rows = np.lib.stride_tricks.sliding_window_view(self.on, width)[:count]
        self.on = self.on[count:]
        if self.gates is None:
            return GateRows(np.ones(count, np.float32), np.ones(count, np.float32))
        since, until = _distances(rows)
        bridged = since + until - 1 <= gaps
        since, until = np.where(bridged, 0, since), np.where(bridged, 0, until)
        mouth = mouth_between(since, until, self.gates, GATE_AHEAD)
        return GateRows(mouth, expression_between(since, until, self.gates, GATE_AHEAD))

    def _speaking(self, levels: Float32) -> Bool:
        above = levels - self.floor
        excess = np.sort(above, axis=1)[:, -TOP_BANDS:].mean(axis=1)
        self.loud = np.append(self.loud, excess)[-round(FLOOR_SECONDS * FRAME_RATE) :]
        flags, on = np.zeros(len(levels), bool), self.is_on
        for k, value in enumerate(excess):
            on = bool(value >= (KEEP_DB if on else OPEN_DB))
            flags[k] = on
        self.is_on = on
        return flags

    def _measure_floor(self) -> None:
        floor = np.percentile(self.ring, FLOOR_PERCENTILE, axis=0)
        loudest = np.percentile(self.ring.max(axis=1), 98)
        self.floor = np.maximum(floor, loudest - SPEECH_RANGE_DB)
        if len(self.loud):
            loud = np.percentile(self.loud, 95)
            bridged = np.interp(loud, [NOISY_DB, CLEAN_DB], [LONGEST_DROWNED, LONGEST_CLOSURE])
            self.gap = round(float(bridged))


def _distances(rows: Bool) -> tuple[Float32, Float32]:
    """Frames since the last and until the next speaking one [shape=(n,)]; inf where none.

    Rows end `GATE_AHEAD` frames after their frame. A lone frame of speech is a click.
    """
    pair = rows[:, 1:] & rows[:, :-1]
    speaking = np.zeros_like(rows)
    speaking[:, 1:] |= pair
    speaking[:, :-1] |= pair
    before, after = speaking[:, :-GATE_AHEAD][:, ::-1], speaking[:, -GATE_AHEAD - 1 :]
    since = np.where(before.any(axis=1), before.argmax(axis=1), np.inf)
    until = np.where(after.any(axis=1), after.argmax(axis=1), np.inf)
    return since.astype(np.float32), until.astype(np.float32)


# Blinks, gaze, brows, head and neck of a voice that has not ended.
#
# The motion is that of `deitalk.postprocess.life.motion`; here are its cues as they become known,
# the causal form of `deitalk.postprocess.life.voice`. An accent is a peak of level and pitch over
# their means so far, a stress one of the sonority; both are known a frame or two after the peak.
# Phrases are known when they have ended for `JOINED_SECONDS`.
#
# Letters: n frames of a call, C controls, S styles.


SMOOTHING, SONORITY_SMOOTHING = 0.4, 0.6
"""Share of a new frame in level and pitch, which smooths over a syllable, and in the sonority."""
LOUDEST_FALLS_DB = 0.75 / FRAME_RATE
"""Decrease per frame of the loudest sonority, from which `SONORITY_DB` counts."""


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
