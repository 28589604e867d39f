"""Filters along time in numpy: scipy.ndimage takes longer to import than a recording to animate."""

from typing import Literal

import numpy as np

from rig.arrays import Float64

TRUNCATE = 4.0
"""Standard deviations at which a Gaussian kernel ends, as in ``scipy.ndimage``."""


def gaussian_smooth(
    values: Float64, sigma: float, ends: Literal["zero", "mirror"] = "zero"
) -> Float64:
    """Convolve with a normalised Gaussian kernel.

    Parameters
    ----------
    values : array [shape=(T,)]
        Any finite numbers.
    sigma : float
        Standard deviation of the kernel, frames.
    ends : str
        Values beyond the ends: ``zero``, or ``mirror`` (the last value is repeated first), which
        are ``constant`` and ``reflect`` of ``scipy.ndimage.gaussian_filter1d``.

    Returns
    -------
    array [shape=(T,)]
    """
    radius = int(TRUNCATE * sigma + 0.5)
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    kernel /= kernel.sum()
    if ends == "zero":
        return np.convolve(values, kernel)[radius : radius + len(values)]
    return np.convolve(np.pad(values, radius, mode="symmetric"), kernel, mode="valid")
