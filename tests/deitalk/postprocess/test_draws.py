"""Numbers of `deitalk.postprocess.life.draws` against those of scipy, which takes long to import."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.special import ndtri

from deitalk.postprocess.life.draws import followed, normals


def test_normal_numbers_are_those_of_scipy():
    ends = 10.0 ** -np.arange(1, 17)
    shares = np.concatenate((np.linspace(1e-4, 1 - 1e-4, 9999), ends, 1 - ends[:-1]))
    np.testing.assert_allclose(normals(shares), ndtri(shares), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("count", [1, 63, 64, 65, 200])
def test_what_follows_slowly_is_a_filter_of_scipy(count):
    rng = np.random.default_rng(count)
    values, state = rng.normal(size=(3, count, 2)), rng.normal(size=(3, 1, 2))
    expected, after = lfilter([0.04], [1, -0.96], values, axis=1, zi=state)
    rows, kept = followed(values, 0.04, state)
    np.testing.assert_allclose(rows, expected, atol=1e-12)
    np.testing.assert_allclose(kept, after, atol=1e-12)
