"""Recordings from arrays, and every other input of `deitalk.animate`; samples as they come.

Letters: S samples per channel at the array's rate, C channels.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from deitalk.audio.choice import MOST_CHANNELS, AudioChoice
from deitalk.audio.load import MAX_SECONDS, Recording, load_chosen, read_sound
from deitalk.errors import AudioError
from rig.arrays import Float32

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


NAME = "<array>"
"""Name of recordings that are arrays, in messages and in a take."""


def recording_from_array(
    samples: Samples,
    sample_rate: float,
    *,
    channel: str | int | None = None,
) -> Recording:
    """Read samples as mono 16 kHz; mixed, resampled and described as `load_audio` does.

    Parameters
    ----------
    samples : array or tensor [shape=(S,) or (S, C)]
        Floating point within ±1, or int8, uint8, int16 or int32 of full scale.
    sample_rate : float
        A whole number of Hz, 4,000 to 768,000.
    channel
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
            f"{NAME} has shape {np.shape(samples)}; it must be (samples,) or (samples, channels) "
            f"with up to {MOST_CHANNELS} channels: transpose it with .T"
        )
    try:
        rate = int(sample_rate)
    except (TypeError, ValueError, OverflowError):
        rate = -1
    if isinstance(sample_rate, bool) or rate != sample_rate:
        raise AudioError(f"sample_rate={sample_rate!r} must be a whole number of Hz, such as 48000")
    source, choice = _ArraySource(array, rate), AudioChoice.of(channel=channel)
    return read_sound(NAME, source, MAX_SECONDS, choice=choice)


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
