"""Sound of a client to a voice as it comes, and the frames of the voice with their times."""

import asyncio
from collections import deque
from collections.abc import Callable
from math import inf
from time import monotonic

import numpy as np
import soxr

from api.compute.live import Voice
from api.errors import Problem
from deitalk.acting import LIVE_FIELDS, Acting
from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, samples_within
from deitalk.errors import ConfigError
from rig.arrays import Float32
from rig.curves import HEAD

BACKLOG_SECONDS = 5.0
"""Sound that waits; while there is more, the connection is not read."""
KEPT_FRAMES = 20 * FRAME_RATE
"""Last frames that a client may name as shown when it interrupts the voice."""


class LiveStream:
    """Sound, changes and frames of one session.

    Parameters
    ----------
    sample_rate : int
        Of the client, Hz.
    is_float : bool
        Whether samples are float32; else 16-bit integers. Both little-endian, mono.
    voice : Voice
        What animates it.
    longest : float
        Seconds that a session, and its sound, may last.
    late : callable
        Given the seconds since each frame's sound came.

    Attributes
    ----------
    end : int
        Samples at 16 kHz that have come.
    next_frame : int
        Frames that have come from the voice.
    is_whole : bool
        Whether the sound has ended.
    """

    def __init__(
        self,
        sample_rate: int,
        is_float: bool,
        voice: Voice,
        longest: float = inf,
        late: Callable[[float], object] = lambda seconds: None,
    ) -> None:
        self.sample_rate, self.is_float, self.voice = sample_rate, is_float, voice
        self.longest, self.late, self.last = longest, late, monotonic() + longest
        self.room = asyncio.Event()
        self.end = self.next_frame = 0
        self.is_whole = False
        self._kept: deque[Float32] = deque(maxlen=KEPT_FRAMES)
        self._rest = b""
        self._begin()
        self._arrivals: list[tuple[int, float]] = []

    @property
    def seconds(self) -> float:
        """Sound that has come."""
        return self.end / SAMPLE_RATE

    @property
    def backlog_seconds(self) -> float:
        """Sound whose frames have not come."""
        return self.seconds - self.next_frame / FRAME_RATE

    @property
    def n_frames(self) -> int:
        """Frames of the sound that has come."""
        return -(-self.end * FRAME_RATE // SAMPLE_RATE)

    @property
    def is_done(self) -> bool:
        """Whether all frames of the whole sound have come."""
        return self.is_whole and self.next_frame >= self.n_frames

    async def wait_for_room(self) -> None:
        """Wait while more than `BACKLOG_SECONDS` of sound have no frames."""
        while self.backlog_seconds > BACKLOG_SECONDS:
            self.room.clear()
            await self.room.wait()

    def check_length(self) -> None:
        """Refuse more of a session that has lasted too long: Problem 413."""
        if monotonic() > self.last or self.seconds > self.longest:
            raise Problem(413, f"sessions last {self.longest:g} s")

    def feed(self, data: bytes) -> None:
        """Take samples; a part of one is kept for the next call.

        Raises
        ------
        Problem
            422 for samples that are not finite.
        """
        data = self._rest + data
        size = 4 if self.is_float else 2
        whole = len(data) - len(data) % size
        self._rest = data[whole:]
        if self.is_float:
            chunk = np.frombuffer(data[:whole], "<f4").astype(np.float32)
            if not np.isfinite(chunk).all() or (np.abs(chunk) > 1e6).any():
                raise Problem(
                    422, "samples must be finite, within ±1e6; 1 is full scale", "audio_unusable"
                )
        else:
            chunk = np.frombuffer(data[:whole], "<i2").astype(np.float32) / np.float32(32768)
        chunk = self._resampler.resample_chunk(chunk)
        if len(chunk):  # messages without a sample are not kept
            self._append(chunk)

    def _begin(self) -> None:
        """Forget what the next samples would be joined to."""
        self._resampler = soxr.ResampleStream(self.sample_rate, SAMPLE_RATE, 1, dtype="float32")
        self._rest = b""

    def interrupt(self, lookahead: float, frame: int | None = None) -> None:
        """Stop the voice: the mouth shuts, silence follows; see `LiveAnimator.interrupt`.

        Parameters
        ----------
        lookahead : float
            Of the model, seconds.
        frame : int, optional
            Number of the frame that is shown; by default the one that was given last.

        Raises
        ------
        ConfigError
            If that frame was not given, or so long ago that it is not kept.
        """
        shown = None
        if frame is not None:
            first = self.next_frame - len(self._kept)
            if not first <= frame < self.next_frame:
                given = f"{first} to {self.next_frame - 1}" if self._kept else "none yet"
                raise ConfigError(f"frame {frame} must be one that was given: {given}")
            shown = self._kept[frame - first]
        self._begin()
        if self.end:
            self.end += samples_within(lookahead)
            self._arrivals.append((self.end, monotonic()))
        self.voice.interrupt(shown)

    def finish(self) -> None:
        """Take the end of the sound."""
        self._append(self._resampler.resample_chunk(np.zeros(0, np.float32), last=True))
        self.is_whole = True
        self.voice.finish()
        if self.is_done:  # no frame comes
            self.voice.frames.put_nowait(np.zeros((0, len(HEAD)), np.float32))

    def change(self, acting: Acting) -> None:
        """Act otherwise from the sound on that comes next."""
        fields = acting.model_dump(mode="json", include=acting.model_fields_set)
        self.voice.change({n: v for n, v in fields.items() if LIVE_FIELDS.get(n) == "change"})

    def come(self, frames: Float32) -> tuple[int, list[float]]:
        """Take the next frames.

        Returns
        -------
        first : int
            Number of the first of them.
        late : list of float
            Seconds since each frame's sound came.
        """
        begin, now = self.next_frame, monotonic()
        late = []
        for frame in range(begin, begin + len(frames)):  # the time of its last sample
            sample = (frame + 1) * SAMPLE_RATE // FRAME_RATE
            came = (at for end, at in self._arrivals if end >= sample)
            late.append(now - next(came, self._arrivals[-1][1]))
        self.next_frame += len(frames)
        for seconds in late:
            self.late(seconds)
        self.room.set()
        self._kept.extend(frames)
        sample = self.next_frame * SAMPLE_RATE // FRAME_RATE
        self._arrivals = [arrival for arrival in self._arrivals if arrival[0] >= sample]
        return begin, late

    def _append(self, chunk: Float32) -> None:
        self.end += len(chunk)
        self._arrivals.append((self.end, monotonic()))
        self.voice.feed(np.asarray(chunk, np.float32))
