"""Tuning from Python and by the command: folds, styles by convention, an own loss, what is said."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest
import torch

import deitalk
from deitalk.data.clips import read_clips
from deitalk.models.checkpoint import load_model
from deitalk.models.folder import describe_model
from deitalk.models.onnx.graphs import ready_graph
from deitalk.training.tuning.regression import Regression
from deitalk.training.tuning.task import FinetuneTask
from rig import RigCurves, read_curves, write_curves
from tests.command import deitalk as command
from tests.command import ran
from tests.dataset import FPS, JAW, jaw
from tests.deitalk.training.conftest import CONTROLS, recipe, relabelled
from tests.takes import write_live_link

SMALL = {
    "train.batch_size": 2,
    "train.evaluate_every": 2,
    "train.workers": 0,
    "data.window_frames": 32,
}

pytestmark = pytest.mark.usefixtures("empty_pictures")


class Pulled(FinetuneTask):
    """An own loss: the jaw is pulled to fully open, whatever is captured."""

    def loss(self, network, batch):
        parts = super().loss(network, batch)
        speech = network(batch.waveform, batch.emotion, batch.frames, batch.total)
        pull = (1 - speech.curves[..., self.controls.index(JAW)]).square().mean()
        return parts | {"pull": pull, "total": parts["total"] + 1000 * pull}


@pytest.fixture(scope="module")
def takes(data, tmp_path_factory):
    """The clips as takes of one actor, neutral; the jaw is shut in every second take's bursts."""
    return relabelled(
        data, tmp_path_factory.mktemp("takes") / "data", emotion="neutral", voice="neutral",
        known="", split="train", take=[f"t{i}" for i in range(6)], start_s="0", stop_s="6",
    )  # fmt: skip


@pytest.fixture(scope="module")
def plain(base, takes, tmp_path_factory):
    """The takes' model by the defaults."""
    return deitalk.finetune(takes, tmp_path_factory.mktemp("plain") / "run", base=base)


def test_captures_to_a_model_in_two_calls(base, tmp_path):
    for place, seconds in enumerate((6, 7, 6.5)):
        write_live_link(tmp_path / "takes" / f"take_{place}.csv", seconds)
    found = deitalk.import_captures(
        tmp_path / "takes", tmp_path / "data", actor="anna", emotion="happy"
    )
    assert found.splits == {"train": found.n_clips}
    tuned = deitalk.finetune(tmp_path / "data", tmp_path / "run", base=base)
    report = json.loads((tmp_path / "run/report.json").read_text())
    assert report["held"].startswith("each predicted from the other takes")
    assert tuned.scores["after"]["error_of_mean_pose"] == pytest.approx(
        report["scores"]["after"]["error_of_mean_pose"]
    )
    assert tuned.delivered.startswith("the regression for ")
    performance = deitalk.animate(read_clips(tmp_path / "data")[0].audio, model=tuned.model)
    assert np.isfinite(performance.curves.values).all()


def test_a_tuned_model_has_its_graph(takes, tmp_path, monkeypatch):
    """ONNX Runtime evaluates it at once, as torch does; without the package onnx a line says so."""
    data = shutil.copytree(takes, tmp_path / "data")
    table = pd.read_csv(data / "clips.csv", dtype=str, keep_default_na=False)
    table[:4].to_csv(data / "clips.csv", index=False)
    tuned = deitalk.finetune(data, tmp_path / "run")
    assert ready_graph(tuned.model) and not any("graph" in line for line in tuned.warnings)
    audio = read_clips(takes)[0].audio
    values = [
        deitalk.animate(audio, "happy", model=tuned.model, backend=name).curves
        for name in ("onnx", "torch")
    ]
    np.testing.assert_allclose(values[0].values, values[1].values, atol=1e-4)
    monkeypatch.setattr("deitalk.training.tuning.public.find_spec", lambda name: None)
    again = deitalk.finetune(data, tmp_path / "run", resume=True)
    assert "no graph for ONNX Runtime was written" in again.warnings[-1]


def test_an_own_loss_is_a_subclass_and_its_model_loads_anywhere(base, takes, plain, tmp_path):
    """Settings of the training are not in the model's configuration."""
    steps = SMALL | {"train.steps": 20, "train.evaluate_every": 20, "train.learning_rate": 1e-2}
    deitalk.finetune(takes, tmp_path / "own", base=base, settings=steps, task=Pulled)
    audio, place = read_clips(takes)[0].audio, CONTROLS.index(JAW)
    own, usual = (
        deitalk.animate(audio, model=model, rules=False).curves.values[:, place]
        for model in (tmp_path / "own/last", plain.model)
    )
    assert own.mean() > usual.mean() + 0.1
    text = (tmp_path / "own/best/config.yaml").read_text()
    assert "learning_rate" not in text and "tune:" not in text


def test_a_model_folder_with_settings_that_are_unknown_here_is_read(base, tmp_path):
    """Those of its training, as earlier versions and others' own losses left them."""
    shutil.copytree(base, tmp_path / "m")
    with (tmp_path / "m/config.yaml").open("a") as file:
        file.write("loss: {acceleration: 1}\ntune: {start: base}\ntrain: {steps: 3}\n")
    assert load_model(tmp_path / "m").config == load_model(base).config


def opposed(takes, folder):
    """Two conventions: in the second three takes a lip funnels where the jaw opens in others."""
    shutil.copytree(takes, folder)
    other = CONTROLS.index("CTRL_L_mouth_funnelD.ty")
    for place, clip in enumerate(read_clips(folder)):
        curves = read_curves(clip.curves)
        values = np.tile(CONTROLS.rest, (len(curves), 1)).astype(np.float32)
        column = CONTROLS.index(JAW) if place < 3 else other
        values[:, column] = jaw()[: len(curves)]
        write_curves(clip.curves, RigCurves(values, curves.names, FPS))
    return folder, other


@pytest.fixture
def short_takes(monkeypatch):
    """Takes of 3 s are compared too."""
    monkeypatch.setattr("deitalk.data.captures.conventions.LEAST_FRAMES", 60)


def test_takes_of_two_conventions_give_two_styles(base, takes, tmp_path, short_takes):
    folder, other = opposed(takes, tmp_path / "data")
    tuned = deitalk.finetune(folder, tmp_path / "run", base=base)
    assert {name: set(own) for name, own in tuned.conventions.items()} == {
        "anna-1": {"t0", "t1", "t2"}, "anna-2": {"t3", "t4", "t5"},
    }  # fmt: skip
    audio = read_clips(folder)[0].audio
    moved = {
        style: deitalk.animate(audio, model=tuned.model, style=style, rules=False).curves.values
        for style in ("anna-1", "anna-2", None)
    }
    spread = {s: (v[:, CONTROLS.index(JAW)].std(), v[:, other].std()) for s, v in moved.items()}
    assert spread["anna-1"][0] > 3 * spread["anna-1"][1]
    assert spread["anna-2"][1] > 3 * spread["anna-2"][0]
    one = deitalk.finetune(
        folder, tmp_path / "one", base=base, settings={"tune.conventions": False}
    )
    assert not one.conventions and not load_model(one.model).actors
    own = tuned.scores["after"]["error_of_mean_pose"]
    assert own < 0.8 * one.scores["after"]["error_of_mean_pose"]
    told = ran("finetune", folder, "--from", base, "-o", tmp_path / "told").stderr
    assert "style anna-2: t3, t4, t5, which share a convention" in " ".join(told.split())


def test_a_take_that_is_left_out_is_tested_in_its_convention_and_in_the_mean(
    base, takes, tmp_path, short_takes
):
    folder, _ = opposed(takes, tmp_path / "data")
    tuned = deitalk.finetune(folder, tmp_path / "run", base=base, leave_out="t5")
    own, mean = (
        tuned.scores[name]["error_of_mean_pose"] for name in ("after", "after, mean style")
    )
    assert own < 0.8 * mean


class Misled(Pulled):
    """Steps that pull the jaw open, which its validation takes for better and better."""

    def validate(self, model):
        self.times = getattr(self, "times", 0) + 1
        return {"score": float(self.times)}


def test_steps_that_are_worse_on_held_out_clips_are_not_delivered(base, takes, tmp_path):
    steps = SMALL | {"train.steps": 20, "train.evaluate_every": 20, "train.learning_rate": 1e-2}
    tuned = deitalk.finetune(
        takes, tmp_path / "run", base=base, settings=steps, task=Misled, leave_out="t5"
    )
    assert tuned.delivered.startswith("the regression")
    assert describe_model(tuned.model)["training"]["step"] == 0
    errors = [tuned.scores[name]["error_of_mean_pose"] for name in ("after", "ridge")]
    assert errors[0] == errors[1]
    audio, place = read_clips(takes)[5].audio, CONTROLS.index(JAW)
    jaws = [
        deitalk.animate(audio, model=tmp_path / "run" / name, rules=False).curves.values[:, place]
        for name in ("best", "last")
    ]
    assert jaws[0].mean() < jaws[1].mean() - 0.1


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_range_is_raised_about_the_mean_with_the_same_timing(base, takes, plain, tmp_path, share):
    place, settings = CONTROLS.index(JAW), {"tune.range": share}
    raised = deitalk.finetune(takes, tmp_path / "raised", base=base, settings=settings)
    audio = read_clips(takes)[0].audio
    before, after = (
        deitalk.animate(audio, model=tuned.model, rules=False).curves.values[:, place]
        for tuned in (plain, raised)
    )
    assert np.corrcoef(before, after)[0, 1] > 0.9
    assert after.std() > before.std() * 0.999
    assert raised.scores["after"]["range"] >= plain.scores["after"]["range"] - 1e-6


def test_a_model_that_loudness_beats_is_told_and_strict_fails(base, takes, tmp_path):
    """Curves that have nothing to do with the sound but the loudness of its frames."""
    folder = tmp_path / "data"
    shutil.copytree(takes, folder)
    generator = np.random.default_rng(0)
    for clip in read_clips(folder):
        curves = read_curves(clip.curves)
        noise = generator.normal(0, 0.1, size=(len(curves), 1)).astype(np.float32)
        values = np.tile(CONTROLS.rest, (len(curves), 1)).astype(np.float32)
        values[:, [CONTROLS.index(JAW)]] = np.abs(noise)
        write_curves(clip.curves, RigCurves(values, curves.names, FPS))
    arguments = ("finetune", folder, "--from", base, "--strict", "-o")
    done = command(*arguments, tmp_path / "run")
    assert done.code == 3, done.err
    assert "no better than a line over loudness" in " ".join(done.err.split())
    assert (tmp_path / "run/best/model.json").is_file()


@torch.no_grad()
def test_held_predictions_leave_the_model_as_it_is(base, takes):
    task = FinetuneTask(recipe(base, "train.steps=0"), takes)
    task.build(torch.device("cpu"))
    before = {name: value.clone() for name, value in task.model.state_dict().items()}
    fit = task.regression
    assert isinstance(fit, Regression) and len(fit.maps.held) > 1
    from deitalk.evaluation.smoothness import load_example

    fit.predicted(task.clips[0], load_example(task.clips[0], task.controls))
    for name, value in task.model.state_dict().items():
        assert torch.equal(value, before[name]), name
