"""What of a voice moves a face above the mouth: accents, stressed syllables, phrases, questions.

Letters: T frames at 30 per second.
"""

import math
from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.prosody import LEVEL_DB, PITCH_SEMITONES, Prosody
from rig.arrays import Bool, Float32, Float64
from rig.curves.edit import gaussian_smooth

JOINED_SECONDS = 0.2
"""Pauses up to this length, such as that of a stop consonant, do not part phrases."""
SYLLABLE_SECONDS = 0.08
"""Sigma of the Gaussian that smooths level and pitch: about a syllable at half its height."""
ACCENT_DISTANCE = 9
"""Least frames from accent to accent: 0.3 s, between stressed syllables of English."""
SURROUNDINGS = 45
"""Frames on either side of a peak with which it is compared."""
LEAST_PROMINENCE, FULL_PROMINENCE = 0.3, 2.0
"""Rise above its surroundings from which a peak is an accent, and that of a full one; in standard
deviations of a lively reading."""
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


class Cue(NamedTuple):
    """Something in a voice that may move a face."""

    kind: Literal["start", "end", "speech", "pause", "accent", "stress"]
    """A phrase starts, ends, or has lasted whole seconds; a pause has lasted one of `PAUSES`."""
    time: float
    """Where it is, seconds; of a pause its start."""
    known: float = -math.inf
    """Seconds of the stream at which it is known, before which nothing can move for it."""
    size: float = 0.0
    """Strength of an accent or a stress, 0 to 1; seconds that a pause or a phrase has lasted."""
    prominence: float = 0.0
    """Level and pitch of a stressed syllable, see `Voice`."""
    stop: float | None = None
    """Seconds at which the pause or the phrase ends: None if that is to come, infinite if the take
    ends with it."""
    is_question: bool = False

    def before_next(self, lead: float, after: float) -> float | None:
        """Peak of what a pause brings: so long before the next phrase, or after its own start.

        None if no phrase follows.
        """
        if self.stop is None:
            return self.time + after
        return None if math.isinf(self.stop) else self.stop - lead


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

    @property
    def silence(self) -> float:
        """Seconds after the last phrase."""
        spoken = self.phrases[-1].stop if self.phrases else 0
        return (self.n_frames - spoken) / FRAME_RATE

    def pauses(self, least: float = 0.3) -> Iterator[tuple[int, int]]:
        """Yield first frame and end of the silences of at least so many seconds."""
        edges = [0, *(edge for phrase in self.phrases for edge in phrase[:2]), self.n_frames]
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if stop - start >= least * FRAME_RATE:
                yield start, stop

    def cues(self) -> list[Cue]:
        """All that may move a face, in the order of time; known from the start."""
        found: list[Cue] = []
        for phrase in self.phrases:
            start, stop = phrase.start / FRAME_RATE, phrase.stop / FRAME_RATE
            length = stop - start
            found.append(Cue("start", start, size=length, stop=stop))
            seconds = range(1, int(length) + 1)
            found += [Cue("speech", start + k, size=k, stop=stop) for k in seconds]
            found.append(Cue("end", stop, size=length, is_question=phrase.is_question))
        for first, last in self.pauses():
            start, length = first / FRAME_RATE, (last - first) / FRAME_RATE
            end = last / FRAME_RATE if last < self.n_frames else math.inf
            found += [Cue("pause", start, size=s, stop=end) for s in pause_lengths(length)]
        for accent in self.accents:
            found.append(Cue("accent", accent.frame / FRAME_RATE, size=accent.strength))
        for frame, size in self.stresses:
            high = float(self.prominence[frame])
            found.append(Cue("stress", frame / FRAME_RATE, size=size, prominence=high))
        return sorted(found, key=lambda cue: cue.time)


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
    pitch = _standard(np.median(near, axis=1), prosody.voiced, PITCH_SEMITONES)
    level = _standard(prosody.level, prosody.active & speaking, LEVEL_DB)
    phrases = tuple(_phrases(speaking, prosody))
    prominence = np.where(speaking, (level + pitch) / np.sqrt(2), 0)
    accents = _peaks(prominence, ACCENT_DISTANCE, LEAST_PROMINENCE, FULL_PROMINENCE)
    stresses = _peaks(_sonority(prosody), STRESS_DISTANCE, LEAST_STRESS_DB, FULL_STRESS_DB)
    return Voice(
        len(speaking),
        prominence.astype(np.float32),
        tuple(accent for accent in accents if speaking[accent.frame]),
        phrases,
        tuple(stress for stress in stresses if speaking[stress.frame]),
    )


def _sonority(prosody: Prosody) -> Float64:
    """Smoothed over less than a syllable [shape=(T,)], dB."""
    sonority = prosody.sonority
    loud = np.maximum(sonority, sonority.max(initial=-np.inf) - SONORITY_DB)
    return gaussian_smooth(loud, SONORITY_SECONDS * FRAME_RATE, "mirror")


def _peaks(values: Float64, distance: int, least: float, full: float) -> list[Accent]:
    """Peaks that rise enough above their surroundings, the higher of two that are near."""
    padded = np.pad(values, 1, constant_values=-np.inf)
    tops = np.flatnonzero((values > padded[:-2]) & (values >= padded[2:]))
    is_free = np.ones(len(values) + distance, bool)
    found = []
    for top in sorted(tops.tolist(), key=lambda frame: -values[frame]):
        rise = min(_fall(values[top::-1][:SURROUNDINGS]), _fall(values[top:][:SURROUNDINGS]))
        if is_free[top] and rise >= least:
            is_free[max(top - distance + 1, 0) : top + distance] = False
            found.append(Accent(top, min(float(rise) / full, 1.0)))
    return sorted(found)


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
    rise = np.median(pitch[-last:]) - np.median(pitch[:-last])
    is_high = np.median(pitch[-last:]) > np.median(prosody.pitch[voiced])
    return bool(is_high and RISE_SEMITONES < rise < 12) and _glides(prosody.pitch, voiced)


def _glides(pitch: Float64, voiced: NDArray[np.intp]) -> bool:
    """Whether the last unbroken stretch of voiced frames rises, and has no jump."""
    broken = np.flatnonzero(np.diff(voiced) > 1)
    stretch = pitch[voiced[broken[-1] + 1 if len(broken) else 0 :]]
    stretch = stretch[-round(RISE_SECONDS[0] * FRAME_RATE) :]
    if len(stretch) < round(UNBROKEN_SECONDS * FRAME_RATE):
        return False
    rise = np.median(stretch[-3:]) - stretch.min()
    return bool(rise > RISE_SEMITONES and np.abs(np.diff(stretch)).max() < LARGEST_STEP)


def _standard(values: Float64, known: Bool, spread: float) -> Float64:
    """Deviation from the mean of the known frames, smoothed over a syllable."""
    if known.sum() < 5:
        return np.zeros(len(values))
    sigma = SYLLABLE_SECONDS * FRAME_RATE
    weight = gaussian_smooth(known.astype(float), sigma)
    deviation = np.clip(values - values[known].mean(), -3 * spread, 3 * spread)
    smooth = gaussian_smooth(np.where(known, deviation, 0.0), sigma)
    standard: Float64 = smooth / (weight + 0.05) / spread
    return standard
