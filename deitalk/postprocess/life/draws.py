"""Random numbers, slow noise and events of streams side by side, each a pure function of seeds.

A number is a hash of its stream's key and of the place of what it belongs to: the frame of a
syllable, or the number of a blink. Equal keys give equal numbers in any order and in any blocks, so
that nothing is kept of them between two calls, and those of all streams are drawn at once.

Letters: B streams, n frames of a call, N events, K channels.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from deitalk.audio.frames import FRAME_RATE
from rig.arrays import AnyFloat, Bool, Float64, Int64

UInt64 = NDArray[np.uint64]
_STEP = np.uint64(0x9E3779B97F4A7C15)
_FACTORS = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


def _mixed(words: UInt64) -> UInt64:
    """The finaliser of SplitMix64 (Steele, Lea and Flood 2014)."""
    words = (words ^ (words >> np.uint64(30))) * _FACTORS[0]
    words = (words ^ (words >> np.uint64(27))) * _FACTORS[1]
    return words ^ (words >> np.uint64(31))


def sub_keys(keys: UInt64, count: int) -> UInt64:
    """Keys of `count` channels of each key [shape=(..., count)]."""
    return _mixed(keys[..., None] + _STEP * np.arange(1, count + 1, dtype=np.uint64))


def uniforms(keys: UInt64, places: Int64 | Float64, count: int) -> Float64:
    """Numbers from 0 to 1 of places [shape=(..., count)]; keys and places are broadcast."""
    words = np.asarray(places).astype(np.int64).astype(np.uint64)
    drawn = sub_keys(_mixed(keys + _STEP * words), count)
    shares: Float64 = ((drawn >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53
    return shares


def normals(shares: Float64) -> Float64:
    """Standard normal numbers of uniform ones, by Wichura's algorithm AS 241 (1988), to 1e-15.

    `scipy.special` takes an eighth of the time of a whole command to import.
    """
    distance = shares - 0.5
    inner = 0.180625 - distance**2
    middle = distance * _ratio(inner, _MIDDLE)
    tail = np.sqrt(-np.log(np.minimum(shares, 1 - shares)))
    outer = _ratio(tail - 1.6, _NEAR)
    if (is_far := tail > 5).any():
        outer = np.where(is_far, _ratio(tail - 5, _FAR), outer)
    outer = np.copysign(outer, distance)
    return np.where(np.abs(distance) <= 0.425, middle, outer)


def _ratio(x: Float64, coefficients: Float64) -> Float64:
    """Ratio of two polynomials, of whose coefficients the highest powers come first."""
    both = np.zeros((2, *x.shape))
    for power in coefficients.T.reshape(-1, 2, *[1] * x.ndim):  # Horner's scheme for both
        both = both * x + power
    ratio: Float64 = both[0] / both[1]
    return ratio


_MIDDLE = np.array(
    [
        [2.5090809287301226727e3, 3.3430575583588128105e4, 6.7265770927008700853e4,
         4.5921953931549871457e4, 1.3731693765509461125e4, 1.9715909503065514427e3,
         1.3314166789178437745e2, 3.3871328727963666080],
        [5.2264952788528545610e3, 2.8729085735721942674e4, 3.9307895800092710610e4,
         2.1213794301586595867e4, 5.3941960214247511077e3, 6.8718700749205790830e2,
         4.2313330701600911252e1, 1],
    ]
)  # fmt: skip
_NEAR = np.array(
    [
        [7.74545014278341407640e-4, 2.27238449892691845833e-2, 2.41780725177450611770e-1,
         1.27045825245236838258, 3.64784832476320460504, 5.76949722146069140550,
         4.63033784615654529590, 1.42343711074968357734],
        [1.05075007164441684324e-9, 5.47593808499534494600e-4, 1.51986665636164571966e-2,
         1.48103976427480074590e-1, 6.89767334985100004550e-1, 1.67638483018380384940,
         2.05319162663775882187, 1],
    ]
)  # fmt: skip
_FAR = np.array(
    [
        [2.01033439929228813265e-7, 2.71155556874348757815e-5, 1.24266094738807843860e-3,
         2.65321895265761230930e-2, 2.96560571828504891230e-1, 1.78482653991729133580,
         5.46378491116411436990, 6.65790464350110377720],
        [2.04426310338993978564e-15, 1.42151175831644588870e-7, 1.84631831751005468180e-5,
         7.86869131145613259100e-4, 1.48753612908506148525e-2, 1.36929880922735805310e-1,
         5.99832206555887937690e-1, 1],
    ]
)  # fmt: skip


def followed(values: AnyFloat, share: float, state: Float64) -> tuple[Float64, Float64]:
    """Values that come and go slowly: each row goes a share of the way from the one before.

    Parameters
    ----------
    values : array [shape=(B, n, ...)]
        Of the next frames.
    share : float
        Of a new row.
    state : array [shape=(B, 1, ...)]
        The part of the last row that stays.

    Returns
    -------
    array [shape=(B, n, ...)], array [shape=(B, 1, ...)]
        Rows, and the state after them.
    """
    rows = np.empty(values.shape)
    flat, found = (x.reshape(*values.shape[:2], -1) for x in (np.asarray(values, float), rows))
    kept = np.asarray(state, float).reshape(len(flat), 1, -1)
    for start in range(0, flat.shape[1], _BLOCK):  # a product of matrices instead of a loop
        part = flat[:, start : start + _BLOCK]
        lag = np.subtract.outer(np.arange(part.shape[1]), np.arange(part.shape[1]))
        weights = np.where(lag >= 0, share * (1 - share) ** np.maximum(lag, 0), 0.0)
        block = weights @ part + (1 - share) ** np.arange(part.shape[1])[:, None] * kept
        found[:, start : start + _BLOCK] = block
        kept = (1 - share) * block[:, -1:]
    return rows, kept.reshape(state.shape)


_BLOCK = 64


def between(shares: Float64, span: tuple[float, float]) -> Float64:
    """Numbers of a span of uniform ones."""
    return span[0] + (span[1] - span[0]) * shares


KNOT_SIGMAS = 1.67
"""Distance of the knots of a noise: with cubic B-splines between them it has the speed of white
noise that a Gaussian smooths."""
_SPLINE_SPREAD = 0.692
"""Standard deviation of a sum of cubic B-splines with standard normal heights."""


def smooth_noise(keys: UInt64, times: Float64, spread: Float64, seconds: Float64) -> Float64:
    """Noise at some times.

    Parameters
    ----------
    keys : array of uint64 [shape=(B,)]
        Of the streams.
    times : array [shape=(B, n)]
        Seconds.
    spread, seconds : array [shape=(K,)]
        Standard deviations, and the sigmas of Gaussians whose speed the noise has.

    Returns
    -------
    array [shape=(B, n, K)]
    """
    place = times[..., None] / (KNOT_SIGMAS * seconds)
    first = np.floor(place)
    part = (place - first)[..., None]
    knots = first[..., None] + np.arange(-1, 3)
    heights = normals(uniforms(sub_keys(keys, len(seconds))[:, None, :, None], knots, 1)[..., 0])
    left = 1 - part
    weights = np.concatenate(
        (left**3, 4 - 6 * part**2 + 3 * part**3, 4 - 6 * left**2 + 3 * left**3, part**3), axis=-1
    )
    noise: Float64 = spread * (heights * weights).sum(axis=-1) / (6 * _SPLINE_SPREAD)
    return noise


def swell(since: Float64, attack: Float64, hold: Float64, decay: Float64) -> Float64:
    """Raised cosine up, a hold and one down, of seconds since the begin; 0 to 1."""
    rise = np.clip(since / attack, 0, 1)
    fall = np.clip((attack + hold + decay - since) / decay, 0, 1)
    shape: Float64 = 0.25 * (1 - np.cos(np.pi * rise)) * (1 - np.cos(np.pi * fall))
    return shape


class Events:
    """A table of events of streams; each moves some channels in its time.

    Parameters
    ----------
    fields : int
        Numbers of an event besides its stream, of which the first is its begin, seconds.
    """

    def __init__(self, fields: int) -> None:
        self.stream: Int64 = np.zeros(0, np.int64)
        self.rows: Float64 = np.zeros((0, fields))

    def append(self, stream: Int64, rows: Float64) -> None:
        """Add events [shape=(N,)], [shape=(N, fields)]."""
        self.stream = np.concatenate((self.stream, stream))
        self.rows = np.concatenate((self.rows, rows))

    def keep(self, is_kept: Bool) -> None:
        """Drop the others."""
        self.stream, self.rows = self.stream[is_kept], self.rows[is_kept]

    def clear(self, stream: int) -> None:
        """Drop those of a stream."""
        self.keep(self.stream != stream)


class Swells(Events):
    """Events that rise, hold and fall in raised cosines; each adds to some channels.

    Parameters
    ----------
    channels : int
        K.
    """

    def __init__(self, channels: int) -> None:
        super().__init__(4 + channels)

    def add(
        self,
        stream: Int64,
        peak: Float64,
        seconds: tuple[Float64 | float, Float64 | float, Float64 | float],
        heights: Float64,
        known: Float64,
        shortest: float | None = None,
    ) -> None:
        """Add events [shape=(N,) each].

        Parameters
        ----------
        stream : array of int
            Whose.
        peak : array
            Seconds at which they are wanted to be highest.
        seconds : tuple
            Attack, hold and decay.
        heights : array [shape=(N, K)]
            At the peaks.
        known : array
            Seconds before which they cannot begin; the peak is late then.
        shortest : float, optional
            To how many seconds the attack may be shortened for that; not at all by default.
        """
        if not len(peak):
            return
        attack, hold, decay = (np.broadcast_to(part, peak.shape) for part in seconds)
        least = attack if shortest is None else np.minimum(shortest, attack)
        attack = np.minimum(attack, np.maximum(peak - known, least))
        begin = np.maximum(known, peak - attack)
        times = np.stack((begin, attack, hold, decay), axis=1)
        self.append(stream, np.concatenate((times, heights), axis=1))

    def play(self, streams: Int64, first: Int64, count: int) -> Float64:
        """Sums of the events of some streams in their next frames; what is over is dropped.

        Parameters
        ----------
        streams : array of int [shape=(B,)]
            Which; each once.
        first : array of int [shape=(B,)]
            Frame that comes next.
        count : int
            n.

        Returns
        -------
        array [shape=(B, n, K)]
        """
        found = np.zeros((len(streams), count, self.rows.shape[1] - 4))
        order = np.full(max(streams.max(), self.stream.max(initial=0)) + 1, -1)
        order[streams] = np.arange(len(streams))
        place = order[self.stream]
        stop = self.rows[:, :4].sum(axis=1) * FRAME_RATE
        starts = first[place]
        now = (place >= 0) & (self.rows[:, 0] * FRAME_RATE < starts + count) & (stop > starts)
        rows, place = self.rows[now], place[now]
        times = (first[:, None] + np.arange(count)) / FRAME_RATE
        begin, attack, hold, decay = rows[:, :4, None].swapaxes(0, 1)
        shapes = swell(times[place] - begin, attack, hold, decay)
        np.add.at(found, place, shapes[..., None] * rows[:, None, 4:])
        self.keep((order[self.stream] < 0) | (stop >= starts + count))
        return found


def by_rank(streams: Int64) -> Iterator[Int64]:
    """Yield indices of the first event of each stream, of the second of each, and so on."""
    order = np.argsort(streams, kind="stable")
    ordered = streams[order]
    rank = np.arange(len(order)) - np.searchsorted(ordered, ordered)
    for k in range(int(rank.max(initial=-1)) + 1):
        yield order[rank == k]
