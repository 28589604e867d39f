"""Fixed clips: which, and a picture that shows where a model is wrong."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from deitalk.data.clips import read_clips
from deitalk.errors import MissingError
from deitalk.figures import canvas as drawing
from deitalk.models.curve_model import Analysis
from deitalk.training.validation_figure import FixedClips
from rig import default_controls
from tests.dataset import write_dataset

CONTROLS = default_controls()


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"), 4, 4)


def test_the_first_and_the_last_recorded_clip_are_shown(folder):
    clips = read_clips(folder, "validation")
    assert [clip.source for clip in clips] == ["espeak", "recording"] * 2
    assert list(FixedClips.of(clips, CONTROLS).examples) == ["clip5", "clip7"]
    assert list(FixedClips.of(clips[:2], CONTROLS).examples) == ["clip5"]
    assert list(FixedClips.of(clips[:1], CONTROLS).examples) == ["clip4"], "synthetic, if all are"


class Says(torch.nn.Module):
    """A model whose every control and intensity has one value."""

    def __init__(self, value: float, knows_intensity: bool = True) -> None:
        super().__init__()
        self.register_parameter("p", torch.nn.Parameter(torch.tensor(value)))
        self.knows_intensity = knows_intensity

    def analyse(self, waveform: torch.Tensor, n_frames: int, **_: Any) -> Analysis:
        strength = torch.full((n_frames,), float(self.p)) if self.knows_intensity else None
        return Analysis(torch.zeros(n_frames, 1), None, None, strength)

    def decode(self, analysis: Analysis, emotion: torch.Tensor) -> torch.Tensor:
        return torch.full((len(emotion), 185), float(self.p))


def red_rows(path: Path) -> np.ndarray:
    """Heights in the picture (0 top, 1 bottom) of what is drawn in the prediction's red."""
    from matplotlib.image import imread

    picture = imread(path)[..., :3]
    red = np.abs(picture - (0.84, 0.15, 0.16)).max(axis=2) < 0.06
    return np.flatnonzero(red.sum(axis=1) > 100) / len(picture)


def test_predictions_are_drawn_at_their_height_in_all_three_rows(folder, tmp_path):
    pytest.importorskip("matplotlib", reason="pictures need matplotlib")
    clips = FixedClips.of(read_clips(folder, "validation"), CONTROLS)
    heights = {}
    for value in (0.1, 0.9):
        clips.draw(Says(value), tmp_path / "a.png")  # type: ignore[arg-type]
        heights[value] = red_rows(tmp_path / "a.png")
        assert len(heights[value]) == 3, "jaw, lips, intensity"
    # rows of a fifth of the picture's height that span 1.1 units
    np.testing.assert_allclose(heights[0.1] - heights[0.9], 0.8 / 1.1 * 0.21, atol=0.01)
    clips.draw(Says(0.5, knows_intensity=False), tmp_path / "b.png")  # type: ignore[arg-type]
    assert len(red_rows(tmp_path / "b.png")) == 2, "no intensity, no line"


def test_targets_are_drawn(folder, tmp_path):
    pytest.importorskip("matplotlib", reason="pictures need matplotlib")
    from matplotlib.image import imread

    clips = FixedClips.of(read_clips(folder, "validation"), CONTROLS)
    still = {
        name: example._replace(
            curves=np.zeros_like(example.curves), intensity=np.zeros_like(example.intensity)
        )
        for name, example in clips.examples.items()
    }
    clips.draw(Says(0.5), tmp_path / "a.png")  # type: ignore[arg-type]
    FixedClips(still, CONTROLS).draw(Says(0.5), tmp_path / "b.png")  # type: ignore[arg-type]
    pictures = [imread(tmp_path / name)[..., :3] for name in ("a.png", "b.png")]
    grey = [np.abs(picture - 0.8).max(axis=2) < 0.02 for picture in pictures]
    # lips together: half of the height (4 of 5 of the axes' 0.21) for 2.4 of 3 s
    lips = grey[0][len(grey[0]) // 2 : 3 * len(grey[0]) // 4]
    assert lips.mean() == pytest.approx(0.88 * 0.8 * 0.5 / 1.1 * 0.21 / 0.25, abs=0.05)
    assert grey[1].mean() < 0.02 < grey[0].mean()


def test_without_matplotlib_the_install_line_is_given(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with (
        pytest.raises(MissingError, match="pip install matplotlib"),
        drawing.drawing(tmp_path / "a.png", (1, 1)),
    ):
        pass
    assert not list(tmp_path.iterdir())


def test_a_picture_that_fails_leaves_nothing(tmp_path):
    pytest.importorskip("matplotlib", reason="pictures need matplotlib")
    with pytest.raises(RuntimeError), drawing.drawing(tmp_path / "a.png", (1, 1)):
        raise RuntimeError
    assert not list(tmp_path.iterdir())
