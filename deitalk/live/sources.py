"""Sound that comes in blocks of 1/150 s: a microphone, or a recording at its own pace."""

import queue
from collections.abc import Callable
from time import monotonic, sleep
from typing import Any, Protocol

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.errors import AudioError, MissingError
from rig.arrays import Float32
from rig.errors import quoted, shorten

BLOCKS_A_SECOND = 150
"""Five a frame of 30 Hz, so that every frame becomes known at the same place of its block."""
SILENT_SECONDS = 2.0
"""Time without a block after which a microphone counts as gone."""


class Source(Protocol):
    """Sound that comes in blocks."""

    @property
    def sample_rate(self) -> int:
        """Samples per second, Hz."""

    @property
    def is_over(self) -> bool:
        """Whether all of it was read."""

    def read(self, seconds: float) -> Float32 | None:
        """Samples of the next block, or of several that are late; None if none came in time."""


class PacedSound:
    """A recording whose blocks come as if it were spoken now.

    Parameters
    ----------
    waveform : array [shape=(S,)]
        16 kHz.
    now, wait : callable
        Source of time, seconds.
    """

    sample_rate = SAMPLE_RATE

    def __init__(
        self,
        waveform: Float32,
        now: Callable[[], float] = monotonic,
        wait: Callable[[float], None] = sleep,
    ) -> None:
        self.waveform, self.now, self.wait = waveform, now, wait
        self.start: float | None = None
        self.n_read = 0

    @property
    def is_over(self) -> bool:
        """Whether all blocks were read."""
        return self._end(self.n_read) >= len(self.waveform)

    def read(self, seconds: float) -> Float32 | None:
        """The next block, once its last sample would have been spoken since the first call.

        After a stall the blocks that were missed come with it.
        """
        if self.start is None:
            self.start = self.now()
        wait = self.start + self._end(self.n_read + 1) / SAMPLE_RATE - self.now()
        if wait > seconds:
            self.wait(max(seconds, 0.0))
            return None
        if wait > 0:
            self.wait(wait)
        missed = max(int(-wait * BLOCKS_A_SECOND), 0)
        begin, self.n_read = self._end(self.n_read), self.n_read + 1 + missed
        return self.waveform[begin : self._end(self.n_read)]

    def _end(self, n_blocks: int) -> int:
        """Samples of the first blocks."""
        return min(round(n_blocks * SAMPLE_RATE / BLOCKS_A_SECOND), len(self.waveform))


class Microphone:
    """An input of this computer, by the package sounddevice.

    Parameters
    ----------
    device : str, int or None
        Name, part of one, or number of the input; None is the default one.

    Raises
    ------
    MissingError
        If sounddevice or PortAudio is not installed.
    AudioError
        If there is no such input, or it cannot be opened.
    """

    is_over = False

    def __init__(self, device: str | int | None = None) -> None:
        sounddevice = _sounddevice()
        self.name = "the microphone" if device is None else f"the input {quoted(str(device))}"
        self.blocks: queue.Queue[Float32] = queue.Queue()
        self.last_block, self.is_open = monotonic(), False
        try:
            about = sounddevice.query_devices(device, "input")
            self.sample_rate = round(float(about["default_samplerate"]))
            self.stream = sounddevice.InputStream(
                samplerate=self.sample_rate,
                blocksize=self.sample_rate // BLOCKS_A_SECOND,
                device=device,
                channels=1,
                dtype="float32",
                latency="low",
                callback=self._take,
            )
        except (sounddevice.PortAudioError, ValueError, OSError) as error:
            raise self._closed(error) from None
        self._failure = sounddevice.PortAudioError

    def read(self, seconds: float) -> Float32 | None:
        """Read the sound since the call before, at least a block; None if none came in time.

        Raises
        ------
        AudioError
            If the input cannot be started, or no block has come for 2 s.
        """
        if not self.is_open:
            try:
                self.stream.start()
            except (self._failure, OSError) as error:
                raise self._closed(error) from None
            self.is_open, self.last_block = True, monotonic()
        try:
            blocks = [self.blocks.get(timeout=max(seconds, 0.001))]
        except queue.Empty:
            if monotonic() - self.last_block > SILENT_SECONDS:
                raise AudioError(
                    f"{self.name} has given no sound for {SILENT_SECONDS:g} s; connect it again "
                    "and restart"
                ) from None
            return None
        self.last_block = monotonic()
        while not self.blocks.empty():  # after a stall: one call for all is cheaper
            blocks.append(self.blocks.get())
        return np.concatenate(blocks)

    def close(self) -> None:
        """Release the device."""
        self.stream.close(ignore_errors=True)

    def _closed(self, error: Exception) -> AudioError:
        reason = shorten(" ".join(str(error).split()), 120)
        return AudioError(f"{self.name} cannot be opened ({reason}); connect one, or name another")

    def _take(self, samples: Any, frames: int, time: Any, status: Any) -> None:
        self.blocks.put(np.array(samples[:, 0], np.float32))


def _sounddevice() -> Any:
    try:
        import sounddevice  # type: ignore[import-untyped]
    except (ImportError, OSError) as error:
        raise MissingError(
            f"a microphone needs the package sounddevice and PortAudio ({error}); "
            "pip install 'deitalk[mic]', or give a file"
        ) from None
    return sounddevice
