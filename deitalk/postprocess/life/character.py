"""Random numbers of a take, and the traits of its character.

The seed of a take is the hash of its sound with the name of the actor, a number and the emotion:
the same take always moves alike, two recordings, actors or emotions never do. Each part
of the motion has its own numbers, so that one that is off changes no other.
"""

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from rig.arrays import Float32

PARTS = ("traits", "blinks", "gaze", "face", "head")
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

    def key(self, part: str) -> int:
        """Key of the numbers of a part of `PARTS`, see `deitalk.postprocess.life.draws`."""
        own = (self.emotion,) if self.emotion else ()
        return _hash([repr((*self.words, PARTS.index(part), *own)).encode()])

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
    own : float, range 0 to 1
        How far the character has its own variants of the emotions; 0 where nobody is named, of
        whom two recordings must differ as their voices do.
    """

    blink_interval: float = 1.0
    side: float = 0.0
    brow_range: float = 1.0
    head_range: float = 1.0
    avoids: float = 0.0
    own: float = 1.0

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
