"""A model fitted to a take: which style, how far and where from its controls move."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest

from deitalk.data.clips import read_clips
from deitalk.evaluation.smoothness import load_example, predict
from deitalk.models.checkpoint import load_model
from deitalk.training.tuning import recipe as recipes
from deitalk.training.tuning import ridge
from deitalk.training.tuning.fitting import fit_model
from deitalk.training.tuning.task import finetune
from rig import RigCurves, write_curves
from tests.command import deitalk, ran
from tests.deitalk.training.conftest import CONTROLS, recipe, relabelled


@pytest.fixture(scope="module")
def two_actors(base, data, tmp_path_factory):
    """A model of anna and ben, who opens the mouth further, and its dataset."""
    place = tmp_path_factory.mktemp("two")
    relabelled(data, place / "data", emotion="neutral", known="", speaker=["anna", "ben"] * 3)
    for clip in read_clips(place / "data"):
        example = load_example(clip, CONTROLS)
        share = 0.4 if clip.speaker == "anna" else 0.9
        values = CONTROLS.rest + share * (example.curves - CONTROLS.rest)
        write_curves(clip.curves, RigCurves(values.astype(np.float32), CONTROLS.names, 30.0))
    finetune(recipe(base, "train.steps=0"), place / "data", place / "run")
    return place / "run/best", place / "data"


def errors(model, clips):
    pairs = [(predict(model, e)[0], e.curves) for e in (load_example(c, CONTROLS) for c in clips)]
    return sum(float(np.square(a - b).sum()) for a, b in pairs)


@pytest.mark.parametrize("actor", ["anna", "ben"])
def test_the_nearest_style_is_found_and_actors_stay(two_actors, actor):
    model, clips = load_model(two_actors[0]), read_clips(two_actors[1])
    own = [clip for clip in clips if clip.speaker == actor][:1]
    found = fit_model(model, own)
    assert found.style == actor and found.error < 0.9
    nobody = load_example(own[0], CONTROLS)._replace(speaker="")
    before, after = (
        float(np.square(predict(m, nobody)[0] - nobody.curves).sum()) for m in (model, found.model)
    )
    assert after < 0.9 * before
    assert errors(found.model, clips) == pytest.approx(errors(model, clips), rel=1e-3)


def test_actors_of_many_stay_when_their_model_is_fitted(two_actors, base, tmp_path, monkeypatch):
    """Many actors have offsets alone; a face that is scaled has a map of its own."""
    for module in (recipes, ridge):
        monkeypatch.setattr(module, "MANY", 2)
    finetune(recipe(base, "train.steps=0"), two_actors[1], tmp_path / "run")
    many, clips = load_model(tmp_path / "run/best"), read_clips(two_actors[1])
    assert many.config.actor_layers == "offsets"
    assert many.rig_decoder.actor_layers.weight.numel() == 0
    bens = [clip for clip in clips if clip.speaker == "ben"][:1]
    other = tmp_path / "ben"
    shutil.copytree(two_actors[1], other)
    table = pd.read_csv(other / "clips.csv", dtype=str, keep_default_na=False)
    table[table["clip"] == bens[0].name].to_csv(other / "clips.csv", index=False)
    ran("model", "fit", tmp_path / "run/best", other, "-o", tmp_path / "fitted")
    fitted = load_model(tmp_path / "fitted")
    assert errors(fitted, clips) == pytest.approx(errors(many, clips), rel=1e-3)
    nobody = [predict(m, load_example(bens[0], CONTROLS)._replace(speaker=""))[0]
              for m in (many, fitted)]  # fmt: skip
    assert np.abs(nobody[0] - nobody[1]).max() > 0.01


@pytest.mark.parametrize(("gain", "offset"), [(1.5, 0.0), (0.6, 0.0), (1.0, 0.15), (1.3, 0.1)])
def test_gain_and_offset_of_a_face_are_found(base, two_actors, tmp_path, gain, offset):
    """Curves of the model itself, moved; as far as 5 s of its own face let 9 s."""
    model, place = load_model(base), CONTROLS.index("CTRL_C_jaw.ty")
    clips = read_clips(two_actors[1])
    for clip in clips:
        example = load_example(clip, CONTROLS)
        values = predict(model, example)[0]
        values[:, place] = gain * values[:, place] + offset
        path = tmp_path / clip.curves.name
        write_curves(path, RigCurves(values, CONTROLS.names, 30.0))
        object.__setattr__(clip, "curves", path)
        object.__setattr__(clip, "offset_seconds", 0.0)
    found = fit_model(model, clips)
    example = load_example(clips[0], CONTROLS)
    before, after = (predict(m, example)[0][:, place] for m in (model, found.model))
    wanted = example.curves[:, place]
    assert np.square(after - wanted).mean() < 0.35 * np.square(before - wanted).mean()


def test_command_writes_a_model_and_refuses_another_rig_in_one_line(two_actors, tmp_path):
    model, data = two_actors
    done = ran("model", "fit", model, data, "-o", tmp_path / "fitted")
    assert "of the one before on these clips" in " ".join(done.stderr.split())
    assert load_model(tmp_path / "fitted").actors == ("anna", "ben")
    other = tmp_path / "other"
    shutil.copytree(data, other)
    for clip in read_clips(other):
        write_curves(
            clip.curves,
            RigCurves(np.zeros((90, 1), np.float32), ("hinge",), 30.0, control_set="puppet@1"),
        )
    refused = deitalk("model", "fit", model, other, "-o", tmp_path / "none")
    assert refused.code == 1 and refused.err.count("\n") == 1 and "another rig" in refused.err
    assert not (tmp_path / "none").exists()


def test_a_model_is_scored_on_captures_in_every_style(two_actors, tmp_path):
    """Clips are scored in the style of their actor; the other actor's style is worse on them."""
    model, data = two_actors
    shutil.copytree(data, tmp_path / "data")
    table = pd.read_csv(tmp_path / "data/clips.csv", dtype=str, keep_default_na=False)
    table[table["speaker"] == "ben"].to_csv(tmp_path / "data/clips.csv", index=False)
    done = ran("model", "score", model, tmp_path / "data", "-o", tmp_path / "scores")
    scores = json.loads((tmp_path / "scores/report.json").read_text())["scores"]
    error = {name: found["error_of_mean_pose"] for name, found in scores.items()}
    assert error["after"] == pytest.approx(error["style ben"])
    assert error["after"] < error["style anna"]
    assert f"style anna\terror_of_mean_pose {error['style anna']:.3g}" in done.stdout
