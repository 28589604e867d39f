"""Fine-tuning on seconds of data: what learns, what is held, other rigs, resuming, the report."""

import json
import re
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import soundfile
import torch

from deitalk import animate
from deitalk.audio.load import Recording
from deitalk.cli.console import name_option
from deitalk.config.finetuning import FinetuneConfig
from deitalk.config.rig_file import read_controls
from deitalk.data.clips import read_clips
from deitalk.data.seeded_batches import Share
from deitalk.errors import CheckpointError, ConfigError, DataError
from deitalk.evaluation.captures import warnings_of
from deitalk.evaluation.comparison import CaptureSet
from deitalk.evaluation.smoothness import load_example, predict
from deitalk.models.checkpoint import load_model
from deitalk.models.folder import describe_model
from deitalk.research.evaluation.benchmark_curves import speechlike
from deitalk.training.tuning.recipe import read_recipe
from deitalk.training.tuning.task import FinetuneTask, finetune
from rig import RigCurves, read_curves, write_curves
from tests.command import ran
from tests.dataset import FPS, JAW, jaw, write_dataset
from tests.deitalk.training.conftest import CONTROLS, recipe, relabelled
from tests.errors import one_line

TINY = Path(__file__).resolve().parents[3] / "configs" / "tiny.yaml"
RIG = """
id: three@1
controls:
  mouth_open: {maximum: 2}
  smile_l: {minimum: -1}
  smile_r: {minimum: -1, rest: 0.25}
mirror: [[smile_l, smile_r]]
lip: [mouth_open, smile_l, smile_r]
"""


TUNED = ("train.steps=20", "train.evaluate_every=20", "train.learning_rate=3e-3")
LIP = "CTRL_L_mouth_lipsTogetherU.ty"


def weights(folder) -> dict[str, torch.Tensor]:
    return dict(load_model(folder).state_dict())


def changed(base, folder) -> set[str]:
    """First two parts of the names of weights that differ."""
    first, second = weights(base), weights(folder)
    return {".".join(k.split(".")[:2]) for k in first if not torch.equal(first[k], second[k])}


def of_part(base: str, part: str) -> FinetuneConfig:
    return recipe(base, f"tune.part={part}", "train.evaluate_every=2")


@pytest.fixture(scope="module")
def tuned(base, data, tmp_path_factory) -> Callable[[str], Path]:
    """A run that tunes a part, once for all tests."""

    @cache
    def make(part: str) -> Path:
        out = tmp_path_factory.mktemp(part) / "run"
        finetune(of_part(base, part), data, out)
        return out

    return make


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        ("head", {"decoder.output"}),
        ("decoder", {"decoder.output", "decoder.layers", "decoder.style"}),
    ],
)
def test_only_the_tuned_part_changes(base, tuned, part, expected):
    last = tuned(part) / "last"
    assert changed(base, last) == expected


def test_curves_of_another_rig_without_its_file_are_refused(base, foreign, tmp_path):
    with pytest.raises(DataError, match="curves of another rig than metahuman-185@mh4") as caught:
        finetune(recipe(base), foreign, tmp_path / "run")
    assert "give --rig, its file" in name_option(caught.value)


@pytest.mark.parametrize("key", ["map", "corpus"])
def test_files_of_a_tuning_that_are_absent_leave_no_run(base, data, tmp_path, key):
    with one_line(DataError, match="absent"):
        finetune(recipe(base, f"tune.{key}={tmp_path / 'absent.csv'}"), data, tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("kind: deitalk", "kind='deitalk': a recipe is of the kind finetune"),
        ("tune: 5", "tune=5: must be a section"),
        ("model: 5", "model=5: must be a section"),
        ("data: [1]\ntune: {part: all}", "data=[1]: must be a section"),
        ("train: 5", "train=5: must be a section"),
        ("tune: {bas: 5}", "tune.bas=5: unknown key; known are base, part"),
    ],
)
def test_a_wrong_recipe_is_one_line_that_names_it(base, tmp_path, text, told):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with one_line(ConfigError, match=re.escape(told)) as caught:
        read_recipe(path, base=base)
    assert str(caught.value).startswith(f"{path}: ")
    path.write_text("tune:\ndata:\nmodel:")  # all lines below them are comments
    assert read_recipe(path, base=base) == read_recipe(None, base=base)


def test_mesh_models_are_no_base():
    with one_line(CheckpointError, match="sdfa: makes mesh; a DEITalk model"):
        read_recipe(None, base="sdfa")


@pytest.fixture(scope="module")
def jaw_alone(base, data, tmp_path_factory) -> tuple[Path, Path]:
    """Captures of which no clip knows more than the jaw, and a run on them."""
    place = tmp_path_factory.mktemp("jaw")
    relabelled(data, place / "data", known="known.txt")
    finetune(recipe(base, *TUNED), place / "data", place / "run")
    return place / "data", place / "run/last"


def test_what_captures_do_not_know_stays_as_the_base_has_it(base, jaw_alone, tmp_path):
    """The columns of the lips are far from the base's."""
    folder, last = jaw_alone
    example = load_example(read_clips(folder, "validation")[0], CONTROLS)
    before, after = (predict(load_model(f), example)[0] for f in (base, last))
    moved = np.abs(after - before).mean(axis=0)
    place = CONTROLS.index(JAW)
    error = [np.square(c[:, place] - example.curves[:, place]).mean() for c in (before, after)]
    assert error[1] < 0.6 * error[0], "the jaw is learnt"
    assert np.delete(moved, place).max() == 0, "the rest is the base's, exactly"
    assert load_model(last).config.kept_controls == tuple(
        name for name in CONTROLS.names if name != JAW
    )
    held = [*TUNED, "tune.keep=false", "tune.hold=1"]
    finetune(recipe(base, *held), folder, tmp_path / "held")
    after = predict(load_model(tmp_path / "held" / "last"), example)[0]
    moved = np.abs(after - before).mean(axis=0)
    assert 0 < np.delete(moved, place).mean() < 0.25 * moved[place]


def test_tuning_a_tuned_model_keeps_the_first_base(base, jaw_alone, tmp_path):
    """The second captures know the jaw and a lip: both are learnt, all others are the first base's."""
    first, one = jaw_alone
    folder = tmp_path / "data"
    shutil.copytree(first, folder)
    (folder / "known.txt").write_text(f"{JAW}\n{LIP}\n")
    finetune(recipe(str(one), *TUNED), folder, tmp_path / "two")
    example = load_example(read_clips(folder, "validation")[0], CONTROLS)
    before, after = (predict(load_model(f), example)[0] for f in (base, tmp_path / "two" / "last"))
    moved = np.abs(after - before).max(axis=0)
    assert {CONTROLS.names[i] for i in np.flatnonzero(moved)} == {JAW, LIP}
    with pytest.raises(ConfigError, match="tune that base"):
        FinetuneTask(recipe(str(one), "tune.part=all"), folder)


def base_curves(task, batch):
    return task.base(batch.waveform, batch.emotion, batch.frames, batch.total).curves


def test_rehearsed_speech_has_the_curves_of_the_base_as_targets(base, data, tmp_path):
    """A run with it is exported, and names no folder of the machine."""
    corpus = write_dataset(tmp_path / "corpus")
    config = recipe(base, f"tune.corpus={corpus}", "data.real_fraction=0")
    task = FinetuneTask(config, data)
    task.build(torch.device("cpu"))
    batch = next(iter(task.batches(Share())))
    assert not batch.known.any()
    full, _ = task._completed(batch)
    torch.testing.assert_close(full.curves, base_curves(task, batch))
    finetune(config, data, tmp_path / "run")
    ran("model", "export", f"{tmp_path}/run/best", "-o", f"{tmp_path}/small")
    for name in ("config.yaml", "model.json"):
        text = (tmp_path / "small" / name).read_text()
        assert str(tmp_path) not in text and str(Path(base).parent) not in text
    assert load_model(tmp_path / "small").rules == load_model(tmp_path / "run/best").rules


@pytest.mark.parametrize("part", ["decoder", "head"])
def test_resumed_run_equals_the_uninterrupted_one(base, data, tuned, tmp_path, part):
    config = of_part(base, part)

    def stop(step, total, values):
        if step == 2 and "dev_score" in values:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        finetune(config, data, tmp_path / "cut", progress=stop)
    finetune(config, data, tmp_path / "cut", resume=True)
    first, second = (weights(run / "last") for run in (tuned(part), tmp_path / "cut"))
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_run_ends_when_nothing_improves(base, data, tmp_path, monkeypatch):
    """Scores 1, 1, 3, 2, 2 at steps 0, 2, 4, 6, 8: two evaluations follow the best.

    Before them captures are read, encoded and fitted, each to the end.
    """
    falling = iter((1.0, 1.0, 3.0, 2.0, 2.0, 9.0))
    monkeypatch.setattr(CaptureSet, "score", lambda *_: {"score": next(falling)})
    shown = []
    config = recipe(base, "train.steps=40", "train.evaluate_every=2", "train.patience=2")
    finetune(config, data, tmp_path / "run", progress=lambda *values: shown.append(values))
    assert max(step for step, *_ in shown) == 8
    early = [next(iter(values.items())) for step, total, values in shown if total == 1]
    ends = [(phase, share) for phase, share in early if share == 1]
    assert list(dict(ends)) == ["read", "encoded", "fitted"]
    assert describe_model(tmp_path / "run" / "best")["training"]["step"] == 4


@pytest.fixture(scope="module")
def foreign(data, tmp_path_factory) -> Path:
    """The same recordings with curves of a rig of three controls."""
    folder = relabelled(data, tmp_path_factory.mktemp("foreign") / "data", known="")
    (folder / "rig.yaml").write_text(RIG)
    for path in (folder / "curves").iterdir():
        values = np.stack([jaw() * 1.5, -0.5 * jaw(), 0.25 + 0 * jaw()], axis=1)
        names = ("mouth_open", "smile_l", "smile_r")
        write_curves(path, RigCurves(values, names, fps=FPS, control_set="three@1"))
    return folder


def test_model_of_another_rig_needs_no_file_beside_its_folder(base, foreign, tmp_path):
    rig = foreign / "rig.yaml"
    config = recipe(base, f"model.control_set={rig}")
    scores = finetune(config, foreign, tmp_path / "run")
    assert "before" not in scores and scores["after"]["error_of_mean_pose"] < 1
    shutil.move(tmp_path / "run" / "best", tmp_path / "moved")
    model = load_model(tmp_path / "moved")
    controls = read_controls(str(rig))
    assert model.controls == controls and model.controls.names[1] == "smile_l"
    assert controls["smile_l"].mirror == "smile_r" and controls["smile_r"].rest == 0.25
    speech = np.pad(speechlike(1.0), (16_000, 16_000))
    performance = animate(Recording(speech, "test", 16_000, 1), "happy", model=model)
    assert performance.curves.names == controls.names
    np.testing.assert_allclose(performance.curves.values[-1], controls.rest, atol=1e-6)
    for name in ("x.csv", "x.json", "x.npz"):
        written = read_curves(performance.save(tmp_path / name), controls=controls)
        np.testing.assert_allclose(written.values, performance.curves.values, atol=1e-4)
    take = performance.save(tmp_path / "take")
    assert json.loads((take / "take.json").read_text())["control_set"] == "three@1"
    again = read_recipe(None, base=str(tmp_path / "moved"))
    assert read_controls(again.model.control_set) == controls


def test_actors_keep_their_last_layers_where_a_tuned_model_is_tuned(
    base, foreign, tmp_path, monkeypatch
):
    """b begins as the first tuning left it, c is new."""
    rig = f"model.control_set={foreign / 'rig.yaml'}"
    first = relabelled(foreign, tmp_path / "first", speaker=["a", "b"] * 3)
    finetune(recipe(base, rig), first, tmp_path / "one")
    second = relabelled(foreign, tmp_path / "second", speaker=["b", "c"] * 3)
    task = FinetuneTask(recipe(str(tmp_path / "one/last")), second)
    monkeypatch.setattr(FinetuneTask, "_fit_last_layers", lambda self: None)
    task.build(torch.device("cpu"))
    assert task.model.actors == ("a", "b", "c")
    before, after = (
        model.decoder.actor_layers for model in (load_model(tmp_path / "one/last"), task.model)
    )
    assert before.bias.abs().max() > 1e-3
    for old, new in zip(before.parameters(), after.parameters(), strict=True):
        assert torch.equal(new[:2], old) and not new[2].any()


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("id: a\ncontrols: {x: {rest: 2}}", "rest"),
        ("id: a\ncontrols: {x: {}}\nlip: [y]", "'y' is in a pair or a set"),
        ("id: a\ncontrols: {}", "controls"),
        ("controls: {x: {}}", "id"),
        ("id: a\ncontrols: {x: {top: 1}}", "top"),
    ],
)
def test_rig_file_rejects(tmp_path, text, match):
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    with one_line(ConfigError, "rig.yaml", match=match):
        read_controls(str(path))


def test_actors_of_one_model_move_in_their_own_style(base, data, tmp_path):
    """Anna's mouth is open and Ben's is not, in the same recordings."""
    folder = tmp_path / "data"
    shutil.copytree(data, folder)
    known = pd.read_csv(folder / "clips.csv", dtype=str).assign(known="known.txt")
    parts = []
    place = CONTROLS.index(JAW)
    for name, opening in (("anna", 0.8), ("ben", 0.0)):
        values = np.tile(CONTROLS.rest, (180, 1))
        values[:, place] = opening
        write_curves(folder / f"{name}.npz", RigCurves(values, CONTROLS.names, fps=FPS))
        parts.append(known.assign(clip=name + known["clip"], speaker=name, curves=f"{name}.npz"))
    pd.concat(parts).to_csv(folder / "clips.csv", index=False)
    config = recipe(base, "train.steps=20", "train.evaluate_every=20", "train.learning_rate=1e-2")
    finetune(config, folder, tmp_path / "run")
    model = load_model(tmp_path / "run" / "last")
    assert model.config.actors == ("anna", "ben")
    audio = read_clips(folder)[0].audio
    jaws = {
        actor: animate(audio, model=model, style=actor, rules=False).curves.values[:, place].mean()
        for actor in ("anna", "ben", None)
    }
    assert jaws["anna"] > jaws["ben"] + 0.5
    assert jaws["ben"] + 0.2 < jaws[None] < jaws["anna"] - 0.2, "their mean is the default"
    notes = [animate(audio, model=model, style=actor).recording.warnings for actor in (None, "ben")]
    said = ["the mean of anna, ben" in " ".join(each) for each in notes]
    assert said == [True, False]
    about = describe_model(tmp_path / "run" / "last")
    assert about["actor_by_default"] == "the mean of all"
    with pytest.raises(CheckpointError, match="actor 'eve' is unknown; the model's are anna, ben"):
        animate(audio, model=model, style="eve")
    with pytest.raises(CheckpointError, match="of one actor, or of nobody"):
        animate(audio, model=base, style="anna")


def test_new_actors_begin_with_the_style_of_the_base(base, data, tmp_path, monkeypatch):
    monkeypatch.setattr(FinetuneTask, "_fit_last_layers", lambda self: None)
    folder = relabelled(data, tmp_path / "data", speaker=["a", "b"] * 3)
    task = FinetuneTask(recipe(base), folder)
    task.build(torch.device("cpu"))
    example = load_example(read_clips(folder, "validation")[0], CONTROLS)
    expected = predict(load_model(base), example)[0]
    np.testing.assert_allclose(predict(task.model.eval(), example)[0], expected, atol=1e-5)
    batch = next(iter(task.batches(Share())))
    assert batch.emotion.shape == (4, 7) and (batch.emotion[:, 5:].sum(dim=1) == 1).all()


def test_settings_that_are_not_named_are_those_of_the_recipe(base):
    """The model's default too is a section: its settings are the base's."""
    whole = read_recipe(None, base=base)
    changed = read_recipe(None, ["train.steps=7", "rules.dead_zone={}"], base=base)
    assert changed.train == whole.train.model_copy(update={"steps": 7})
    assert changed.rules.dead_zone is not None and changed.rules.sharpen_contacts is None
    assert changed.model == whole.model == load_model(base).config
    written = read_recipe(TINY.parent / "finetune.yaml", base=base).model_dump()
    assert written == whole.model_dump() | {"model": written["model"]}


def test_report_compares_before_after_and_baselines(tuned):
    run = tuned("decoder")
    report = json.loads((run / "report.json").read_text())
    scores = report["scores"]
    assert list(scores) == ["before", "ridge", "after", "mean pose", "loudness", "capture"]
    assert scores["mean pose"]["error_of_mean_pose"] == pytest.approx(1)
    assert scores["loudness"]["error_of_mean_pose"] < 0.9, "the jaw follows bursts of sound"
    assert {"jaw_r", "lips_together_r", "bilabial_window_auc", "lpe"} <= scores["after"].keys()
    assert report["clips"] == 2 and report["learning"]["step"] == [0, 2, 4]
    text = (run / "report.md").read_text()
    assert "| step 0 |" in text and "| error_of_mean_pose |" in text


@pytest.fixture(scope="module")
def compared(base, data, tmp_path_factory):
    """Held-out clip, run and messages of the command; the clip moves exactly as the base does."""
    place = tmp_path_factory.mktemp("compared")
    folder = relabelled(data, place / "data", split=["train"] * 4 + ["validation", "test"])
    clip = read_clips(folder, "test")[0]
    values, _ = predict(load_model(base), load_example(clip, CONTROLS))
    values = np.clip(values, CONTROLS.minimum, CONTROLS.maximum)
    write_curves(clip.curves, RigCurves(values, CONTROLS.names, FPS))
    player = place / "player.html"
    player.write_text("<html><!--deitalk-data--></html>")
    short = ("train.steps=2", "train.batch_size=2", "data.window_frames=32")
    sets = [part for override in short for part in ("--set", override)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deitalk.preview.page.BUNDLE", player)
        done = ran("finetune", folder, "--from", base, "-o", f"{place}/run", *sets)
    return clip, place / "run", " ".join(done.stderr.split())


def test_command_says_that_the_base_is_nearer(compared):
    _, run, told = compared
    line = "The base is nearer to the held-out clips than the tuned model"
    assert line in told and line in (run / "report.md").read_text()
    scores = json.loads((run / "report.json").read_text())["scores"]
    farther = {"error_of_mean_pose": 1.01 * scores["after"]["error_of_mean_pose"]}
    near, far = (" ".join(warnings_of(s)) for s in (scores, scores | {"before": farther}))
    assert "The base is nearer" in near and "The base is nearer" not in far


def test_held_out_clip_lies_beside_its_curves_before_and_after(base, compared):
    """And the command makes a page of them."""
    clip, run, _ = compared
    folder, example = run / "compare", load_example(clip, CONTROLS)
    np.testing.assert_allclose(
        read_curves(folder / "capture.npz").values, example.curves, atol=1e-6
    )
    for name, model in (("before", base), ("after", run / "best")):
        curves = read_curves(folder / f"{name}.npz").values
        wanted = np.clip(predict(load_model(model), example)[0], CONTROLS.minimum, CONTROLS.maximum)
        np.testing.assert_allclose(curves, wanted, atol=1e-5)
    sound, rate = soundfile.read(folder / "audio.wav")
    assert rate == 16_000 and len(sound) == len(example.waveform)
    page = (run / "compare.html").read_text()
    assert all(f'id="take-{k}"' in page for k in range(3)) and 'id="take-3"' not in page


def test_saved_model_has_what_validation_clips_add_and_the_choice_has_not(base, data, tmp_path):
    """A regression meets the mean of what it learnt from: the jaw is wider in validation clips."""
    folder = tmp_path / "data"
    shutil.copytree(data, folder)
    held = read_clips(folder, "validation")
    for clip in held:
        curves = read_curves(clip.curves)
        values = curves.values + np.float32(0.3) * (np.array(curves.names) == JAW)
        write_curves(clip.curves, RigCurves(values, curves.names, fps=curves.fps))
    train = read_clips(folder, "train")
    task = FinetuneTask(recipe(base), folder)
    task.read(tmp_path)
    task.build(torch.device("cpu"))
    task.save(tmp_path / "saved", task.model, {"step": 0})
    saved = load_model(tmp_path / "saved")

    def mean_error(model, clips):
        errors = []
        for clip in clips:
            example = load_example(clip, CONTROLS)
            column = CONTROLS.index(JAW)
            errors.append(predict(model, example)[0][:, column] - example.curves[:, column])
        return np.mean(errors)

    assert mean_error(task.model.eval(), train) == pytest.approx(0, abs=2e-2)
    assert mean_error(task.model, held) < -0.15
    assert mean_error(saved, [*train, *held]) == pytest.approx(0, abs=2e-2)
    task.systems(saved)  # no test clips: as chosen, so that none is scored on its own
    assert mean_error(saved, train) == pytest.approx(0, abs=2e-2)


def test_blinks_are_learnt_only_where_no_rule_adds_them(base, data):
    lid = CONTROLS.index("CTRL_L_eye_blink.ty")
    added, learnt = (
        FinetuneTask(recipe(base, *more), data).learnt for more in ((), ("rules.idle=null",))
    )
    assert not added[lid] and learnt.all() and added[CONTROLS.index(JAW)]


def test_dead_channels_stay_as_the_base_has_them(base, tmp_path):
    """The jaw and the left lip contacts move in the captures; all controls count as known there."""
    folder = write_dataset(tmp_path / "data")
    task = FinetuneTask(recipe(base), folder)
    moving = {JAW, LIP, LIP.replace("U.ty", "D.ty")}
    assert set(task.config.model.kept_controls) == set(CONTROLS.names) - moving
    assert {CONTROLS.names[i] for i in np.flatnonzero(task.learnt)} == moving
    off = FinetuneTask(recipe(base, "tune.keep=false"), folder)
    assert not off.config.model.kept_controls and (off.learnt == task.learnt).all()


def test_contacts_keep_the_rules_of_the_base(base, data, tmp_path):
    """Numbers of the recipe stay; `auto` has none where captures know the contacts."""
    folder = relabelled(data, tmp_path / "data", known="known.txt")
    rules = load_model(base).rules
    tuned = FinetuneTask(recipe(base, "rules.limit_contact_speed.step=0.7"), folder).config.rules
    assert tuned.sharpen_contacts == rules.sharpen_contacts is not None
    assert tuned.keep_contacts == rules.keep_contacts is not None
    assert tuned.limit_contact_speed.step == 0.7
    assert tuned.dead_zone is None and not tuned.expressions.covers_teeth
    off = FinetuneTask(recipe(base, "tune.base_rules=false"), folder).config.rules
    assert off.sharpen_contacts is None
