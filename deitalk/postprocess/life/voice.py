"""What of a voice moves a face above the mouth: accents, stressed syllables, phrases, questions.

Letters: T frames at 30 per second.
"""

import hashlib
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.vocal_strength import LEVEL_DB, PITCH_SEMITONES, Prosody
from rig.arrays import Bool, Float32, Float64, Int64
from rig.curves.edit import gaussian_smooth

# Random numbers of a take, and the traits of its character.
#
# The seed of a take is the hash of its sound with the name of the actor, a number and the emotion:
# the same take always moves alike, two recordings, actors or emotions never do. Each part
# of the motion has its own numbers, so that one that is off changes no other.

PARTS = ("traits", "blinks", "gaze", "brows", "head", "neck")
ASYMMETRY = 0.15
"""How much stronger one side of a character moves than the other, at most: spontaneous faces are
asymmetric by 10 to 15 % (Skinner and Mullen 1991; Borod et al. 1998)."""


@dataclass(frozen=True)
class Seeds:
    """Sources of random numbers of one take.

    Parameters
    ----------
    words : tuple of int
        Hash of the sound, hash of the actor, and the caller's number.
    emotion : int
        Place of the emotion shown most, 0 for none: its events have their own times, the character
        is the same.
    """

    words: tuple[int, int, int]
    emotion: int = 0

    @classmethod
    def of(cls, waveform: Float32, actor: str, seed: int, emotion: int = 0) -> "Seeds":
        """Seeds of a recording [shape=(S,)] of an actor; equal arguments give equal ones."""
        return cls((_hash(_pcm(waveform)), _hash([actor.encode()]), seed), emotion)

    def generator(self, part: str) -> np.random.Generator:
        """Random numbers of a part of `PARTS`."""
        own = (self.emotion,) if self.emotion else ()
        return np.random.default_rng([*self.words, PARTS.index(part), *own])

    def character(self) -> np.random.Generator:
        """Random numbers of the actor, whatever the recording; of the take if there is none."""
        sound, actor, seed = self.words
        is_named = actor != _hash([b""])
        return np.random.default_rng([0 if is_named else sound, actor, seed])


@dataclass(frozen=True)
class Traits:
    """What distinguishes one character from another.

    Attributes
    ----------
    blink_interval : float
        Factor on the intervals between blinks.
    side : float, range -`ASYMMETRY` to `ASYMMETRY`
        How much stronger the left side moves than the right.
    brow_range, head_range : float
        Factors on the motion of brows and head.
    avoids : float, range -1 to 1
        Side to which the gaze is averted more often; 1 is the character's left.
    """

    blink_interval: float = 1.0
    side: float = 0.0
    brow_range: float = 1.0
    head_range: float = 1.0
    avoids: float = 0.0

    @classmethod
    def of(cls, rng: np.random.Generator) -> "Traits":
        """Draw the traits of a character."""
        sign = rng.choice((-1.0, 1.0))
        return cls(
            blink_interval=float(np.exp(rng.normal(0, 0.15))),
            side=float(sign * rng.uniform(2 / 3, 1) * ASYMMETRY),
            brow_range=float(rng.uniform(0.88, 1.12)),
            head_range=float(rng.uniform(0.92, 1.08)),
            avoids=float(rng.uniform(-0.6, 0.6)),
        )


def _pcm(waveform: Float32) -> Iterator[bytes]:
    """16-bit samples, piece by piece: an hour is 230 MB."""
    for start in range(0, len(waveform), 1 << 20):
        piece = np.rint(waveform[start : start + (1 << 20)] * 32767)
        yield np.clip(piece, -32768, 32767).astype("<i2").tobytes()


def _hash(parts: Iterable[bytes]) -> int:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return int.from_bytes(digest.digest()[:8], "little")


# Shapes over time that the parts share: swells of events, slow noise, fades at the ends.
#
# All are given for consecutive frames, and do not depend on how a stream is divided.
#
# Letters: T frames at 30 per second, n frames of a call, K channels.

ONSET_SECONDS, FADE_SECONDS = 0.5, 0.9
"""Motion begins at rest with a take, and comes to rest before its end."""
STILL_SECONDS = 0.5
"""Rest at the end, but for a silence that is too short for it."""
CUT_SECONDS = 0.2
"""Silence at the end below which a take counts as cut."""
BLOCK_FRAMES, PLAYED_FRAMES = 64, 256
"""Frames of noise that are drawn at once, and of events that are played at once."""


class Swell(NamedTuple):
    """One event."""

    begin: float
    attack: float
    hold: float
    decay: float
    """Seconds."""
    heights: Float64
    """[shape=(K,)]."""

    @property
    def end(self) -> float:
        """Seconds."""
        return self.begin + self.attack + self.hold + self.decay


class Swells:
    """Events that rise, hold and fall in raised cosines; each adds to some channels.

    Parameters
    ----------
    channels : int
        K.
    """

    def __init__(self, channels: int) -> None:
        self.channels = channels
        self.swells: list[Swell] = []

    def add(
        self,
        peak: float,
        seconds: tuple[float, float, float],
        heights: dict[int, float],
        known: float,
        shortest: float | None = None,
    ) -> None:
        """Add an event.

        Parameters
        ----------
        peak : float
            Seconds at which it is wanted to be highest.
        seconds : tuple of float
            Attack, hold and decay.
        heights : dict
            Height by channel.
        known : float
            Seconds before which it cannot begin; its peak is late then.
        shortest : float, optional
            To how many seconds the attack may be shortened for that; not at all by default.
        """
        attack, hold, decay = seconds
        least = attack if shortest is None else min(shortest, attack)
        attack = min(attack, max(peak - known, least))
        rows = np.zeros(self.channels)
        rows[list(heights)] = list(heights.values())
        self.swells.append(Swell(max(known, peak - attack), attack, hold, decay, rows))


def play_swells(swells: Sequence[Swells], first: Int64, count: int) -> Float64:
    """Sums of the events of streams in their next frames; those that are over are dropped.

    Parameters
    ----------
    swells : sequence of Swells
        Of B streams, with K channels each.
    first : array of int [shape=(B,)]
        Frame that comes next.
    count : int
        n.

    Returns
    -------
    array [shape=(B, n, K)]
    """
    found = np.zeros((len(swells), count, swells[0].channels))
    events = [event for part in swells for event in part.swells]
    if not events:
        return found
    stream = np.repeat(np.arange(len(swells)), [len(part.swells) for part in swells])
    begin, attack, hold, decay = np.array([event[:4] for event in events]).T
    heights, length = np.array([event.heights for event in events]), attack + hold + decay
    for start in range(0, count, PLAYED_FRAMES):
        stop = min(start + PLAYED_FRAMES, count)
        seconds = (first[stream, None] + np.arange(start, stop)) / FRAME_RATE - begin[:, None]
        now = np.flatnonzero((seconds[:, -1] > 0) & (seconds[:, 0] < length))
        time = seconds[now]
        rise = np.clip(time / attack[now, None], 0, 1)
        fall = np.clip((length[now, None] - time) / decay[now, None], 0, 1)
        shape = 0.25 * (1 - np.cos(np.pi * rise)) * (1 - np.cos(np.pi * fall))
        moved = shape[..., None] * heights[now, None]
        np.add.at(found[:, start:stop], stream[now], moved)
    is_over = (begin + length) * FRAME_RATE < first[stream] + count
    if is_over.any():
        for k in {*stream[is_over].tolist()}:
            after = float(first[k] + count)
            swells[k].swells = [s for s in swells[k].swells if s.end * FRAME_RATE >= after]
    return found


class Noise:
    """Noise with Gaussian spectra.

    Parameters
    ----------
    spread : sequence of float [shape=(K,)]
        Standard deviations.
    seconds : sequence of float [shape=(K,)]
        Sigmas of the Gaussians that white noise is smoothed with.
    rng : numpy.random.Generator
        Equal generators give equal noise.
    """

    def __init__(
        self, spread: Sequence[float], seconds: Sequence[float], rng: np.random.Generator
    ) -> None:
        sigmas = np.asarray(seconds) * FRAME_RATE
        self.kernels = []
        for height, sigma in zip(spread, sigmas.tolist(), strict=True):
            radius = int(4 * sigma) + 1
            kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
            kernel *= height * np.sqrt(2 * sigma * np.sqrt(np.pi)) / kernel.sum()
            self.kernels.append(kernel)
        self.margin = max(len(kernel) // 2 for kernel in self.kernels)
        self.rng, self.begin = rng, 0
        self.white = rng.standard_normal((2 * self.margin, len(sigmas)))
        self.rows: Float64 = np.zeros((0, len(sigmas)))

    def peek(self, frame: int) -> Float64:
        """Values of one frame [shape=(K,)], which may be to come."""
        self._draw(frame + 1)
        row: Float64 = self.rows[max(frame - self.begin, 0)]
        return row

    def at(self, first: int, count: int) -> Float64:
        """Values of the next frames [shape=(n, K)]."""
        self._draw(first + count)
        rows = self.rows[first - self.begin : first + count - self.begin]
        self.begin, self.rows = first + count, self.rows[first + count - self.begin :]
        return rows

    def _draw(self, stop: int) -> None:
        lacking = stop - self.begin - len(self.rows)
        if lacking <= 0:
            return
        count = -(-lacking // BLOCK_FRAMES) * BLOCK_FRAMES
        white = np.concatenate((self.white, self.rng.standard_normal((count, len(self.kernels)))))
        self.white = white[count:]
        columns = []
        for column, kernel in zip(white.T, self.kernels, strict=True):
            free = self.margin - len(kernel) // 2
            inner = column[free : len(column) - free]
            columns.append(np.convolve(inner, kernel, mode="valid"))
        self.rows = np.concatenate((self.rows, np.stack(columns, axis=1)))


def presence(
    frames: Int64, end: Float64, silence: Float64, onset: Float64 | float = ONSET_SECONDS
) -> Float64:
    """Share of the motion shown: 0 at the start of a take and in silence at its end.

    Parameters
    ----------
    frames : array of int [shape=(B, n)]
        Of B takes.
    end : array [shape=(B,)]
        Seconds of the take's last frame; infinite if it is not known.
    silence : array [shape=(B,)]
        Seconds without speech at the end; a take that is cut in its speech keeps its motion.
    onset : float or array [shape=(B,)]
        Seconds in which the motion begins; 0: it has begun before the take.

    Returns
    -------
    array [shape=(B, n)]
    """
    time, is_cut = frames / FRAME_RATE, np.isinf(end) | (silence <= CUT_SECONDS)
    still = np.minimum(STILL_SECONDS, silence / 3)
    fades = np.where(is_cut, 1, np.minimum(FADE_SECONDS, silence - still))
    left = np.where(is_cut, np.inf, end - still)[:, None] - time
    begins = np.broadcast_to(onset, end.shape)[:, None]
    begun = np.where(begins > 0, _smooth(time / np.maximum(begins, 1e-9)), 1.0)
    shape: Float64 = begun * _smooth(left / fades[:, None])
    return shape


def _smooth(share: Float64) -> Float64:
    share = np.clip(share, 0, 1)
    return share * share * (3 - 2 * share)


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
