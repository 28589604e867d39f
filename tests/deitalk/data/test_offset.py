"""Single clips that are early or late: by hand, on a built corpus, on lips measured on video."""

import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deitalk.audio.load import Recording, load_audio
from deitalk.data.checks import inspect_dataset
from deitalk.data.clips import read_clips
from deitalk.data.offset import LAGS, ClipLags, clip_lags, predicted_curves, vowel_band
from deitalk.research.corpus.build import Shard, build
from deitalk.research.corpus.engines import available_engines
from rig import RigCurves, default_controls, read_curves, write_curves

CONTROLS = default_controls()
JAW = "CTRL_C_jaw.ty"
SHIFTS = (-0.5, -0.2, -0.1, 0.1, 0.2, 0.5)
needs_espeak = pytest.mark.skipif(
    available_engines()["espeak"] is not None, reason=str(available_engines()["espeak"])
)


@pytest.fixture(scope="module")
def corpus(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("corpus")
    build(folder, [Shard("espeak-000", "espeak", 45.0, 28)], workers=1)
    return folder


def jaw_curves(jaw: np.ndarray, fps: float) -> RigCurves:
    values = np.tile(CONTROLS.rest, (len(jaw), 1))
    values[:, CONTROLS.index(JAW)] = jaw
    return RigCurves(values.astype(np.float32), CONTROLS.names, fps)


def shares(clips: Iterator[tuple[Recording, RigCurves]]) -> dict[float, float]:
    """Share of clips that are called shifted by what they were moved, within 67 ms; 0: by any.

    As in `deitalk data check`, a clip must be late by level and by the model.
    """
    found: dict[float, list[bool]] = {shift: [] for shift in (0.0, *SHIFTS)}
    for recording, curves in clips:
        predicted = predicted_curves(recording)
        for shift, answers in found.items():
            by_level, by_model = (
                clip_lags(curves, recording.waveform, predicted=each, offset=shift)
                for each in (None, predicted)
            )
            answer = by_level is not None and abs(by_level.lag) >= 0.05 and by_model.is_shifted
            right = shift == 0 or (by_model is not None and abs(by_model.lag - shift) < 0.067)
            answers.append(answer and right)
    return {shift: float(np.mean(answers)) for shift, answers in found.items()}


@pytest.mark.parametrize(
    ("best", "middle", "clear"),
    # 0.03 + 0.12 / 2 + 0.6 (1 - r): 0.15 for r = 0.9, 0.39 for r = 0.5
    [(0.9, 0.74, True), (0.9, 0.76, False), (0.5, 0.1, True), (0.5, 0.12, False)],
)
def test_lag_must_gain_more_where_the_correlation_is_low(best, middle, clear):
    scores = np.zeros(len(LAGS))
    scores[LAGS == 0], scores[np.isclose(LAGS, 0.15)] = 2 * middle**2, 2 * best**2
    lags = ClipLags(scores, 2, 5.0, 10.0)
    assert lags.lag == pytest.approx(0.15, abs=0.005)
    assert lags.is_clear == lags.is_shifted == clear
    near = replace(lags, scores=np.roll(scores, -9))
    near.scores[LAGS == 0] = 2 * middle**2
    assert not near.is_shifted


def test_short_clips_and_still_jaws_have_no_lag(rng):
    sound = rng.standard_normal(5 * 16000).astype(np.float32)
    assert clip_lags(jaw_curves(np.full(150, 0.3), 30), sound, predicted=None) is None
    moving = rng.random(150) * 0.5
    assert clip_lags(jaw_curves(moving, 30), sound, predicted=None) is not None
    assert clip_lags(jaw_curves(moving[:59], 30), sound, predicted=None) is None


def test_vowel_band_keeps_vowels_and_drops_hiss():
    t = np.arange(16000) / 16000
    low, high = np.sin(2 * np.pi * 500 * t), np.sin(2 * np.pi * 5000 * t)
    kept = vowel_band((low + high).astype(np.float32))
    np.testing.assert_allclose(kept, low, atol=1e-3)


@needs_espeak
def test_no_clip_of_a_built_corpus_is_called_shifted_and_moved_ones_are(corpus):
    (offset,) = [check for check in inspect_dataset(corpus).checks if check.name == "offset"]
    assert offset.level == "ok", offset.text
    found = shares(
        (load_audio(clip.audio), read_curves(clip.curves)) for clip in read_clips(corpus)[::2]
    )
    assert found.pop(0.0) == 0
    assert min(found.values()) >= 0.65 and np.mean(list(found.values())) >= 0.9, found


@needs_espeak
def test_one_shifted_clip_among_many_is_named(corpus, tmp_path):
    """Of speech: the tones of `tests.dataset` hold no phones that the network could follow."""
    folder = tmp_path / "moved"
    shutil.copytree(corpus, folder)
    clip = list(read_clips(folder))[3]
    curves = read_curves(clip.curves)
    moved = np.roll(curves.values, round(0.25 * curves.fps), axis=0)
    write_curves(clip.curves, RigCurves(moved, curves.names, fps=curves.fps))
    (offset,) = [check for check in inspect_dataset(folder).checks if check.name == "offset"]
    assert offset.level == "warning" and offset.text.startswith("1 clips seem shifted")
    found = re.search(rf"{clip.name} \(\+(\d+) ms\)", offset.text)
    assert found is not None and int(found[1]) == pytest.approx(250, abs=30)


def test_real_mouths_on_video_are_seldom_called_shifted(shared):
    folder = shared / "data" / "lips"
    columns = json.loads((folder / "columns.json").read_text())["columns"]
    table = pd.read_csv(folder / "clips.csv").groupby("speaker").head(5)

    def clips() -> Iterator[tuple[Recording, RigCurves]]:
        for name in table["clip"]:
            recording = load_audio(folder / "grid" / f"{name}.opus")
            with np.load(folder / "grid" / f"{name}.npz") as measured:
                chin = measured["meas"][:, columns.index("jaw")].astype(np.float64)
            at = np.arange(int(recording.duration * 60)) / 60
            chin = np.interp(at, (np.arange(len(chin)) + 0.5) / 25, chin)
            yield recording, jaw_curves((chin - chin.min()) / np.ptp(chin), 60)

    found = shares(clips())
    assert len(table) == 30
    assert found[0.0] <= 0.07, found
    assert min(found[shift] for shift in SHIFTS if abs(shift) > 0.1) >= 0.6, found
