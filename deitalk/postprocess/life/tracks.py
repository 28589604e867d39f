"""Shapes over time that the parts share: swells of events, slow noise, fades at the ends.

All are given for consecutive frames, and do not depend on how a stream is divided.

Letters: T frames at 30 per second, n frames of a call, K channels.
"""

import hashlib
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from rig.arrays import Float32, Float64

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


RISE_SECONDS, FADE_SECONDS = 0.5, 0.9
"""Motion begins at rest with a take, and comes to rest before its end."""
STILL_SECONDS = 0.5
"""Rest at the end, but for a silence that is too short for it."""
CUT_SECONDS = 0.2
"""Silence at the end below which a take counts as cut."""
BLOCK_FRAMES = 64
"""Frames of noise that are drawn at once."""


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

    def at(self, first: int, count: int) -> Float64:
        """Their sum in the next frames [shape=(n, K)]."""
        rows, stop = np.zeros((count, self.channels)), first + count
        for swell in self.swells:
            begin = max(int(swell.begin * FRAME_RATE), first)
            end = min(int(swell.end * FRAME_RATE) + 2, stop)
            if begin < end:
                time = np.arange(begin, end) / FRAME_RATE - swell.begin
                share = time / swell.attack, (swell.end - swell.begin - time) / swell.decay
                rise, fall = np.minimum(np.maximum(share, 0), 1)
                shape = 0.25 * (1 - np.cos(np.pi * rise)) * (1 - np.cos(np.pi * fall))
                rows[begin - first : end - first] += shape[:, None] * swell.heights
        self.swells = [swell for swell in self.swells if swell.end * FRAME_RATE >= stop]
        return rows


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


def presence(first: int, count: int, end: float, silence: float) -> Float64:
    """Share of the motion shown: 0 at the start of a take and in silence at its end [shape=(n,)].

    Parameters
    ----------
    first, count : int
        The frames.
    end : float
        Seconds of the take's last frame; infinite if it is not known.
    silence : float
        Seconds without speech at the end; a take that is cut in its speech keeps its motion.
    """
    is_cut = math.isinf(end) or silence <= CUT_SECONDS
    if is_cut and first > RISE_SECONDS * FRAME_RATE:
        return np.ones(count)
    time = (first + np.arange(count)) / FRAME_RATE
    rise = np.clip(time / RISE_SECONDS, 0, 1)
    shape: Float64 = rise * rise * (3 - 2 * rise)
    if not is_cut:
        still = min(STILL_SECONDS, silence / 3)
        fade = np.clip((end - time - still) / min(FADE_SECONDS, silence - still), 0, 1)
        shape *= fade * fade * (3 - 2 * fade)
    return shape
