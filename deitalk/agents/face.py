"""`AgentFace`: sound of a voice agent in, curves with the sound of their time out.

A text-to-speech service gives sound faster than it is played, and the player keeps it in a queue.
So sound is passed on together with the frames that belong to it, `LiveAnimator.lookahead_seconds`
after it came; whoever plays the sound in order shows the frames in step. Between turns the face
lives on: it listens to the user.
"""

import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, samples_within
from deitalk.audio.resampling import RunningResampler
from deitalk.errors import AudioError
from deitalk.live.animator import Emotion, LiveAnimator
from rig.arrays import Float32

KEPT_SECONDS = 30
"""Frames that may still be in a player's queue when the voice is interrupted."""
IDLE_SECONDS, MOST_IDLE_SECONDS = 0.1, 0.5
"""Least and most time that an idle face is moved by at once."""
HEARD_SECONDS = 1.0
"""Sound of the user that waits for the face to be idle."""


class Piece(NamedTuple):
    """Consecutive frames, and the sound of their time."""

    first: int
    """Number of the first frame on the face's clock; after an interruption some are left out."""
    curves: Float32
    """[shape=(n, C)]"""
    head: Float32
    """Track of the head [shape=(n, 6)]: degrees and cm."""
    sound: bytes
    """16-bit mono PCM at the rate of the voice; empty while it does not speak."""


class _Turn:
    """Sound of one turn that was not passed on."""

    def __init__(self, rate: int, first: int, lead: float) -> None:
        self.rate, self.first = rate, first
        self.resampler = None if rate == SAMPLE_RATE else RunningResampler(rate)
        self.sound = bytearray(2 * round(lead * rate))  # of frames before the voice
        self.passed = 0

    def take(self, samples: Float32, *, last: bool = False) -> Float32:
        """Samples at 16 kHz."""
        return samples if self.resampler is None else self.resampler.feed(samples, last=last)

    def release(self, frame: int) -> bytes:
        """The sound before the time of a frame."""
        count = (frame - self.first) * self.rate // FRAME_RATE - self.passed
        given = bytes(self.sound[: 2 * max(count, 0)])
        del self.sound[: len(given)]
        self.passed += len(given) // 2
        return given


class AgentFace:
    """A face that speaks, is interrupted, and listens; its methods may be called from any thread.

    Parameters
    ----------
    model, emotion, fields
        As for `deitalk.LiveAnimator`.
    clock : callable
        Seconds that pass as the sound is played.

    Attributes
    ----------
    names : tuple of str
        Controls, in the order of the columns.
    fps : float
        30.
    """

    fps = float(FRAME_RATE)

    def __init__(
        self,
        model: str | Path = "live",
        emotion: Emotion = "neutral",
        *,
        clock: Callable[[], float] = monotonic,
        **fields: Any,
    ) -> None:
        self.animator = LiveAnimator(model, emotion, **fields)
        self.names = self.animator.names
        self._clock, self._lock = clock, threading.Lock()
        self._turn: _Turn | None = None
        self._fed = self._next = 0
        self._until = clock()
        """Time at which the frames that were given have been shown."""
        self._given: deque[tuple[Float32, Float32]] = deque(maxlen=KEPT_SECONDS * FRAME_RATE)
        self._heard = np.zeros(0, np.float32)
        self._ear: RunningResampler | None = None

    def set(self, **fields: Any) -> None:
        """Act otherwise from the sound on that comes next; as `LiveAnimator.set`."""
        with self._lock:
            self.animator.set(**fields)

    def speak(self, sound: bytes, rate: int, channels: int = 1) -> list[Piece]:
        """Take sound of the voice: 16-bit PCM.

        Raises
        ------
        AudioError
            If it is not whole samples, or its rate is out of range.
        """
        samples = _mono(sound, rate, channels)
        with self._lock:
            if self._turn is None or self._turn.rate != rate:
                lead = self._fed / SAMPLE_RATE - self._next / FRAME_RATE
                self._turn = _Turn(rate, self._next, lead)
            self._turn.sound += _pcm(samples)
            return self._feed(self._turn.take(samples))

    def end(self) -> list[Piece]:
        """Take the end of a turn; return the rest of its sound."""
        with self._lock:
            turn = self._turn
            if turn is None:
                return []
            rest = turn.take(np.zeros(0, np.float32), last=True)
            silence = np.zeros(samples_within(self.animator.lookahead_seconds), np.float32)
            pieces = self._feed(np.concatenate((rest, silence)))
            self._turn = None
            if turn.sound and pieces:  # less than a frame
                pieces[-1] = pieces[-1]._replace(sound=pieces[-1].sound + bytes(turn.sound))
            return pieces

    def interrupt(self) -> list[Piece]:
        """Stop the voice: frames of a mouth that shuts within 0.1 s, to be shown at once.

        Sound that was not played is to be dropped, and the frames that go with it.
        """
        with self._lock:
            self._turn, self._heard = None, np.zeros(0, np.float32)
            if not self._given:
                return []
            ahead = int(max(self._until - self._clock(), 0.0) * FRAME_RATE)
            for _ in range(min(ahead, len(self._given) - 1)):
                self._given.pop()
            shown, head = self._given[-1]
            self.animator.interrupt(shown=shown, head=head)
            self._fed += samples_within(self.animator.lookahead_seconds)
            self._until = self._clock()
            return self._pieces(self.animator.read()[0])

    def listen(self, sound: bytes, rate: int, channels: int = 1) -> None:
        """Take sound of the user, for the next call of `idle`; errors as `speak`."""
        samples = _mono(sound, rate, channels)
        with self._lock:
            if rate != SAMPLE_RATE and (self._ear is None or self._ear.sample_rate != rate):
                self._ear = RunningResampler(rate)
            if rate != SAMPLE_RATE and self._ear is not None:
                samples = self._ear.feed(samples)
            most = round(HEARD_SECONDS * SAMPLE_RATE)
            self._heard = np.concatenate((self._heard, samples))[-most:]

    def idle(self) -> list[Piece]:
        """Frames of the time since the last ones were shown, if the voice is silent.

        To be called about every `IDLE_SECONDS`. Where the sound of a turn is late, silence is
        passed on in its place.
        """
        with self._lock:
            now = self._clock()
            if now - self._until < IDLE_SECONDS:
                return []
            count = round(min(now - self._until, MOST_IDLE_SECONDS) * SAMPLE_RATE)
            if self._turn is not None:
                self._turn.sound += bytes(2 * (count * self._turn.rate // SAMPLE_RATE))
            heard, self._heard = self._heard[-count:], np.zeros(0, np.float32)
            pieces = self._feed(np.zeros(count, np.float32), heard if len(heard) else None)
            self._until = now
            return pieces

    def _feed(self, samples: Float32, heard: Float32 | None = None) -> list[Piece]:
        self._fed += len(samples)
        return self._pieces(self.animator.feed(samples, other=heard))

    def _pieces(self, curves: Float32) -> list[Piece]:
        if not len(curves):
            return []
        head, first = self.animator.heads[0], self._next
        self._next += len(curves)
        self._given.extend(zip(curves, head, strict=True))
        self._until = max(self._until, self._clock()) + len(curves) / FRAME_RATE
        sound = b"" if self._turn is None else self._turn.release(self._next)
        return [Piece(first, curves, head, sound)]


def _mono(sound: bytes, rate: int, channels: int) -> Float32:
    """Samples of 16-bit PCM, the mean of its channels."""
    if len(sound) % (2 * channels):
        raise AudioError(f"sound of {len(sound)} bytes; give {2 * channels} for each sample")
    if not 8_000 <= rate <= 192_000:
        raise AudioError(f"sample_rate={rate} must be 8000 to 192000 Hz")
    rows = np.frombuffer(sound, "<i2").reshape(-1, channels).astype(np.float32)
    mean: Float32 = rows.mean(axis=1) / np.float32(32768)
    return mean


def _pcm(samples: Float32) -> bytes:
    return np.rint(samples * 32768).clip(-32768, 32767).astype("<i2").tobytes()
