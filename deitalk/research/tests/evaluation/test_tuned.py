"""What a tuning left of its base, of a model beside itself and one whose emotions are none."""

import copy
import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch

from deitalk.audio.load import load_audio, write_wav
from deitalk.data.clips import Clip
from deitalk.emotions import EMOTIONS
from deitalk.errors import DataError
from deitalk.models.checkpoint import load_model
from deitalk.models.folder import embedded_models
from deitalk.research.evaluation.benchmark_curves import speechlike
from deitalk.research.evaluation.clip_scores import animated
from deitalk.research.evaluation.tuned import ALONE, OVER_NEUTRAL, evaluate
from rig import write_curves
from tests.command import deitalk

pytestmark = pytest.mark.skipif("live" not in embedded_models(), reason="needs the weights")


@pytest.fixture(scope="module")
def sounds(tmp_path_factory):
    folder = tmp_path_factory.mktemp("readers")
    for name, seconds in (("a", 1.0), ("b", 1.5)):
        write_wav(folder / f"{name}.wav", np.pad(speechlike(seconds), 3000))
    return folder


def test_a_model_is_as_its_base_and_one_without_emotions_is_not(sounds):
    base = load_model("live")
    flat = copy.deepcopy(base)
    with torch.no_grad():
        style = flat.rig_decoder.style.weight
        style.copy_(style[:, :1].expand_as(style))
    paths = sorted(sounds.iterdir())
    same = evaluate({"after": base, "before": base}, sounds=paths)["emotions"]
    other = evaluate({"after": flat, "before": base}, sounds=paths)["emotions"]
    for name, row in same.items():
        assert row["change r with base"] == pytest.approx(1)
        assert row["jaw range over neutral"] == row["that of the base"]
        assert other[name]["jaw range over neutral"] == pytest.approx(1)


def test_a_smile_that_captures_lack_is_told_from_a_mouth_that_does_not_follow(sounds, tmp_path):
    base = load_model("live")
    wrecked = copy.deepcopy(base)
    with torch.no_grad():
        wrecked.rig_decoder.style.weight[:, EMOTIONS.index("sad")] *= 30
    rng, clips = np.random.default_rng(0), []
    for sound in sorted(sounds.glob("*.wav")):
        curves = animated(load_audio(sound), "neutral", base, raw=True).curves
        noise = rng.normal(0, 0.015, curves.values.shape)
        captured = replace(curves, values=(curves.values + noise).astype(np.float32))
        write_curves(path := tmp_path / f"{sound.stem}.npz", captured)
        labels = "neutral", "anna", "test", "", "recording"
        clips.append(Clip(sound.stem, sound, path, *labels, 0.0, None, None))
    same, other = (
        evaluate({"after": model, "before": base}, clips=clips)["emotions"]["sad"]
        for model in (base, wrecked)
    )
    error, timing = OVER_NEUTRAL
    assert same[error] == pytest.approx(same[ALONE], rel=0.1) and same[ALONE] > 1.3
    assert same[timing] < other[timing] / 1.15, (same, other)
    assert other[error] > other[ALONE]
    with pytest.raises(DataError, match="none of the 2 clips is neutral"):
        evaluate({"after": base, "before": base}, clips=[replace(c, emotion="sad") for c in clips])


def test_contacts_and_strengths_by_the_command(sounds, tmp_path):
    phones = "clip,start,end,label,kind\na,0.2,0.3,m,closure\na,0.3,0.6,a,vowel\n"
    (sounds / "phones.csv").write_text(phones)
    rows = [("a.wav", "normal"), ("b.wav", "strong")]
    table = [{"path": p, "actor": "1", "emotion": "happy", "level": level} for p, level in rows]
    pd.DataFrame(table).to_csv(sounds / "actors.csv", index=False)
    given = ["tuned", "live", "--from", "live", "--contacts", sounds / "phones.csv"]
    done = deitalk(*given, "--acted", sounds / "actors.csv", "-o", tmp_path / "report.json")
    assert not done.code, done.err
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["contacts"]["after"] == report["contacts"]["before"]
    assert report["strength"]["after"] == report["strength"]["before"]
    assert set(report["strength"]["after"]) == {
        "intensity: high above low",
        "whole face: high above low",
    }
    done = deitalk("tuned", "live")
    assert done.code and "nothing to score on" in done.err
