"""Sound of a client to a voice as it comes, and the frames of the voice with their times."""

from time import monotonic

import numpy as np
import soxr

from api.compute.live import Voice
from api.errors import Problem
from deitalk.acting import LIVE_FIELDS, Acting
from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from rig.arrays import Float32

BACKLOG_SECONDS = 5.0
"""Sound that waits; while there is more, the connection is not read."""


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

    Attributes
    ----------
    end : int
        Samples at 16 kHz that have come.
    next_frame : int
        Frames that have come from the voice.
    is_whole : bool
        Whether the sound has ended.
    """

    def __init__(self, sample_rate: int, is_float: bool, voice: Voice) -> None:
        self.is_float, self.voice = is_float, voice
        self.end = self.next_frame = 0
        self.is_whole = False
        self._resampler = soxr.ResampleStream(sample_rate, SAMPLE_RATE, 1, dtype="float32")
        self._rest = b""
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
                raise Problem(422, "samples must be finite, within 1", "audio_unusable")
        else:
            chunk = np.frombuffer(data[:whole], "<i2").astype(np.float32) / np.float32(32768)
        self._append(self._resampler.resample_chunk(chunk))

    def finish(self) -> None:
        """Take the end of the sound."""
        self._append(self._resampler.resample_chunk(np.zeros(0, np.float32), last=True))
        self.is_whole = True
        self.voice.finish()

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
        late = [now - self._arrival(begin + k) for k in range(len(frames))]
        self.next_frame += len(frames)
        sample = self.next_frame * SAMPLE_RATE // FRAME_RATE
        self._arrivals = [arrival for arrival in self._arrivals if arrival[0] >= sample]
        return begin, late

    def _append(self, chunk: Float32) -> None:
        self.end += len(chunk)
        self._arrivals.append((self.end, monotonic()))
        self.voice.feed(np.asarray(chunk, np.float32))

    def _arrival(self, frame: int) -> float:
        """Time at which the last sample of a frame came."""
        sample = (frame + 1) * SAMPLE_RATE // FRAME_RATE
        return next((at for end, at in self._arrivals if end >= sample), self._arrivals[-1][1])
