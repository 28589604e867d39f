"""Suggested emotions: the map by hand, the fit on voices that differ, the command."""

from types import SimpleNamespace

import numpy as np
import pytest
import soundfile

from deitalk.data.augment_waveform import Surroundings
from deitalk.emotions import EMOTIONS
from deitalk.errors import AudioError, DataError
from deitalk.pipeline import suggest
from deitalk.pipeline.curves import animate
from deitalk.pipeline.speech import Speech
from deitalk.pipeline.suggest import NAMED, EmotionMap, VoiceFrames, suggest_emotion
from deitalk.research.evaluation.benchmark_curves import speechlike
from deitalk.research.training.suggestion import (
    CODECS,
    Voices,
    adjusted,
    altered,
    coded,
    cross_validate,
    fit,
    fit_ridge,
    predict,
    score,
)
from tests.command import ran


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


def test_silence_and_gain_change_no_number():
    """Features of frames without speech do not count; gain is taken off before the encoder."""
    from deitalk.models.checkpoint import load_model

    network, sound = load_model(suggest.MODEL), speechlike(2.0)
    frames = VoiceFrames.of(network, Speech.of(sound))
    numbers = frames.numbers()
    assert len(numbers) == 2 * network.frontend.output_size
    loud = VoiceFrames.of(network, Speech.of(4 * sound)).numbers()
    np.testing.assert_allclose(loud, numbers, rtol=0.02, atol=0.02)
    padded = frames._replace(features=np.where(frames.activity[:, None] > 0, frames.features, 1e6))
    np.testing.assert_array_equal(padded.numbers(), numbers)


CORPUS, VOICE = 5, 6
"""Axes that part readers from actors, and copies from recordings."""


def voices(seed: int = 0, *, shuffled: bool = False, apart: float = 8.0) -> Voices:
    """Four classes on four axes, with copies; readers in a place of their own; 30 speakers."""
    rng = np.random.default_rng(seed)
    places = np.concatenate((np.repeat(np.arange(4), 60), np.zeros(60, int)))
    numbers = rng.normal(size=(300, 8)).astype(np.float32)
    numbers[np.arange(300), places] += 4
    numbers[240:, CORPUS] += apart
    originals = np.arange(300)
    is_copy = np.zeros(300, bool)
    is_copy[1:240:3] = True
    originals[is_copy] -= 1
    numbers[is_copy] = numbers[originals[is_copy]]
    numbers[is_copy, VOICE] += rng.normal(0, 5, is_copy.sum())
    places[is_copy] = places[originals[is_copy]]
    if shuffled:
        places = rng.permutation(places)
    speakers = [str(i // 3 % 30) for i in range(300)]
    splits = ["test" if int(name) % 5 == 0 else "train" for name in speakers]
    corpora = [""] * 240 + ["readers"] * 60
    levels = np.zeros(300, np.float32)
    return Voices(numbers, places, speakers, splits, corpora, originals, levels)


def test_fit_tells_classes_of_unseen_voices_and_readers_are_neutral():
    fitted, unseen = voices(), voices(1)
    found = fit(fitted, fitted.having("validation"))
    scores = score(predict(found, unseen.numbers), unseen, "test")
    assert scores["unweighted recall"] > 0.9 and scores["anger against sadness"] > 0.95
    assert scores["readers neutral"] > 0.95
    mixed = voices(shuffled=True)
    p = predict(fit(mixed, mixed.having("validation")), unseen.numbers)
    assert score(p, unseen, "test")["unweighted recall"] < 0.5


def test_the_corpus_and_what_alters_a_copy_are_no_cue():
    """Actors recorded as readers are: plain regression hears neutral, the map the emotion."""
    fitted, elsewhere = voices(), voices(1)
    elsewhere.numbers[:240, CORPUS] += 8
    recalls = []
    for by in (fit, fit_ridge):
        found = by(fitted, fitted.having("validation"))
        scores = score(predict(found, elsewhere.numbers), elsewhere, "test")
        recalls.append(scores["unweighted recall"])
        weight = np.abs(found.weights["weight"])
        if by is fit:
            assert weight[:, [CORPUS, VOICE]].max() < 0.15 * weight[:, :4].max()
    assert recalls[0] > recalls[1] and recalls[0] > 0.85


def test_a_class_without_actors_is_refused():
    fitted = voices()
    with pytest.raises(DataError, match="no actor to fit was asked for sad"):
        fit(fitted, fitted.having("validation") & (fitted.places != NAMED.index("sad")))


def test_readers_that_no_fit_had_are_neutral_and_probabilities_true():
    """Three of ten labels are drawn anew: the most probable class is right in .7 + .3 / 4."""
    rng = np.random.default_rng(3)
    given = voices(apart=0)
    drawn = np.where(rng.random(300) < 0.3, rng.integers(4, size=300), given.places)
    noisy = given._replace(places=np.where(given.is_reader, 0, drawn[given.originals]))
    p, temperature, added = cross_validate(noisy)
    scores = score(p, noisy, "validation")
    assert scores["readers neutral"] >= 0.95
    assert scores["calibration error"] < 0.15
    found = fit(noisy, noisy.having("validation"))
    warm, sharp = (
        predict(adjusted(found, t, added), noisy.numbers).max(axis=1).mean()
        for t in (2 * temperature, temperature)
    )
    assert warm < sharp


def test_adjusted_adds_to_the_score_of_neutral_and_divides():
    """Scores 0 0 0 0 with log 3 for neutral at temperature 1: three in six."""
    zero = np.zeros((4, 1), np.float32)
    plain = {"mean": zero[0], "spread": zero[0] + 1, "weight": zero, "bias": zero[:, 0]}
    found = adjusted(EmotionMap(plain), 1.0, np.log(3)).probabilities(zero[0])
    np.testing.assert_allclose(found, [0.5, 1 / 6, 1 / 6, 1 / 6], rtol=1e-6)


@pytest.mark.parametrize("codec", range(len(CODECS)))
def test_coded_sounds_are_as_long_and_as_loud(codec):
    """Codecs delay by at most a frame of theirs."""

    class Chosen:
        def integers(self, count):
            return codec

    sound = speechlike(1.5)
    heard = coded(sound, Chosen())
    assert len(heard) == len(sound) and heard.std() == pytest.approx(sound.std(), rel=0.15)
    assert not np.array_equal(heard, sound)


def test_altered_copies_change_rate_and_level_and_are_of_the_seed():
    sound = speechlike(2.0)
    first, again, other = (
        altered(sound, np.random.default_rng(seed), Surroundings()) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert len(first) != len(other) and np.isfinite(other).all()
    assert all(len(sound) / 1.19 < len(copy) < len(sound) / 0.84 for copy in (first, other))


@pytest.fixture
def certain(monkeypatch):
    """Replace the map by one whose answer is given."""

    def be(*probabilities: float) -> None:
        answer = SimpleNamespace(probabilities=lambda _: np.array(probabilities))
        monkeypatch.setattr(suggest, "emotion_map", lambda: answer)

    return be


def test_the_most_probable_emotion_is_suggested_and_neutral_only_where_it_is_that(certain):
    sound = speechlike(5.0)
    certain(0.1, 0.8, 0.05, 0.05)
    found = suggest_emotion(sound, sample_rate=16_000)
    assert found.label == "angry" and found.probability == 0.8
    assert set(found.probabilities) == set(NAMED)
    weights = found.track.at([0.0, 4.0])
    assert weights[:, EMOTIONS.index("angry")] == pytest.approx(0.8)
    assert weights.sum(axis=1) == pytest.approx(1)
    certain(0.28, 0.3, 0.21, 0.21)
    close = suggest_emotion(sound, sample_rate=16_000)
    assert close.label == "angry" and close.line == "angry (0.30)"
    certain(0.31, 0.3, 0.2, 0.19)
    neutral = suggest_emotion(sound, sample_rate=16_000)
    assert neutral.label == "neutral" and (neutral.track.weights[:, 0] == 1).all()


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
