"""Suggested emotions: the map by hand, the fit on voices that differ, the command."""

from types import SimpleNamespace

import numpy as np
import pytest
import soundfile
from typer.testing import CliRunner

from deitalk.cli import app
from deitalk.emotions import EMOTIONS, parse_emotion
from deitalk.errors import AudioError
from deitalk.evaluation.benchmark_curves import speechlike
from deitalk.pipeline import suggest
from deitalk.pipeline.suggest import NAMED, SURE, EmotionMap, emotion_map, pooled, suggest_emotion
from deitalk.training.suggestion import Voices, fit, score


def test_map_is_a_softmax_of_standardised_features():
    """Feature 3 is one spread above its mean: scores 2, 0, 0, 0."""
    found = EmotionMap(
        {
            "mean": np.array([2.0], np.float32),
            "spread": np.array([1.0], np.float32),
            "weight": np.array([[2.0], [0], [0], [0]], np.float32),
            "bias": np.zeros(4, np.float32),
        }
    )
    expected = np.exp([2, 0, 0, 0]) / (np.exp(2) + 3)
    np.testing.assert_allclose(found.probabilities(np.array([3.0], np.float32)), expected)


def test_pooling_leaves_silence_out():
    features = np.array([[1.0, 5], [3, 5], [100, 100]], np.float32)
    np.testing.assert_allclose(pooled(features, np.array([True, True, False])), [2, 5, 1, 0])


def voices(seed: int = 0) -> Voices:
    """Four classes on four axes; readers in a place of their own."""
    rng = np.random.default_rng(seed)
    classes = np.concatenate((np.repeat(np.arange(4), 60), np.zeros(60, int)))
    features = rng.normal(size=(300, 6)).astype(np.float32)
    features[np.arange(300), classes] += 8
    features[240:, 5] += 8
    splits = ["train", "validation", "test"] * 100
    return Voices(features, classes, splits, [i >= 240 for i in range(300)])


def test_fit_tells_classes_of_unseen_voices_and_readers_are_neutral():
    found = fit(voices())
    scores = score(found, voices(1), "test")
    assert scores["unweighted recall"] > 0.85
    assert scores["anger against sadness"] > 0.95
    assert scores["readers neutral"] == 1
    assert scores["right"] > scores["probability"] - 0.1
    mixed = voices()
    rng = np.random.default_rng(5)
    shuffled = mixed._replace(classes=rng.permutation(mixed.classes))
    assert score(fit(shuffled), mixed, "test")["unweighted recall"] < 0.45


def test_embedded_map_fits_the_features_of_default():
    from deitalk.models.checkpoint import load_model

    width = 2 * load_model(suggest.MODEL).frontend.output_size
    assert {name: value.shape for name, value in emotion_map().weights.items()} == {
        "mean": (width,), "spread": (width,), "weight": (4, width), "bias": (4,)
    }  # fmt: skip


@pytest.fixture
def certain(monkeypatch):
    """Replace the map by one whose answer is given."""

    def be(*probabilities: float) -> None:
        answer = SimpleNamespace(probabilities=lambda _: np.array(probabilities))
        monkeypatch.setattr(suggest, "emotion_map", lambda: answer)

    return be


def test_unsure_voices_are_neutral(certain):
    sound = speechlike(5.0)
    certain(0.1, 0.8, 0.05, 0.05)
    found = suggest_emotion(sound, sample_rate=16_000)
    assert found.label == "angry" and found.probability == 0.8
    assert set(found.probabilities) == set(NAMED)
    weights = found.track.at([0.0, 4.0])
    assert weights[:, EMOTIONS.index("angry")] == pytest.approx(0.8)
    assert weights.sum(axis=1) == pytest.approx(1)
    certain(0.15, SURE - 0.01, 0.06, 0.05)
    unsure = suggest_emotion(sound, sample_rate=16_000)
    assert unsure.label == "neutral" and (unsure.track.weights[:, 0] == 1).all()


def test_silence_is_refused():
    with pytest.raises(AudioError, match="less than half a second of speech"):
        suggest_emotion(np.zeros(32_000, np.float32), sample_rate=16_000)


def test_command_writes_a_track_that_animate_reads(certain, tmp_path):
    certain(0.1, 0.0, 0.9, 0.0)
    soundfile.write(tmp_path / "a.wav", speechlike(5.0), 16_000)
    done = CliRunner().invoke(
        app, ["suggest", f"{tmp_path}/a.wav", "-o", f"{tmp_path}/emotion.csv", "--json"]
    )
    assert done.exit_code == 0 and '"label": "happy"' in done.stdout
    track = parse_emotion(tmp_path / "emotion.csv")
    assert track.at([2.0])[0, EMOTIONS.index("happy")] == pytest.approx(0.9)
    again = CliRunner().invoke(
        app, ["suggest", f"{tmp_path}/a.wav", "-o", f"{tmp_path}/emotion.csv"]
    )
    assert again.exit_code != 0


def test_animate_takes_the_suggested_emotion(certain, tmp_path):
    certain(0.1, 0.0, 0.0, 0.9)
    soundfile.write(tmp_path / "a.wav", speechlike(2.0), 16_000)
    done = CliRunner().invoke(
        app, ["animate", f"{tmp_path}/a.wav", "-e", "auto", "-o", f"{tmp_path}/a.json"]
    )
    assert done.exit_code == 0, done.output
    assert "suggested from the voice: sad (0.90)" in done.output
    assert "emotion sad" in done.output
