"""Lag of curves behind their sound: by hand, on a built corpus, on lips measured on video."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deitalk.audio.load import Recording, load_audio
from deitalk.data.checks import inspect_dataset
from deitalk.data.clips import read_clips
from deitalk.data.offset import (
    REACH,
    is_clear,
    is_shifted,
    jaw_motion,
    lag_correlations,
    loudness,
    model_lags,
    peak,
    vowel_band,
)
from deitalk.research.corpus.build import Shard, build
from deitalk.research.corpus.engines import available_engines
from rig import read_curves
from tests.each import each

SHIFTS = (-0.5, -0.2, -0.1, 0.1, 0.2, 0.5)
needs_espeak = pytest.mark.skipif(
    available_engines()["espeak"] is not None, reason=str(available_engines()["espeak"])
)
Clips = list[tuple[Recording, np.ndarray]]


@pytest.fixture(scope="module")
def corpus(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("corpus")
    build(folder, [Shard("espeak-000", "espeak", 45.0, 28)], workers=1)
    return folder


def lags_of(recording: Recording, jaw: np.ndarray) -> np.ndarray | None:
    return model_lags(
        recording, lag_correlations(loudness(vowel_band(recording.waveform)), jaw), jaw
    )


def moved(jaw: np.ndarray, seconds: float) -> np.ndarray:
    """The jaw so much later; its ends are held."""
    return jaw[np.clip(np.arange(len(jaw)) - round(60 * seconds), 0, len(jaw) - 1)]


def shares(clips: Iterator[tuple[Recording, np.ndarray]]) -> dict[float, float]:
    """Share of clips that are called shifted by what they were moved, within 67 ms; 0: by any."""
    found: dict[float, list[bool]] = {shift: [] for shift in (0.0, *SHIFTS)}
    for recording, jaw in clips:
        for shift, answers in found.items():
            lags = lags_of(recording, moved(jaw, shift))
            answer = lags is not None and is_shifted(lags)
            right = shift == 0 or (lags is not None and abs(peak(lags) / 60 - shift) < 0.067)
            answers.append(answer and right)
    return {shift: float(np.mean(answers)) for shift, answers in found.items()}


def test_lag_is_that_of_the_delay():
    signal = np.random.default_rng(0).standard_normal(180)
    for delay in (-30, -7, 0, 12, 30):
        lags = lag_correlations(signal, np.roll(signal, delay))
        assert peak(lags) == delay and lags[REACH + delay] == pytest.approx(1)


def test_short_clips_and_still_jaws_have_no_lag():
    signal = np.random.default_rng(0).standard_normal(180)
    assert np.isnan(lag_correlations(signal[:119], signal[:119])).all()
    assert np.isnan(lag_correlations(signal, np.zeros(180))).all()
    half = np.concatenate([np.zeros(90), signal[:90]])
    assert np.isfinite(lag_correlations(half, np.concatenate([np.zeros(150), signal[:30]]))).all()
    assert not is_shifted(np.full(61, np.nan))


@each(
    ("best", "middle", "clear"),
    # 0.03 + 0.6 (1 - r): 0.09 for r = 0.9, 0.33 for r = 0.5
    [(0.9, 0.8, True), (0.9, 0.82, False), (0.5, 0.16, True), (0.5, 0.18, False)],
)
def test_lag_must_gain_more_where_the_correlation_is_low(best, middle, clear):
    lags = np.zeros(61)
    lags[REACH], lags[REACH + 9] = middle, best
    assert is_clear(lags) == clear
    assert is_shifted(lags) == clear
    near = np.zeros(61)
    near[REACH], near[REACH + 4] = middle, best
    assert not is_shifted(near)


def test_vowel_band_keeps_vowels_and_drops_hiss():
    t = np.arange(16000) / 16000
    low, high = np.sin(2 * np.pi * 500 * t), np.sin(2 * np.pi * 5000 * t)
    kept = vowel_band((low + high).astype(np.float32))
    np.testing.assert_allclose(kept, low, atol=1e-3)


@needs_espeak
def test_no_clip_of_a_built_corpus_is_called_shifted_and_moved_ones_are(corpus):
    (offset,) = [check for check in inspect_dataset(corpus).checks if check.name == "offset"]
    assert offset.level == "ok", offset.text

    def clips() -> Iterator[tuple[Recording, np.ndarray]]:
        for clip in read_clips(corpus)[::2]:
            recording, curves = load_audio(clip.audio), read_curves(clip.curves)
            yield recording, jaw_motion(curves, 0.0, recording.duration)

    found = shares(clips())
    assert found.pop(0.0) == 0
    assert min(found.values()) >= 0.65 and np.mean(list(found.values())) >= 0.9, found


def test_real_mouths_on_video_are_seldom_called_shifted(shared):
    folder = shared / "data" / "lips"
    columns = json.loads((folder / "columns.json").read_text())["columns"]
    table = pd.read_csv(folder / "clips.csv").groupby("speaker").head(5)

    def clips() -> Iterator[tuple[Recording, np.ndarray]]:
        for name in table["clip"]:
            recording = load_audio(folder / "grid" / f"{name}.opus")
            with np.load(folder / "grid" / f"{name}.npz") as measured:
                chin = measured["meas"][:, columns.index("jaw")].astype(np.float64)
            at = np.arange(int(recording.duration * 60)) / 60
            yield recording, np.interp(at, (np.arange(len(chin)) + 0.5) / 25, chin)

    found = shares(clips())
    assert len(table) == 30
    assert found[0.0] <= 0.07, found
    assert found[-0.5] >= 0.7 and found[0.5] >= 0.3, found
