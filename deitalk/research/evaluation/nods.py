"""How regular nods are: spread of the intervals between them, and of their depths.

A nod is a dip of the head's pitch that is at least `LEAST_DEGREES` deep: its depth is the smaller
of the falls from the highest points before and after it, as far as the next deeper dip. Even nods
of an even beat have spreads of 0; intervals of a Poisson process and exponential depths have 1.

Letters: n measures.
"""

from collections.abc import Sequence

import numpy as np

from rig.arrays import Float64
from rig.curves.filters import gaussian_smooth

LEAST_DEGREES = 0.3
SMOOTH_SECONDS = 0.06
"""Sigma of the Gaussian against the noise of a tracker."""
MEASURES = ("nods a second", "depth, °", "spread of depths", "spread of intervals")


def find_nods(pitch: Float64, rate: float) -> tuple[Float64, Float64]:
    """Times and depths of nods.

    Parameters
    ----------
    pitch : array [shape=(n,)]
        Degrees, up is positive.
    rate : float
        Measures per second.

    Returns
    -------
    times, depths : arrays [shape=(N,)]
        Seconds of the lowest points, and degrees.
    """
    smooth = gaussian_smooth(np.asarray(pitch, np.float64), SMOOTH_SECONDS * rate, "mirror")
    lows = 1 + np.flatnonzero((smooth[1:-1] < smooth[:-2]) & (smooth[1:-1] <= smooth[2:]))
    depths = np.array([_depth(smooth, low) for low in lows.tolist()])
    deep = depths >= LEAST_DEGREES
    return lows[deep] / rate, depths[deep]


def _depth(pitch: Float64, low: int) -> float:
    """Smaller of the rises to both sides, as far as a deeper dip or the end."""
    rises = []
    for side in (pitch[low::-1], pitch[low:]):
        deeper = np.flatnonzero(side < pitch[low])
        rises.append(side[: deeper[0]].max() if len(deeper) else side.max())
    return float(min(rises) - pitch[low])


def measure_nods(pitches: Sequence[Float64], rate: float) -> Float64:
    """`MEASURES` of a speaker's recordings [shape=(4,)].

    Spreads are standard deviations over means; NaN where there are fewer than two depths or
    intervals. Intervals lie within a recording.
    """
    found = [find_nods(pitch, rate) for pitch in pitches]
    depths = np.concatenate([depths for _, depths in found])
    intervals = np.concatenate([np.diff(times) for times, _ in found])
    seconds = sum(len(pitch) for pitch in pitches) / rate
    mean = depths.mean() if len(depths) else np.nan
    return np.array([len(depths) / seconds, mean, _spread(depths), _spread(intervals)])


def _spread(values: Float64) -> float:
    return float(values.std() / values.mean()) if len(values) > 1 else float("nan")
