"""The development score: near 1 for the target, low at rest; recordings are chosen first."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from deitalk.data.clips import read_clips
from deitalk.evaluation.smoothness import MAX_CLIPS, lips_together, load_example
from deitalk.models.curve_model import Analysis
from deitalk.research.training.validation import ValidationSet
from rig import default_controls
from tests.dataset import JAW, SECONDS, write_dataset

CONTROLS = default_controls()


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"))


class Playback(torch.nn.Module):
    """A model that returns given curves in order, optionally late."""

    def __init__(self, targets: list[np.ndarray], strengths: list[np.ndarray] | None, lag: int = 0):
        super().__init__()
        self.register_parameter("p", torch.nn.Parameter(torch.zeros(1)))
        self.targets, self.strengths, self.lag, self.i = targets, strengths, lag, -1
        self.emotions: list[int] = []

    def analyse(self, waveform: torch.Tensor, n_frames: int, **_: Any) -> Analysis:
        self.i += 1
        strength = None if self.strengths is None else torch.from_numpy(self.strengths[self.i])
        return Analysis(torch.zeros(n_frames, 1), None, None, strength)

    def styles(self, emotion: torch.Tensor, actor: str) -> torch.Tensor:
        return emotion

    def decode(self, analysis: Analysis, emotion: torch.Tensor) -> torch.Tensor:
        assert len(emotion) == len(analysis.speech)
        self.emotions.append(int(emotion[0].argmax()))
        return torch.from_numpy(np.roll(self.targets[self.i], self.lag, axis=0))


def test_an_example_is_a_clip_at_30_frames_per_second(folder):
    clip = read_clips(folder)[0]
    example = load_example(clip, CONTROLS)
    assert example.curves.shape == (int(SECONDS * 30), 185)
    assert example.phones[1][2] == "M" and example.emotion == "neutral"
    jaw = example.curves[:, CONTROLS.index(JAW)]
    assert jaw[25:29].min() > 0.5 and jaw[:23].max() < 0.05, "the burst at 0.8 s"
    assert example.intensity[30] == pytest.approx(0.8, abs=1e-3)


def test_target_scores_1_and_a_late_copy_less(folder):
    chosen = ValidationSet.of(read_clips(folder), CONTROLS)
    targets = [example.curves for example in chosen.examples]
    strengths = [example.intensity for example in chosen.examples]
    right = chosen.score(Playback(targets, strengths))  # type: ignore[arg-type]
    assert right["lpe"] == right["epe"] == 0
    assert right["jaw_r"] == pytest.approx(1) and right["intensity_r"] == pytest.approx(1)
    assert right["auc"] == 1 and right["hits"] == 1
    assert right["score"] == pytest.approx(1)
    late = chosen.score(Playback(targets, strengths, lag=4))  # type: ignore[arg-type]
    assert late["score"] < 0.8 and late["lpe"] > 0
    still = [np.tile(CONTROLS.rest, (len(a), 1)) for a in targets]
    assert chosen.score(Playback(still, None))["score"] <= 0.5  # type: ignore[arg-type]


def test_model_gets_the_emotion_of_the_clip(folder):
    chosen = ValidationSet.of(read_clips(folder), CONTROLS)
    playback = Playback([e.curves for e in chosen.examples], None)
    scores = chosen.score(playback)  # type: ignore[arg-type]
    assert playback.emotions == [1, 3, 0], "clips 1, 3 and 5 are recordings: angry, sad, neutral"
    assert np.isnan(scores["intensity_r"]) and np.isfinite(scores["score"])


def test_recordings_are_chosen_before_synthetic_speech_and_at_most_60(folder):
    clips = read_clips(folder)
    recorded = [clip for clip in clips if clip.source == "recording"]
    assert len(ValidationSet.of(clips, CONTROLS).examples) == len(recorded) == 3
    synthetic = [clip for clip in clips if clip.source != "recording"]
    assert len(ValidationSet.of(synthetic, CONTROLS).examples) == 3
    assert len(ValidationSet.of(synthetic * 40, CONTROLS).examples) == MAX_CLIPS


def test_lips_together_is_the_mean_of_four():
    curves = np.zeros((2, 185), np.float32)
    curves[1, CONTROLS.index("CTRL_L_mouth_lipsTogetherU.ty")] = 1
    np.testing.assert_allclose(lips_together(curves, CONTROLS), [0, 0.25])
