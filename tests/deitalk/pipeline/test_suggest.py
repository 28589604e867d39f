"""Suggested emotions: the map by hand, the fit on voices that differ, the command."""

from types import SimpleNamespace

import numpy as np
import pytest
import soundfile

from deitalk.audio.vocal_strength import BANDS
from deitalk.emotions import EMOTIONS
from deitalk.errors import AudioError
from deitalk.pipeline import suggest
from deitalk.pipeline.curves import animate
from deitalk.pipeline.speech import Speech
from deitalk.pipeline.suggest import (
    NAMED,
    SIZE,
    SURE,
    EmotionMap,
    VoiceFrames,
    emotion_map,
    manner,
    suggest_emotion,
)
from deitalk.research.evaluation.benchmark_curves import speechlike
from deitalk.research.training.suggestion import (
    ASKED,
    Label,
    Voices,
    cooled,
    cross_validate,
    fit,
    label_of,
    predict,
    score,
)
from tests.command import ran
from tests.each import each


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


def frames_of(sound) -> VoiceFrames:
    """A recording whose speech features are the frames' numbers."""
    speech = Speech.of(sound)
    features = np.repeat(np.arange(speech.n_frames, dtype=np.float32)[:, None], 2, axis=1)
    return VoiceFrames(features, speech.prosody, speech.activity)


def test_silence_and_gain_change_no_number():
    sound = speechlike(2.0)
    frames = frames_of(sound)
    numbers = frames.numbers()
    spoken = np.flatnonzero(frames.activity)
    assert numbers[:2] == pytest.approx(spoken.mean()) and len(numbers) == 4 + SIZE
    np.testing.assert_allclose(frames_of(0.25 * sound).numbers(), numbers, rtol=0.02, atol=0.02)
    padded = frames._replace(features=np.where(frames.activity[:, None] > 0, frames.features, 1e6))
    np.testing.assert_array_equal(padded.numbers(), numbers)


def test_manner_tells_pitch_and_its_range():
    """A steady voice of 200 Hz, and one that glides over an octave around it."""
    time = np.arange(32_000) / 16_000
    voices = []
    for octaves in (0.0, 0.5):
        phase = np.cumsum(200 * 2 ** (octaves * np.sin(2 * np.pi * time))) / 16_000
        sound = sum(np.sin(2 * np.pi * k * phase) / k for k in range(1, 12))
        voices.append(Speech.of((0.1 * sound).astype(np.float32)))
    first = 3 * BANDS
    said = [(v.prosody, np.ones(v.n_frames, np.float32)) for v in voices]
    steady, gliding = (manner(*voice)[first : first + 14] for voice in said)
    assert steady[2] == pytest.approx(12, abs=0.3) and abs(steady[5]) < 0.3
    assert gliding[2] == pytest.approx(12, abs=1) and gliding[5] == pytest.approx(12, abs=1.5)


@each(
    ("vote", "asked", "majority", "shares"),
    [
        ("S", "SAD", 3, (0, 0, 0, 1)),
        ("N", "SAD", 0, (1 - ASKED, 0, 0, ASKED)),
        ("N", "DIS", 0, (1, 0, 0, 0)),
        ("H:N", "DIS", -1, (0.5, 0, 0.5, 0)),
        ("D", "ANG", -1, (0, 1, 0, 0)),
    ],
)
def test_label_is_the_majority_and_the_rest_the_emotion_asked(vote, asked, majority, shares):
    label = label_of(vote, asked)
    assert label.majority == majority and label.shares == pytest.approx(shares)
    assert (label.weight == 1) == (majority >= 0)


def voices(seed: int = 0, shuffled: bool = False) -> Voices:
    """Four classes on four axes; readers in a place of their own; 30 speakers, 6 for tests."""
    rng = np.random.default_rng(seed)
    classes = np.concatenate((np.repeat(np.arange(4), 60), np.zeros(60, int)))
    features = rng.normal(size=(300, 6)).astype(np.float32)
    features[np.arange(300), classes] += 8
    features[240:, 5] += 8
    if shuffled:
        classes = rng.permutation(classes)
    labels = [Label(k, tuple(np.eye(4)[k]), 1.0, k) for k in classes.tolist()]
    speakers = [str(i % 30) for i in range(300)]
    splits = ["test" if i % 5 == 0 else "train" if i % 5 < 3 else "validation" for i in range(300)]
    return Voices(features, labels, speakers, splits, [i >= 240 for i in range(300)])


def test_fit_tells_classes_of_unseen_voices_and_readers_are_neutral():
    fitted, unseen = voices(), voices(1)
    found = fit(fitted, fitted.having("validation"))
    scores = score(predict(found, unseen.numbers), unseen, "test")
    assert scores["unweighted recall"] > 0.85
    assert scores["anger against sadness"] > 0.95
    assert scores["readers neutral"] == 1
    mixed = voices(shuffled=True)
    p = predict(fit(mixed, mixed.having("validation")), unseen.numbers)
    assert score(p, unseen, "test")["unweighted recall"] < 0.45


def test_temperature_makes_probabilities_true():
    """Three of ten labels are drawn anew: the most probable class is right in .7 + .3 / 4."""
    rng = np.random.default_rng(3)
    given = voices()
    drawn = [
        int(rng.integers(4)) if rng.random() < 0.3 else label.majority for label in given.labels
    ]
    noisy = given._replace(labels=[Label(k, tuple(np.eye(4)[k]), 1.0, k) for k in drawn])
    p, temperature = cross_validate(noisy)
    scores = score(p, noisy, "validation")
    assert scores["calibration error"] < 0.12
    found = fit(noisy, noisy.having("validation"))
    warm, sharp = (
        predict(cooled(found, t), noisy.numbers).max(axis=1).mean()
        for t in (2 * temperature, temperature)
    )
    assert warm < sharp


def test_embedded_map_fits_the_features_of_default():
    from deitalk.models.checkpoint import load_model

    width = 2 * load_model(suggest.MODEL).frontend.output_size + SIZE
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


def test_too_little_speech_is_animated_as_neutral():
    take = animate(speechlike(0.3), "auto", sample_rate=16_000, life="off")
    plain = animate(speechlike(0.3), "neutral", sample_rate=16_000, life="off")
    assert (take.curves.values == plain.curves.values).all()
    assert take.acting.settings == plain.acting.settings and take.suggestion is None
    assert any("no emotion can be suggested: neutral" in note for note in take.recording.warnings)


def test_animate_takes_the_suggested_emotion(certain, tmp_path):
    certain(0.1, 0.0, 0.0, 0.9)
    soundfile.write(tmp_path / "a.wav", speechlike(2.0), 16_000)
    done = ran("animate", f"{tmp_path}/a.wav", "-e", "auto", "-o", f"{tmp_path}/a.json")
    assert "suggested from the voice: sad (0.90)" in done.output
    assert "emotion sad" in done.output
