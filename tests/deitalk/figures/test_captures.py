"""Pictures of a check of captures."""

import numpy as np
import pytest

from deitalk.data.captures.mend import LEAST_SHOWN_MS, shown_lags
from tests.each import each


@each("lags", [[], [-0.62], [-0.62, np.nan], [-1.0, 1.0]])
def test_axis_of_small_lags_is_two_frames_long(lags):
    low, high = shown_lags(np.array(lags, np.float64))
    assert high - low == pytest.approx(LEAST_SHOWN_MS)
    assert all(low < lag < high for lag in lags if np.isfinite(lag))


def test_axis_of_large_lags_has_all_of_them():
    assert shown_lags(np.array([-100.0, 100.0])) == pytest.approx((-110, 110))
