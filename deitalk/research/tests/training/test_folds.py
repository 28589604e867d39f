"""Takes left out in turn."""

import json
import shutil

import pandas as pd
import pytest
from typer.testing import CliRunner

from deitalk.data.clips import read_clips
from deitalk.errors import DataError
from deitalk.research.cli import app
from deitalk.research.training.folds import tune_folds
from deitalk.training.tuning.task import FinetuneTask
from tests.dataset import JAW, write_dataset
from tests.deitalk.training.conftest import base, no_pictures, recipe

__all__ = ["base", "no_pictures"]
SHORT = ("train.steps=2", "train.evaluate_every=2", "train.batch_size=2", "data.window_frames=32")


@pytest.fixture(scope="module")
def two_takes(tmp_path_factory):
    """Six clips of 3 s: three of each take, one after another."""
    folder = write_dataset(tmp_path_factory.mktemp("takes"))
    table = pd.read_csv(folder / "clips.csv", dtype=str)
    starts = [0, 10, 20] * 2
    table = table.assign(
        take=["a"] * 3 + ["b"] * 3,
        start_s=starts,
        stop_s=[s + 3 for s in starts],
        emotion="sad",
        speaker="anna",
    )
    table.to_csv(folder / "clips.csv", index=False)
    return folder


def test_fold_is_tested_on_the_take_that_it_was_not_trained_on(base, two_takes, tmp_path):
    """Of the other take the last clip chooses the weights; the split of the table has no part."""
    task = FinetuneTask(recipe(base, "tune.leave_out=b"), two_takes)
    names = [clip.name for clip in read_clips(two_takes)]
    assert [clip.name for clip in task.clips] == names[:2]
    assert [clip.name for clip in task.validation_clips] == names[2:3]
    assert [clip.name for clip in task.test_clips] == names[3:]


def test_means_are_those_of_the_folds(base, two_takes, tmp_path, monkeypatch):
    """One set of features serves all folds, and the command goes on with folds that are there."""
    monkeypatch.delattr("deitalk.training.tuning.task.FrozenFeatures")
    sets = [part for override in SHORT for part in ("--set", override)]
    command = ["folds", str(two_takes), "--from", base, "-o", f"{tmp_path}/out", *sets]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0
    assert [line.split("\t")[0] for line in done.stdout.splitlines()][:3] == ["a", "b", "before"]
    reports = [json.loads((tmp_path / f"out/{n}/report.json").read_text()) for n in "ab"]
    result = json.loads((tmp_path / "out/folds.json").read_text())
    assert list(result["folds"]) == ["a", "b"]
    for system in ("before", "after", "loudness"):
        scores = [report["scores"][system]["mean_r"] for report in reports]
        assert result["mean"][system]["mean_r"] == pytest.approx(sum(scores) / 2)
    moving = result["controls"][JAW]
    assert 0 < moving["captured_sd"] and {"before_r", "after_r"} <= moving.keys()
    again = CliRunner().invoke(app, [*command, "--resume"])
    assert again.exit_code == 0 and again.stdout == done.stdout
    with pytest.raises(DataError, match="holds a run already"):
        CliRunner().invoke(app, command, catch_exceptions=False)


def test_takes_of_one_folder_are_refused_before_any_training(base, two_takes, tmp_path):
    """Both would be ``a_1``: the second fold would report the scores of the first."""
    shutil.copytree(two_takes, tmp_path / "data")
    path = tmp_path / "data/clips.csv"
    table = pd.read_csv(path, dtype=str)
    table["take"] = table["take"].map({"a": "a 1", "b": "A:1"})
    table.to_csv(path, index=False)
    with pytest.raises(DataError, match="'A:1' and 'a 1' would have one folder"):
        tune_folds(recipe(base), tmp_path / "data", tmp_path / "out", "takes")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "match"),
    [
        (["--of", "clips"], "`folds=clips` must be one of takes, actors"),
        (["--leave-out", "a"], "each in turn: no `leave_out`"),
        (["--of", "actors"], "folds of actors need two; here is anna alone"),
    ],
)
def test_command_rejects_what_cannot_be_left_out(base, two_takes, tmp_path, options, match):
    arguments = ["folds", str(two_takes), "--from", base, "-o", f"{tmp_path}/out", *options]
    with pytest.raises(DataError, match=match):
        CliRunner().invoke(app, arguments, catch_exceptions=False)
