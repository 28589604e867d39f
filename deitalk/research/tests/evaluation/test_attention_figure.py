"""Attention over vowels and plosives: chosen rows, evenness, and the picture."""

import math

import numpy as np
import pytest

from deitalk.errors import DataError
from deitalk.research.evaluation.attention_figure import (
    AttentionMap,
    attention_maps,
    plot_attention,
)

PHONES = [(0.0, 0.2, "SIL"), (0.2, 0.4, "AA1"), (0.4, 0.6, "B"), (0.6, 0.8, "IY"), (0.8, 0.9, "S")]


def weights():
    """Even weights, except for one spectrum at the middle of the /b/."""
    rows = np.full((30, 16), 1 / 16, np.float32)
    rows[15] = np.eye(16)[8]
    return rows


def test_rows_are_those_at_the_middle_of_a_phone():
    vowels, plosives = attention_maps(weights(), PHONES, 30)
    assert vowels.phones == ("AA", "IY")
    assert plosives.phones == ("B",)
    np.testing.assert_array_equal(vowels.rows, weights()[[9, 21]])
    np.testing.assert_array_equal(plosives.mean, np.eye(16)[8])


def test_evenness_by_hand():
    vowels, plosives = attention_maps(weights(), PHONES, 30)
    assert vowels.evenness == pytest.approx(1)
    assert plosives.evenness == pytest.approx(0, abs=1e-6)
    halves = AttentionMap(np.array([[0.5, 0.5, 0, 0]], np.float32), ("B",))
    assert halves.evenness == pytest.approx(math.log(2) / math.log(4))


def test_a_phone_beyond_the_end_takes_the_last_frame():
    vowels, _ = attention_maps(weights(), [*PHONES, (5, 6, "EH")], 30)
    assert len(vowels.rows) == 3


def test_missing_kind_of_phone_is_refused():
    with pytest.raises(DataError, match="no plosive"):
        attention_maps(weights(), PHONES[:2], 30)


def test_picture_shows_the_peak_of_plosives(tmp_path):
    pytest.importorskip("matplotlib")
    from matplotlib.image import imread

    plot_attention(*attention_maps(weights(), PHONES, 30), 125, tmp_path / "a.png")
    picture = imread(tmp_path / "a.png")
    assert picture.shape[:2] == (540, 900)
    bright = (picture[..., 0] > 0.9) & (picture[..., 1] > 0.8) & (picture[..., 2] < 0.3)
    assert bright[:, 450:].sum() > 10 * max(bright[:, :450].sum(), 1)  # only the plosive peaks
