"""Filters along time equal those of scipy.ndimage, which they replace."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from rig.curves.filters import gaussian_smooth


@pytest.mark.parametrize(("ends", "mode"), [("zero", "constant"), ("mirror", "reflect")])
@pytest.mark.parametrize(("frames", "sigma"), [(1, 5.0), (7, 6.0), (200, 3.0), (200, 0.4)])
def test_gaussian_equals_scipy(rng, frames, sigma, ends, mode):
    values = rng.normal(size=frames)
    expected = gaussian_filter1d(values, sigma, mode=mode)
    np.testing.assert_allclose(gaussian_smooth(values, sigma, ends), expected, atol=1e-12)


def test_gaussian_keeps_a_constant_and_spreads_an_impulse_to_its_deviation():
    np.testing.assert_allclose(gaussian_smooth(np.full(50, 3.0), 4.0, "mirror"), 3.0)
    impulse = np.zeros(101)
    impulse[50] = 1
    spread = gaussian_smooth(impulse, 5.0)
    frames = np.arange(101) - 50
    assert spread.sum() == pytest.approx(1)
    assert np.sqrt((spread * frames**2).sum()) == pytest.approx(5.0, rel=0.01)
