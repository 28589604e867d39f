"""Functions of numpy arrays and of torch tensors alike, so that a rule is written once for both.

Rules run on arrays where torch is not imported, and on tensors where a graph of ONNX is traced: by
operators that every runtime has, without loops over frames, for any number of frames. An array here
is either kind; constants take the kind of the array that they meet.

Letters: T frames, B streams, n frames of a call.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rig.arrays import Float64
from rig.curves.filters import TRUNCATE, gaussian_smooth

Array = Any
"""A numpy array or a torch tensor."""
FAR = 10**6
"""Frames to a neighbour that there is not."""
DOUBLINGS = 17
"""Steps of a running maximum of tensors: enough for 2^17 frames, an hour."""
ROWS_AT_ONCE = 4096
"""Frames of which arrays are convolved at once: an hour of temporary ones would be 150 MB."""


def is_tensor(values: Any) -> bool:
    """Whether this is of torch, not of numpy."""
    return type(values).__module__.startswith("torch")


def library(values: Array) -> Any:
    """`numpy` or `torch`: those of their functions that are used here mean the same in both."""
    if not is_tensor(values):
        return np
    import torch

    return torch


def like(constant: ArrayLike, values: Array) -> Array:
    """A constant as an array of the kind of others; of tensors in single precision."""
    array = np.asarray(constant)
    if not is_tensor(values):
        return array
    tensor = library(values).from_numpy(array.copy()).to(values.device)
    return tensor.float() if tensor.is_floating_point() else tensor


def as_number(flags: Array) -> Array:
    """1 where flags are set, else 0."""
    return flags.float() if is_tensor(flags) else flags.astype(np.float64)


def as_index(values: Array) -> Array:
    """Whole numbers as integers."""
    return values.long() if is_tensor(values) else values.astype(np.int64)


def precise(values: Array) -> Array:
    """The same numbers in double precision."""
    return values.double() if is_tensor(values) else values.astype(np.float64)


def single(values: Array) -> Array:
    """The same numbers in single precision."""
    return values.float() if is_tensor(values) else np.asarray(values, np.float32)


def scalar(number: Any, values: Array) -> Array:
    """A number, such as a length that a tracer follows, as an array of the kind of others."""
    return library(values).as_tensor(number) if is_tensor(values) else np.asarray(number)


def join(parts: Sequence[Array], axis: int = 0) -> Array:
    """Arrays one after the other along an axis."""
    return library(parts[0]).concatenate(parts, axis)


def padded(values: Array, before: int, after: int, fill: float = 0.0) -> Array:
    """Values (T, ...) with rows before and after them."""
    xp = library(values)
    more = [
        xp.full((count, *values.shape[1:]), fill, dtype=values.dtype) for count in (before, after)
    ]
    return join((more[0], values, more[1]))


def in_order(values: Array, axis: int = 0) -> Array:
    """Values in ascending order along an axis."""
    return values.sort(dim=axis)[0] if is_tensor(values) else np.sort(values, axis=axis)


def take_along(values: Array, places: Array, axis: int) -> Array:
    """Values at places of an axis, which are integers; the other axes are the same in both."""
    if is_tensor(values):
        return values.gather(axis, places)
    return np.take_along_axis(values, places, axis)


def replaced(
    flags: Array, old: tuple[Array, ...], function: Callable[..., tuple[Array, ...]], *given: Array
) -> tuple[Array, ...]:
    """Arrays that begin with the stream, with new ones where a stream has its flag (B,).

    The new ones are those that `function` makes of what is given: of arrays, of those streams only.
    """
    if is_tensor(flags):
        where, new = library(flags).where, function(*given)
        shapes = [(-1, *[1] * (part.dim() - 1)) for part in old]
        parts = zip(shapes, new, old, strict=True)
        return tuple(where(flags.reshape(shape), one, other) for shape, one, other in parts)
    places = np.flatnonzero(flags)
    if not len(places):
        return old
    found = tuple(part.copy() for part in old)
    for part, new in zip(found, function(*(part[places] for part in given)), strict=True):
        part[places] = new
    return found


def percentile(values: Array, percent: float, used: Array, axis: int = 0) -> Array:
    """Percentile along an axis of the values that are `used`, linear between two.

    Where none is used it is any number.
    """
    xp = library(values)
    ordered = in_order(xp.where(used, values, float(FAR)), axis)
    last = xp.clip(as_index(used).sum(axis, keepdims=True) - 1, 0, None)
    place = last * (percent / 100)
    below = as_index(xp.floor(place))
    low, high = (take_along(ordered, k, axis) for k in (below, xp.minimum(below + 1, last)))
    return (low + (place - below) * (high - low)).squeeze(axis)


def median(values: Array, axis: int = 0) -> Array:
    """Median along an axis; that of numpy loads its masked arrays, which takes 15 ms."""
    return percentile(values, 50, values == values, axis)


def mean_of(values: Array, used: Array) -> Array:
    """Mean of the values (T,) that are `used`; 0 where none is."""
    return (values * used).sum() / library(values).clip(as_index(used).sum(), 1, None)


def neighbours(flags: Array) -> tuple[Array, Array]:
    """Last flag up to each frame, and next one from it on [shape=(T,)]; `FAR` away if none is."""
    far, ones = like([FAR], flags), as_index(flags)
    places = flags.nonzero()[:, 0] if is_tensor(flags) else np.flatnonzero(flags)
    count = ones.cumsum(0)
    return join((-far, places))[count], join((places, far))[count - ones]


def running_maximum(values: Array) -> Array:
    """Largest of the values (B, n) up to each frame."""
    if not is_tensor(values):
        return np.maximum.accumulate(values, axis=1)
    xp, count = library(values), values.shape[1]
    for k in range(DOUBLINGS if count > 1 else 0):
        earlier = xp.nn.functional.pad(values, (1 << k, 0), value=-FAR * FAR)[:, :count]
        values = xp.maximum(values, earlier)
    return values


def last_value(flags: Array, values: Array, before: Array) -> Array:
    """Value (n,), which rises, at the last flag (B, n) up to each frame; else `before` (B,)."""
    where = library(flags).where
    if is_tensor(flags) and flags.shape[0] == 1:  # fewer operators
        last = neighbours(flags[0])[0]
        return where(last >= 0, values[last.clamp_min(0)], before)[None]
    return running_maximum(where(flags, values, before[:, None]))


def between(values: Array, used: Array) -> Array:
    """Values (T,) of the used frames, and those between by straight lines."""
    xp = library(values)
    last, following = neighbours(used)
    frames, end = xp.arange(values.shape[0]), values.shape[0] - 1
    left = xp.clip(xp.where(last >= 0, last, following), 0, end)
    right = xp.clip(xp.where(following < FAR, following, last), 0, end)
    share = (frames - left) / xp.clip(right - left, 1, None)
    return values[left] + share * (values[right] - values[left])


def smoothed(values: Array, sigma: float) -> Array:
    """`rig.curves.filters.gaussian_smooth` with zeros beyond the ends [shape=(T,)]."""
    if not is_tensor(values):
        return gaussian_smooth(values, sigma)
    radius = int(TRUNCATE * sigma + 0.5)
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    return filtered(values[:, None], kernel / kernel.sum())[:, 0]


def filtered(values: Array, kernel: Float64) -> Array:
    """Columns (T, C) convolved with a symmetric kernel (an odd number), zeros beyond the ends."""
    count, reach = values.shape[0], len(kernel) // 2
    if is_tensor(values):
        conv1d, weight = library(values).nn.functional.conv1d, like(kernel, values)[None, None]
        return conv1d(values.T[:, None], weight, padding=reach)[:, 0].T
    beside = padded(values, reach, reach)
    parts = (share * beside[k : k + count] for k, share in enumerate(kernel))
    return sum(parts, np.zeros_like(values))


def convolved(x: Array, weight: Array, bias: Array, dilation: int) -> Array:
    """Dilated convolution along time that keeps the length: (T, C) to (T, D).

    Parameters
    ----------
    x : array [shape=(T, C)]
        Rows of frames.
    weight : array [shape=(D, C, K)]
        Of K taps.
    bias : array [shape=(D,)]
        What is added.
    dilation : int
        Frames from one tap to the next.
    """
    taps = weight.shape[2]
    reach = taps // 2 * dilation
    if is_tensor(x):
        rows = library(x).nn.functional.conv1d(
            x.T[None], weight, bias, padding=reach, dilation=dilation
        )
        return rows[0].T
    out = np.tile(bias, (len(x), 1))
    for start in range(0, len(x), ROWS_AT_ONCE):
        stop = min(start + ROWS_AT_ONCE, len(x))
        first, last = max(start - reach, 0), min(stop + reach, len(x))
        piece = padded(x[first:last], reach - (start - first), reach - (last - stop))
        for tap in range(taps):
            at = tap * dilation
            out[start:stop] += piece[at : at + stop - start] @ weight[:, :, tap].T
    return out


def gelu(x: Array) -> Array:
    """Gaussian error linear unit, of arrays exact to 1e-7.

    The error function is Abramowitz and Stegun's 7.1.26.
    """
    if is_tensor(x):
        return library(x).nn.functional.gelu(x)
    z = np.abs(x) * np.float32(0.5**0.5)
    t = 1 / (1 + np.float32(0.3275911) * z)
    series = np.zeros_like(t)
    for coefficient in (1.061405429, -1.453152027, 1.421413741, -0.284496736, 0.254829592):
        series = (series + np.float32(coefficient)) * t
    error = np.copysign(1 - series * np.exp(-z * z), x)
    return np.asarray(x * (1 + error) / 2, np.float32)
