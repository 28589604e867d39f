"""Pictures of clips: where targets and predictions are drawn, and what is left when one fails."""

import sys
from pathlib import Path

import numpy as np
import pytest

from deitalk.errors import MissingError
from deitalk.research.training.pictures import ClipRows, Row, draw_clips

LIMITS = (-0.05, 1.05)
WAVEFORM = np.sin(np.arange(3 * 16_000) / 20).astype(np.float32)


def clip(predicted: float | None, target: float | None = None, limits=LIMITS) -> ClipRows:
    """Three rows of constants, 3 s long."""

    def constant(value: float | None):
        return None if value is None else np.full(90, value, np.float32)

    row = Row("row", constant(target), constant(predicted), limits)
    return ClipRows("a clip", WAVEFORM, [row] * 3, 30)


def pixels(path: Path) -> np.ndarray:
    from matplotlib.image import imread

    return imread(path)[..., :3]


def red_rows(path: Path) -> np.ndarray:
    """Heights in the picture (0 top, 1 bottom) of what is drawn in the prediction's red."""
    red = np.abs(pixels(path) - (0.84, 0.15, 0.16)).max(axis=2) < 0.06
    return np.flatnonzero(red.sum(axis=1) > 100) / len(red)


def grey_share(path: Path) -> float:
    """Share of the picture in the target's grey."""
    return float((np.abs(pixels(path) - 0.8).max(axis=2) < 0.02).mean())


@pytest.fixture(autouse=True)
def matplotlib():
    pytest.importorskip("matplotlib", reason="pictures need matplotlib")


def test_predictions_are_drawn_at_their_height_in_every_row(tmp_path):
    heights = {}
    for value in (0.1, 0.9):
        draw_clips(tmp_path / "a.png", [clip(value)] * 2)
        heights[value] = red_rows(tmp_path / "a.png")
        assert len(heights[value]) == 3
    # rows of a fifth of the picture's height that span 1.1 units
    np.testing.assert_allclose(heights[0.1] - heights[0.9], 0.8 / 1.1 * 0.21, atol=0.01)


def test_target_fills_the_area_below_it(tmp_path):
    shares = []
    for target in (0.0, 0.4, 0.8):
        draw_clips(tmp_path / "a.png", [clip(0.95, target)])
        shares.append(grey_share(tmp_path / "a.png"))
    # three rows of a fifth of the height and most of the width, which span 1.1 units
    assert shares[2] - shares[0] == pytest.approx(3 * 0.21 * 0.88 * 0.8 / 1.1, abs=0.04)
    assert shares[1] - shares[0] == pytest.approx((shares[2] - shares[0]) / 2, abs=0.01)


def test_without_matplotlib_the_install_line_is_given(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingError, match="pip install matplotlib"):
        draw_clips(tmp_path / "a.png", [clip(0.5)])
    assert not list(tmp_path.iterdir())
