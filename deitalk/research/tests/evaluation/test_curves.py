"""Evaluation: cases by hand, and the embedded weights on voices outside their training."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch

from deitalk.data.clips import read_clips
from deitalk.emotions import EMOTIONS
from deitalk.errors import DataError
from deitalk.evaluation.report import as_json
from deitalk.evaluation.smoothness import load_example
from deitalk.models.checkpoint import load_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import embedded_models
from deitalk.pipeline.curves import Performance
from deitalk.research.config import read_training
from deitalk.research.evaluation.curves import _groups, evaluate
from deitalk.research.evaluation.report import as_markdown
from rig import RigCurves, default_controls
from tests.conftest import SHARED
from tests.dataset import write_dataset

pytestmark = pytest.mark.usefixtures("one_analysis")


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """The whole evaluation of an untrained model on a folder written by hand."""
    folder = write_dataset(tmp_path_factory.mktemp("data"), 1, 2)
    torch.manual_seed(0)
    model = DEITalk(
        read_training(Path(__file__).resolve().parents[4] / "configs/tiny.yaml").model
    ).eval()
    seen = []
    scores = evaluate(
        model, folder, split="validation", probes=1, noise="pink", progress=seen.append
    )
    assert seen == sorted(seen)
    assert seen[-1] == 1
    return scores


def test_report_has_every_score(report):
    scores = report["groups"]["test"]
    assert scores["clips"] == 2
    assert scores["bilabials"] == 2
    assert "r C_jaw.ty" in scores
    assert report["phones"]["test"]["closure"]["M"]["n"] == 2
    assert set(report["styles"]["test"]["styles"]) == set(EMOTIONS)
    assert len(report["styles"]["test"]["distances"]) == 10
    assert {"intensity_rho", "network_rho", "index_rho", "level_rho"} < set(
        report["contours"]["test"]
    )
    assert set(scores) - set(report["network"]["test"]) == {"index_rho", "level_rho", "network_rho"}
    assert list(report["noise"]) == ["clean", "20 dB", "10 dB", "5 dB", "0 dB"]


def test_report_is_written_as_tables(report):
    text = as_markdown(report)
    assert "| clips | 2 |" in text
    assert "lip (86" in text
    assert "| test | closure | M | 2 |" in text
    assert "The network alone:" in text
    assert "| separation |" in text
    assert "nan" not in text
    assert json.loads(as_json(report))["groups"]["test"]["clips"] == 2
    assert "NaN" not in as_json(report)


def test_model_that_gives_the_target_has_perfect_scores(tmp_path, monkeypatch):
    folder = write_dataset(tmp_path, 0, 2)
    clips = {clip.audio.name: clip for clip in read_clips(folder, "validation")}
    controls = default_controls()

    def perfect(recording, emotion, rules, **_):
        clip = clips[Path(recording.source).name]
        values = load_example(clip, controls).curves
        curves = RigCurves(values if rules else 0 * values, controls.names, fps=30)
        zeros = np.zeros(len(curves.values), np.float32)
        return Performance(curves, curves, zeros, zeros, recording, 0)

    monkeypatch.setattr("deitalk.research.evaluation.clip_scores.animate", perfect)
    model = SimpleNamespace(controls=controls, is_causal=False)
    report = evaluate(model, folder, split="validation", probes=0)
    scores, still = report["groups"]["test"], report["network"]["test"]
    assert scores["lpe"] == 0
    assert scores["jaw_r"] == pytest.approx(1)
    assert scores["bilabial_frame_auc"] == 1
    assert scores["bilabial_hits_at_5_percent"] == 1
    assert scores["jaw_lag_ms"] == pytest.approx(0, abs=1)
    assert still["lpe"] > 0 and np.isnan(still["jaw_r"]) and still["bilabial_frame_auc"] == 0.5


def test_an_empty_split_is_refused(tmp_path):
    folder = write_dataset(tmp_path, 1, 0)
    with pytest.raises(DataError, match="no clips in the split 'test'"):
        evaluate(SimpleNamespace(controls=default_controls()), folder)


def test_noise_without_a_probe_is_refused(tmp_path):
    """Noise is added to the probed recordings: without one nothing would be reported."""
    with pytest.raises(DataError, match="probes=0: noise is added"):
        evaluate(load_model(), tmp_path, noise="pink", probes=0)


def test_groups_by_source_language_and_age(tmp_path):
    folder = write_dataset(tmp_path, 0, 6)
    table = pd.read_csv(folder / "clips.csv")
    table["language"] = ["en", "de", "en-gb", "", "en", "de"]
    table.to_csv(folder / "clips.csv", index=False)
    groups = {name: len(clips) for name, clips in _groups(folder, "validation").items()}
    assert groups == {"test": 4, "test de": 2}
    table["age"] = ["15", "16", "", "40", "unknown", "6"]
    table.to_csv(folder / "clips.csv", index=False)
    groups = {
        name: [c.neutral.name for c in clips]
        for name, clips in _groups(folder, "validation").items()
    }
    assert groups == {
        "test": ["clip2", "clip4"],
        "test-adults": ["clip3"],
        "test-adults de": ["clip1"],
        "test-children": ["clip0"],
        "test-children de": ["clip5"],
    }


@pytest.fixture(scope="module")
def held_out(tmp_path_factory):
    """Recordings of test speakers, aligned, as a dataset folder."""
    pytest.importorskip("pocketsphinx", reason="alignment needs pocketsphinx")
    if not (SHARED / "data/speech").is_dir():
        pytest.skip("needs the development data in ../shared")
    from deitalk.research.corpus.build import build, recorded_shards
    from deitalk.research.corpus.performance import split_of
    from deitalk.research.corpus.recordings import recordings

    everything = recordings(SHARED / "data/speech")
    readers = [r for r in everything if r.speaker.startswith("librispeech")]
    chosen = [r for r in readers if split_of(r.speaker) == "test"][::6]
    out = tmp_path_factory.mktemp("held_out")
    build(out, recorded_shards(chosen, 0, None), workers=1)
    return out


@pytest.mark.slow
def test_default_weights_follow_human_voices(held_out):
    if "default" not in embedded_models():
        pytest.skip("the default weights are not in this checkout")
    scores = evaluate(load_model("default"), held_out, probes=0)["groups"]["librispeech"]
    assert scores["bilabials"] > 50
    assert scores["bilabial_window_auc"] >= 0.97
    assert scores["jaw_r"] >= 0.84
    assert scores["shut_on_other_sounds"] <= 0.04
    assert scores["loudness_bilabial_window_auc"] < scores["bilabial_window_auc"] - 0.1
    assert scores["loudness_jaw_r"] < scores["jaw_r"]
    assert abs(scores["jaw_lag_ms"]) < 17
    assert scores["opening_in_silence"] <= 0.04
