"""Sound and frames of a session with a causal model (`api.compute.live`)."""

from time import monotonic

import numpy as np

from api.compute.live import Voice
from api.live.stream import LiveStream
from deitalk.acting import LIVE_FIELDS, Acting
from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from rig.arrays import Float32


class CausalStream(LiveStream):
    """A stream whose sound goes to a voice as it comes; parameters as for `LiveStream`.

    Parameters
    ----------
    sample_rate : int
    is_float : bool
    voice : Voice
    """

    def __init__(self, sample_rate: int, is_float: bool, voice: Voice) -> None:
        super().__init__(sample_rate, is_float)
        self.voice = voice

    @property
    def backlog_seconds(self) -> float:
        """Sound whose frames have not come."""
        return self.seconds - self.next_frame / FRAME_RATE

    @property
    def is_done(self) -> bool:
        """Whether all frames of the whole sound have come."""
        return self.is_whole and self.next_frame >= self.n_frames

    def finish(self) -> None:
        """Take the end of the sound."""
        super().finish()
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
        self.begin += len(chunk)
        self._arrivals.append((self.begin, monotonic()))
        self.voice.feed(np.asarray(chunk, np.float32))
