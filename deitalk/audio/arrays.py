"""Recordings from arrays, and every other input of `deitalk.animate`; samples as they come.

Letters: S samples per channel at the array's rate, C channels.
"""

from collections.abc import Iterator
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from deitalk.audio.choice import MOST_CHANNELS, AudioChoice
from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.load import MAX_SECONDS, Recording, load_chosen, read_sound
from deitalk.errors import AudioError
from rig.arrays import Float32, Float64, Int64

if TYPE_CHECKING:
    from torch import Tensor


_FULL_SCALE = {"int8": 2.0**7, "uint8": 2.0**7, "int16": 2.0**15, "int32": 2.0**31}
_FLOATS = ("float16", "float32", "float64")

Samples: TypeAlias = "npt.NDArray[Any] | Tensor"
Audio: TypeAlias = "str | Path | bytes | IO[bytes] | Recording | npt.NDArray[Any] | Tensor"


def recording_of(
    audio: Audio, sample_rate: float | None = None, choice: AudioChoice = AudioChoice()
) -> Recording:
    """Return a recording from a file, a stream, an array or a tensor.

    Parameters
    ----------
    audio : path, bytes, file object, Recording, array or tensor
        See `deitalk.audio.load.load_audio` and `recording_from_array`.
    sample_rate : float, optional
        Hz; required for an array or a tensor, not allowed for anything else.
    choice : AudioChoice
        Of a file or a stream; of an array its channel, of a `Recording` nothing.

    Raises
    ------
    AudioError
        As raised by either of them, or if `sample_rate` or a choice is missing or not allowed.
    """
    if isinstance(audio, list | tuple):
        raise AudioError(f"a {type(audio).__name__} is no recording; pass numpy.asarray of it")
    if hasattr(audio, "__array__") and not isinstance(audio, Recording):
        if sample_rate is None:
            raise AudioError(
                f"an array holds no sample rate; pass sample_rate in Hz with the "
                f"{type(audio).__name__}"
            )
        _refuse_choice(audio, {**choice.settings, "channel": None})
        channel = choice.channel
        return recording_from_array(audio, sample_rate, channel=channel)  # type: ignore[arg-type]
    if sample_rate is not None:
        raise AudioError(
            f"sample_rate={sample_rate!r} belongs to an array of samples; leave it out, a "
            f"{type(audio).__name__} has its own"
        )
    if isinstance(audio, Recording):
        _refuse_choice(audio, choice.settings)
        return audio
    return load_chosen(audio, choice)


def _refuse_choice(audio: Any, settings: dict[str, Any]) -> None:
    """Raise for a choice that something which is read already does not have."""
    for name, value in settings.items():
        if value is not None:
            raise AudioError(
                f"`{name}={value}` is of a file or a stream, not of a {type(audio).__name__}; "
                "leave it out",
                parameter=name,
            )


def recording_from_array(
    samples: Samples,
    sample_rate: float,
    *,
    name: str = "<array>",
    max_seconds: float = MAX_SECONDS,
    channel: str | int | None = None,
) -> Recording:
    """Read samples as mono 16 kHz; mixed, resampled and described as `load_audio` does.

    Parameters
    ----------
    samples : array or tensor [shape=(S,) or (S, C)]
        Floating point within ±1, or int8, uint8, int16 or int32 of full scale.
    sample_rate : float
        A whole number of Hz, 4,000 to 768,000.
    name : str
        Name of the recording in messages and in a take.
    max_seconds, channel
        As for `load_audio`.

    Raises
    ------
    AudioError
        If the shape, the type or the rate is not one of these, or if there are no samples, too
        many, or samples that are not finite.
    """
    array = _array(samples)
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or not 1 <= array.shape[1] <= MOST_CHANNELS:
        raise AudioError(
            f"{name} has shape {np.shape(samples)}; it must be (samples,) or (samples, channels) "
            f"with up to {MOST_CHANNELS} channels: transpose it with .T"
        )
    try:
        rate = int(sample_rate)
    except (TypeError, ValueError, OverflowError):
        rate = -1
    if isinstance(sample_rate, bool) or rate != sample_rate:
        raise AudioError(f"sample_rate={sample_rate!r} must be a whole number of Hz, such as 48000")
    source, choice = _ArraySource(array, rate), AudioChoice.of(channel=channel)
    return read_sound(name, source, max_seconds, choice=choice)


def _array(samples: Any) -> npt.NDArray[Any]:
    """The unscaled samples on the CPU; only types whose full scale is known."""
    if hasattr(samples, "detach"):  # a tensor
        samples = samples.detach().cpu()
        if samples.is_floating_point():
            samples = samples.float()  # NumPy has no bfloat16
    array = np.asarray(samples)
    if array.dtype.name not in (*_FULL_SCALE, *_FLOATS):
        raise AudioError(
            f"samples of type {array.dtype.name} have no known full scale; pass floats within "
            f"±1, or {', '.join(_FULL_SCALE)}"
        )
    return array


class _ArraySource:
    """An array as `deitalk.audio.decoding.SoundSource`."""

    def __init__(self, array: npt.NDArray[Any], rate: int) -> None:
        self.array, self.rate = array, rate
        self.channels, self.expected = array.shape[1], len(array)
        self.layout: tuple[str, ...] = ()
        self.tracks: tuple[str, ...] = ("",)
        self.track = 1
        self.notes: list[str] = []

    def on(self, track: int) -> "_ArraySource":
        """The only track."""
        return self

    def blocks(self, size: int) -> Iterator[Float32]:
        """Blocks (n, C) of `size` samples, full scale at 1, the last one shorter."""
        kind = self.array.dtype.name
        for start in range(0, len(self.array), size):
            block = self.array[start : start + size]
            if kind in _FLOATS:
                yield block.astype(np.float32)
            else:
                middle = _FULL_SCALE[kind] if kind == "uint8" else 0.0
                yield ((block.astype(np.float64) - middle) / _FULL_SCALE[kind]).astype(np.float32)


# Samples of any rate to 16 kHz as they come, 4 ms behind them.
#
# A windowed sinc at the exact place of every sample. soxr, which whole recordings are resampled
# with, gives a stream's samples in bursts 5 to 37 ms late.
#
# Letters: S samples, m samples of a call, R samples on either side that a sample depends on.


CROSSINGS = 64
"""Zero crossings of the sinc on either side: 4 ms, or more of a rate below 16 kHz."""
CUTOFF = 0.955
"""Half the sound's height is left at this share of the lower Nyquist frequency (7.6 kHz)."""
KAISER = 8.0
"""Shape of the window: 80 dB at and above the Nyquist frequency."""
MOST_PHASES = 1000
"""Kernels that are kept; rates that need more compute theirs anew."""
BLOCK = 4096
"""Samples that are computed at once."""


class RunningResampler:
    """Samples of one stream at 16 kHz; any pieces give what the whole gives.

    Parameters
    ----------
    sample_rate : int
        Of the samples that come, Hz.
    """

    def __init__(self, sample_rate: int) -> None:
        step = Fraction(sample_rate, SAMPLE_RATE)
        self.rise, self.run, self.sample_rate = step.numerator, step.denominator, sample_rate
        self.reach = _reach(sample_rate)
        self.samples = np.zeros(self.reach - 1, np.float32)
        self.begin, self.n_given = 1 - self.reach, 0

    def feed(self, samples: Float32, *, last: bool = False) -> Float32:
        """Take the next samples; return those that are known now.

        With `last` the sound has ended: S samples have then given S · 16000 / rate, rounded.
        """
        end = self.begin + len(self.samples) + len(samples)
        pieces = (self.samples, samples, np.zeros(self.reach if last else 0, np.float32))
        self.samples = np.concatenate(pieces)
        stop = (self.run * (end - self.reach) - 1) // self.rise + 1
        if last:
            stop = (2 * self.run * end + self.rise) // (2 * self.rise)
        blocks = [
            self._at(np.arange(start, min(start + BLOCK, stop)))
            for start in range(self.n_given, stop, BLOCK)
        ]
        self.n_given = max(stop, self.n_given)
        needed = self.n_given * self.rise // self.run - self.reach + 1
        self.samples, self.begin = self.samples[needed - self.begin :].copy(), needed
        return np.concatenate(blocks) if blocks else np.zeros(0, np.float32)

    def _at(self, numbers: Int64) -> Float32:
        """Samples by their numbers [shape=(m,)]."""
        places, phases = np.divmod(numbers * self.rise, self.run)
        rows = np.lib.stride_tricks.sliding_window_view(self.samples, 2 * self.reach)
        starts = places - self.reach + 1 - self.begin
        if self.run == 1:  # every sample lies on one that came: no copies
            kernel = _kernels(self.sample_rate, 1)[0]
            even = rows[starts[0] : starts[-1] + 1 : self.rise]
            return np.asarray(np.einsum("mr,r->m", even, kernel), np.float32)
        rows = rows[starts]
        if self.run <= MOST_PHASES:
            kernels = _kernels(self.sample_rate, self.run)[phases]
        else:
            kernels = _kernel(self.sample_rate, phases / self.run)
        return np.asarray(np.einsum("mr,mr->m", rows, kernels), np.float32)


def _reach(sample_rate: int) -> int:
    """R, in samples of the given rate."""
    return int(np.ceil(CROSSINGS / CUTOFF * max(sample_rate / SAMPLE_RATE, 1.0)))


@lru_cache(maxsize=4)
def _kernels(sample_rate: int, n_phases: int) -> Float32:
    """Kernels of all places between two samples [shape=(n_phases, 2 R)]."""
    return _kernel(sample_rate, np.arange(n_phases) / n_phases)


def _kernel(sample_rate: int, phases: Float64) -> Float32:
    """Weights of the samples around places [shape=(m, 2 R)]; `phases` (m,) from 0 up to 1."""
    reach, cutoff = _reach(sample_rate), CUTOFF * min(SAMPLE_RATE / sample_rate, 1.0)
    offsets = np.arange(1 - reach, reach + 1) - phases[:, None]
    window = np.i0(KAISER * np.sqrt(np.maximum(1 - (offsets / reach) ** 2, 0)))
    weights = np.sinc(cutoff * offsets) * window
    return np.asarray(weights / weights.sum(axis=1, keepdims=True), np.float32)
