"""What of a voice moves a face above the mouth: accents, stressed syllables, phrases, questions.

Letters: T frames at 30 per second.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deitalk.array_functions import median
from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.prosody import LEVEL_DB, PITCH_SEMITONES, Prosody
from rig.arrays import Bool, Float32, Float64, Int64
from rig.curves.filters import gaussian_smooth

JOINED_SECONDS = 0.2
"""Pauses up to this length, such as that of a stop consonant, do not part phrases."""
SYLLABLE_SECONDS = 0.06
"""Sigma of the Gaussian that smooths level and pitch: less than a syllable."""
ACCENT_DISTANCE = 16
"""Least frames from accent to accent, 0.5 s: brows that rise twice within it rise once."""
ACCENTS_PER_SECOND = 0.53
"""Most accents of speech: those of the syllables that stand out most."""
ACCENT_WEIGHTS = (0.35, 0.7, 1.4)
"""Of level, pitch and sonority; smoothed over a syllable, the latter two are higher in long ones.
A syllable's being chosen so correlates with the sum of its energy, pitch and length, measured
independently (docs/life.md): by .52 on LibriSpeech and .59 on Speechocean762, 16 sentences of each
validation reader. These numbers were chosen on training readers of both and on three others; as
many syllables that are chosen by that sum itself reach .60 to .64 there."""
MOST_DEVIATION = 3.0
"""Limit of the deviation of each, standard deviations."""
SONORITY_SPREAD_DB = 7.0
"""Standard deviation of the sonority of speech."""
USUAL_SPREAD, LEAST_SPREAD = 0.72, 0.4
"""Standard deviation of a reader's level, pitch and sonority to which they are brought, so that
none of them decides alone, and the least that they have: a monotonous voice has weak accents."""
LEAST_ACCENT, FULL_ACCENT = 1.6, 4.0
"""Weighted sum from which a syllable may stand out, and that of a full accent."""
SURROUNDINGS = 45
"""Frames on either side of a peak with which it is compared."""
SONORITY_SECONDS = 0.04
"""Sigma of the Gaussian that smooths the sonority: less than a syllable."""
SONORITY_DB = 35.0
"""Sonority further below the loudest is no speech."""
STRESS_DISTANCE = 6
"""Least frames from stressed syllable to stressed syllable."""
LEAST_STRESS_DB, FULL_STRESS_DB = 3.0, 12.0
"""Rise of the sonority above its surroundings from which a syllable is stressed, and that of a
full stress. On LibriSpeech 64 % of those found are stressed vowels of the words, within 80 ms, and
81 % of these are found."""
RISE_SEMITONES = 2.5
"""Rise of the last voiced part of a phrase that marks a question (Cruttenden 1997)."""
RISE_SECONDS = (0.5, 0.15)
"""The end of a phrase within which it rises, and its last part."""
UNBROKEN_SECONDS, LARGEST_STEP = 0.15, 4.0
"""Shortest voiced stretch at the end of a phrase that rises, and the largest step of its pitch from
frame to frame, semitones: at creaking ends the pitch found is wrong, and jumps."""


PAUSES = (0.3, 0.45, 0.5, 0.6, 0.8, 0.9, 1.2)
"""Lengths at which a pause may move a face, seconds; after them every `LISTENING_EVERY`."""
LISTENING_SECONDS, LISTENING_EVERY = 3.0, 6.0
"""Silence of at least so long is a turn of the other."""


START, SPEECH, END, PAUSE, ACCENT, STRESS = range(6)
"""Kinds of cues: a phrase starts, has lasted whole seconds, ends; a pause has lasted one of
`PAUSES`; a syllable stands out; a syllable is stressed."""


class Cues(NamedTuple):
    """What may move a face in the voices of streams, in the order in which it is known.

    All arrays have the shape (N,).
    """

    stream: Int64
    """Whose."""
    kind: Int64
    """`START` to `STRESS`."""
    time: Float64
    """Where it is, seconds; of a pause its start."""
    known: Float64
    """Seconds of the stream at which it is known, before which nothing can move for it."""
    size: Float64
    """Strength of an accent or a stress, 0 to 1; seconds that a pause or a phrase has lasted."""
    prominence: Float64
    """Level and pitch of a stressed syllable, see `Voice`."""
    stop: Float64
    """Seconds at which the pause or the phrase ends: NaN if that is to come, infinite if the take
    ends with it."""
    is_question: Bool
    """Whether a phrase ends as a question does."""

    @classmethod
    def of(cls, rows: Sequence[tuple[float, ...]]) -> "Cues":
        """Cues of rows of these numbers."""
        table = np.array(rows, np.float64).reshape(-1, len(cls._fields)).T
        stream, kind = table[:2].astype(np.int64)
        time, known, size, prominence, stop = table[2:-1]
        return cls(stream, kind, time, known, size, prominence, stop, table[-1] > 0)

    def where(self, chosen: Bool | Int64) -> "Cues":
        """Some of them: a mask, or their places."""
        parts: list[Any] = [part[chosen] for part in self]
        return Cues(*parts)

    @classmethod
    def joined(cls, parts: Sequence["Cues"]) -> "Cues":
        """Cues one after the other."""
        columns: list[Any] = [np.concatenate(part) for part in zip(*parts, strict=True)]
        return cls(*columns)

    def before_next(self, lead: Float64 | float, after: Float64 | float) -> Float64:
        """Peaks of what pauses bring: so long before the next phrase, or after their own start.

        NaN where no phrase follows.
        """
        peaks = np.where(np.isnan(self.stop), self.time + after, self.stop - lead)
        found: Float64 = np.where(np.isinf(peaks), np.nan, peaks)
        return found


def pause_lengths(seconds: float) -> Iterator[float]:
    """Lengths up to so many seconds at which a pause may move a face."""
    yield from (length for length in PAUSES if length <= seconds)
    length = LISTENING_SECONDS
    while length <= seconds:
        yield length
        length += LISTENING_EVERY


class Accent(NamedTuple):
    """A syllable that stands out."""

    frame: int
    strength: float
    """0 to 1."""


class Phrase(NamedTuple):
    """Speech between two pauses, frames."""

    start: int
    stop: int
    """Past its last frame."""
    is_question: bool


class Voice(NamedTuple):
    """Events of a recording."""

    n_frames: int
    prominence: Float32
    """Level and pitch of syllables relative to the recording's mean [shape=(T,)], in standard
    deviations of a lively reading; 0 where there is no speech."""
    accents: tuple[Accent, ...]
    """Peaks of level and pitch."""
    phrases: tuple[Phrase, ...]
    stresses: tuple[Accent, ...] = ()
    """Peaks of the sonority: more than accents, about every third of a second."""

    @property
    def speaking(self) -> Float32:
        """1 within phrases, else 0 [shape=(T,)]."""
        track = np.zeros(self.n_frames, np.float32)
        for phrase in self.phrases:
            track[phrase.start : phrase.stop] = 1
        return track

    def is_speaking(self, seconds: Float64) -> Bool:
        """Whether some times are within phrases."""
        frames = np.clip((seconds * FRAME_RATE).astype(np.int64), 0, max(self.n_frames - 1, 0))
        return self.speaking[frames] > 0

    def pauses(self, least: float = 0.3) -> Iterator[tuple[int, int]]:
        """Yield first frame and end of the silences of at least so many seconds."""
        edges = [0, *(edge for phrase in self.phrases for edge in phrase[:2]), self.n_frames]
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if stop - start >= least * FRAME_RATE:
                yield start, stop

    def cues(self) -> Cues:
        """All that may move a face, in the order of time; known from the start."""
        rows: list[tuple[float, ...]] = []

        def found(
            kind: int, time: float, size: float, stop: float = math.nan, high: float = 0.0,
            is_question: bool = False,
        ) -> None:  # fmt: skip
            rows.append((0, kind, time, -math.inf, size, high, stop, is_question))

        for phrase in self.phrases:
            start, stop = phrase.start / FRAME_RATE, phrase.stop / FRAME_RATE
            found(START, start, stop - start, stop)
            for second in range(1, int(stop - start) + 1):
                found(SPEECH, start + second, second, stop)
            found(END, stop, stop - start, is_question=phrase.is_question)
        for first, last in self.pauses():
            end = last / FRAME_RATE if last < self.n_frames else math.inf
            for size in pause_lengths((last - first) / FRAME_RATE):
                found(PAUSE, first / FRAME_RATE, size, end)
        for accent in self.accents:
            found(ACCENT, accent.frame / FRAME_RATE, accent.strength)
        for frame, size in self.stresses:
            found(STRESS, frame / FRAME_RATE, size, high=float(self.prominence[frame]))
        return Cues.of(sorted(rows, key=lambda row: row[2]))


def measure_voice(activity: Float32, prosody: Prosody) -> Voice:
    """Find accents, stressed syllables, phrases and questions.

    Parameters
    ----------
    activity : array [shape=(T,)]
        1 in speech, else 0.
    prosody : Prosody
        Of the same frames.

    Returns
    -------
    Voice
    """
    speaking = np.asarray(activity) > 0.5
    near = np.lib.stride_tricks.sliding_window_view(np.pad(prosody.pitch, 2, mode="edge"), 5)
    pitch = _standard(median(near, axis=1), prosody.voiced, PITCH_SEMITONES)
    level = _standard(prosody.level, prosody.active & speaking, LEVEL_DB)
    phrases = tuple(_phrases(speaking, prosody))
    sonority = _sonority(prosody)
    loud = _standard(sonority, prosody.active & speaking, SONORITY_SPREAD_DB)
    own = [_of_own(track, speaking) for track in (level, pitch, loud)]
    weighted = np.dot(ACCENT_WEIGHTS, own)
    stresses = _peaks(sonority, STRESS_DISTANCE, LEAST_STRESS_DB, FULL_STRESS_DB)
    return Voice(
        len(speaking),
        np.where(speaking, (level + pitch) / np.sqrt(2), 0).astype(np.float32),
        tuple(sorted(_accents(np.where(speaking, weighted, -np.inf)))),
        phrases,
        tuple(stress for stress in stresses if speaking[stress.frame]),
    )


def _of_own(track: Float64, speaking: Bool) -> Float64:
    """A track (T,) with the usual spread in its own speech."""
    spread = float(track[speaking].std()) if speaking.any() else USUAL_SPREAD
    own: Float64 = track * (USUAL_SPREAD / max(spread, LEAST_SPREAD))
    return own


def _accents(weighted: Float64) -> Iterator[Accent]:
    """Yield the highest peaks, `ACCENTS_PER_SECOND` of speech at most and one of its remainder."""
    most = math.ceil(ACCENTS_PER_SECOND * np.isfinite(weighted).sum() / FRAME_RATE)
    for top in _tops(weighted, ACCENT_DISTANCE)[:most]:
        if weighted[top] >= LEAST_ACCENT:
            yield Accent(top, min(float(weighted[top]) / FULL_ACCENT, 1.0))


def _sonority(prosody: Prosody) -> Float64:
    """Smoothed over less than a syllable [shape=(T,)], dB."""
    sonority = prosody.sonority
    loud = np.maximum(sonority, sonority.max(initial=-np.inf) - SONORITY_DB)
    return gaussian_smooth(loud, SONORITY_SECONDS * FRAME_RATE, "mirror")


def _peaks(values: Float64, distance: int, least: float, full: float) -> list[Accent]:
    """Peaks that rise enough above their surroundings, the higher of two that are near."""

    def rise(top: int) -> float:
        return min(_fall(values[top::-1][:SURROUNDINGS]), _fall(values[top:][:SURROUNDINGS]))

    tops = _tops(values, distance, lambda top: rise(top) >= least)
    return sorted(Accent(top, min(rise(top) / full, 1.0)) for top in tops)


def _tops(
    values: Float64, distance: int, counts: Callable[[int], bool] = lambda top: True
) -> list[int]:
    """Frames of peaks that count, the highest first, none nearer to a higher one."""
    padded = np.pad(values, 1, constant_values=-np.inf)
    tops = np.flatnonzero((values > padded[:-2]) & (values >= padded[2:]))
    is_free = np.ones(len(values) + distance, bool)
    found = []
    for top in sorted(tops.tolist(), key=lambda frame: -values[frame]):
        if is_free[top] and counts(top):
            is_free[max(top - distance + 1, 0) : top + distance] = False
            found.append(top)
    return found


def _fall(values: Float64) -> float:
    """How far values fall below the first before one exceeds it."""
    above = np.flatnonzero(values > values[0])
    return float(values[0] - values[: above[0] if len(above) else None].min())


def _phrases(speaking: Bool, prosody: Prosody) -> Iterator[Phrase]:
    edges = np.flatnonzero(np.diff(np.pad(speaking.astype(int), 1)))
    runs: list[list[int]] = []
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if runs and start - runs[-1][1] <= JOINED_SECONDS * FRAME_RATE:
            runs[-1][1] = stop
        else:
            runs.append([start, stop])
    for start, stop in runs:
        yield Phrase(start, stop, _rises(prosody, start, stop))


def _rises(prosody: Prosody, start: int, stop: int) -> bool:
    """Whether the pitch at the end of a phrase is higher than shortly before."""
    within, last = (round(seconds * FRAME_RATE) for seconds in RISE_SECONDS)
    voiced = start + np.flatnonzero(prosody.voiced[start:stop])
    if len(voiced) < within:
        return False
    pitch = prosody.pitch[voiced[-within:]]
    rise = median(pitch[-last:]) - median(pitch[:-last])
    is_high = median(pitch[-last:]) > median(prosody.pitch[voiced])
    return bool(is_high and RISE_SEMITONES < rise < 12) and _glides(prosody.pitch, voiced)


def _glides(pitch: Float64, voiced: NDArray[np.intp]) -> bool:
    """Whether the last unbroken stretch of voiced frames rises, and has no jump."""
    broken = np.flatnonzero(np.diff(voiced) > 1)
    stretch = pitch[voiced[broken[-1] + 1 if len(broken) else 0 :]]
    stretch = stretch[-round(RISE_SECONDS[0] * FRAME_RATE) :]
    if len(stretch) < round(UNBROKEN_SECONDS * FRAME_RATE):
        return False
    rise = median(stretch[-3:]) - stretch.min()
    return bool(rise > RISE_SEMITONES and np.abs(np.diff(stretch)).max() < LARGEST_STEP)


def _standard(values: Float64, known: Bool, spread: float) -> Float64:
    """Deviation from the mean of the known frames, smoothed over a syllable."""
    if known.sum() < 5:
        return np.zeros(len(values))
    sigma = SYLLABLE_SECONDS * FRAME_RATE
    weight = gaussian_smooth(known.astype(float), sigma)
    most = MOST_DEVIATION * spread
    deviation = np.clip(values - values[known].mean(), -most, most)
    smooth = gaussian_smooth(np.where(known, deviation, 0.0), sigma)
    standard: Float64 = smooth / (weight + 0.05) / spread
    return standard
