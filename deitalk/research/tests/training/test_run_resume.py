"""Runs killed at any write: the same call, repeated, completes the same run."""

import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from safetensors.torch import load_file

import deitalk.training.trainer
from deitalk.config.curves import Config
from deitalk.config.load import load_config
from deitalk.errors import ConfigError, DataError
from deitalk.research.config import read_training
from deitalk.research.meshes.folder import MeshSequence, write_mesh_folder
from deitalk.research.meshes.training import train_mesh
from deitalk.research.training.curves import TrainingTask, train_curves
from deitalk.training.journal import log, truncate_log
from rig.errors import TargetError
from tests.dataset import write_dataset
from tests.deitalk.models.test_mesh_model import LIPS, sheet, spoken
from tests.deitalk.models.test_mesh_model import tiny as tiny_sdfa
from tests.errors import one_line
from tests.interrupt import count_writes, kill_at_write

TINY = Path(__file__).resolve().parents[4] / "configs" / "tiny.yaml"


def tiny(*overrides: str) -> Config:
    """Two steps; each is logged, scored and saved."""
    mine = ("train.steps=2", "train.evaluate_every=1", "train.batch_size=2", "train.workers=0")
    return read_training(TINY, (*mine, "model.dropout=0.1", *overrides))


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"), n_train=2, n_validation=1)


@pytest.fixture(scope="module")
def meshes(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("meshes") / "folder"
    template = sheet()
    one = MeshSequence("ann", "ann", "train", partial(spoken, template))
    write_mesh_folder(
        out, {"ann": template}, [one], fps=30, unit_mm=10, lips=LIPS,
        basis_frames=24, basis_error_mm=0.2,
    )  # fmt: skip
    return out


@pytest.fixture(params=["curves", "meshes"])
def fit(request, data, meshes):
    """Train in a folder, with the same arguments every time."""
    if request.param == "curves":
        return partial(train_curves, tiny(), data, resume=True)
    config = tiny_sdfa(steps=2, evaluate_every=1)
    return partial(train_mesh, config, meshes, resume=True)


@pytest.fixture(scope="module")
def finished(data, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "run"
    train_curves(tiny(), data, out)
    return out


@pytest.fixture
def run(finished, tmp_path) -> Path:
    """A copy of a finished run."""
    return Path(shutil.copytree(finished, tmp_path / "run"))


def contents(out: Path) -> dict[str, object]:
    """What a run leaves: text as it is, weights by value; states and pictures by name."""
    found: dict[str, object] = {}
    for path in sorted(path for path in out.rglob("*") if path.is_file()):
        name = str(path.relative_to(out))
        if path.suffix == ".safetensors":
            found[name] = {k: v.tolist() for k, v in load_file(path).items()}
        else:
            found[name] = path.read_text() if path.suffix in (".csv", ".yaml") else None
    return found


def check_kills(fit, tmp_path: Path, choose) -> None:
    whole = tmp_path / "whole"
    total = count_writes(whole, lambda: fit(whole))
    expected = contents(whole)
    assert total > 30
    for number in choose(total):
        out = tmp_path / f"killed-{number}"
        assert kill_at_write(number, out, lambda out=out: fit(out)) >= number
        fit(out)
        assert contents(out) == expected, f"killed at write {number} of {total}"
        shutil.rmtree(out)


def test_run_killed_at_some_writes_and_resumed_equals_the_uninterrupted_one(fit, tmp_path):
    check_kills(
        fit, tmp_path, lambda total: np.random.default_rng(0).choice(total, 3, replace=False) + 1
    )


@pytest.mark.slow
def test_run_killed_at_any_write_and_resumed_equals_the_uninterrupted_one(fit, tmp_path):
    check_kills(fit, tmp_path, lambda total: range(1, total + 1))


def test_resume_begins_a_run_in_an_empty_folder(data, finished, tmp_path):
    (tmp_path / "empty").mkdir()
    for name in ("new", "empty"):
        train_curves(tiny(), data, tmp_path / name, resume=True)
        assert contents(tmp_path / name) == contents(finished)


def test_run_killed_before_its_first_evaluation_begins_again(data, tmp_path, monkeypatch):
    config = tiny("train.evaluate_every=2")
    monkeypatch.setattr(deitalk.training.trainer, "LOG_EVERY", 1)
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    train_curves(config, data, whole)

    def fails(*_: object) -> None:
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(deitalk.training.trainer.Trainer, "evaluate", fails)
        train_curves(config, data, killed)
    assert (killed / "metrics.csv").is_file() and not (killed / "state.pt").exists()
    with pytest.raises(DataError, match=r"holds a run already; set `resume=True`"):
        train_curves(config, data, killed)
    train_curves(config, data, killed, resume=True)
    assert contents(killed) == contents(whole)


def test_training_rejects_a_folder_of_the_user_and_leaves_it(data, tmp_path):
    mine = {"config.yaml": "my: notes\n", "best/model.bin": "weights", "metrics.csv": "a,b\n"}
    for name, text in mine.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    for resume in (False, True):
        with pytest.raises(TargetError, match=r"holds files that deitalk did not write \(best, "):
            train_curves(tiny(), data, tmp_path, resume=resume)
    assert contents(tmp_path) == {
        "best/model.bin": None, "config.yaml": "my: notes\n", "metrics.csv": "a,b\n"
    }  # fmt: skip
    assert (tmp_path / "best/model.bin").read_text() == "weights"


@pytest.mark.parametrize("name", ["config.yaml", "best/model.json", "last/config.yaml"])
def test_resuming_rejects_an_edited_file(data, run, name):
    path = run / name
    path.write_text(path.read_text() + " ")
    with pytest.raises(TargetError, match=r"was changed since deitalk wrote it; move it away"):
        train_curves(tiny(), data, run, resume=True)
    assert path.read_text().endswith(" ")


def test_settings_that_may_change_are_updated(data, run):
    train_curves(tiny("name=other"), data, run, resume=True)
    assert load_config(run / "config.yaml").name == "other"
    with pytest.raises(ConfigError, match=r"was begun with another train\.seed"):
        train_curves(tiny("train.seed=4"), data, run, resume=True)


def test_training_rejects_a_folder_in_use(data, run):
    def again(*_: object) -> None:
        with pytest.raises(TargetError, match="is being written by another process"):
            # Another thread stands for another process.
            from concurrent.futures import ThreadPoolExecutor

            with ThreadPoolExecutor(1) as pool:
                pool.submit(train_curves, tiny(), data, run, resume=True).result()

    train_curves(tiny(), data, run, resume=True, progress=again)


@pytest.mark.parametrize(
    ("text", "kept"),
    [
        ("", None),
        ("st", None),
        ("step,total\n", None),
        ("step,total\n25", None),
        ("step,total\n25,1.5\n50,1.", "step,total\n25,1.5\n"),
        ("step,total\n25,1.5\n50,1.2\n75,0.", "step,total\n25,1.5\n50,1.2\n"),
        ("step,total\n25,1.5\n50,1.2\n75,0.9\n", "step,total\n25,1.5\n50,1.2\n"),
    ],
)
def test_truncated_log_drops_half_rows_and_rows_beyond_the_step(tmp_path, text, kept):
    path = tmp_path / "metrics.csv"
    path.write_text(text)
    truncate_log(path, 50)
    assert (path.read_text() if path.exists() else None) == kept
    log(path, 75, {"total": 0.9})
    assert path.read_text() == (kept or "step,total\n") + "75,0.9\n"


def test_killed_log_has_no_header_without_a_row(tmp_path):
    total = count_writes(tmp_path, lambda: log(tmp_path / "a.csv", 25, {"total": 1.0}))
    for number in range(1, total + 1):
        path = tmp_path / f"{number}.csv"
        kill_at_write(number, tmp_path, lambda path=path: log(path, 25, {"total": 1.0}))
        assert not path.exists() or path.read_text() == "step,total\n25,1\n"


@pytest.mark.parametrize("data", [b"step,total\nmine,1\n", b"\xff\n"])
def test_truncation_rejects_a_log_that_no_run_wrote(tmp_path, data):
    path = tmp_path / "metrics.csv"
    path.write_bytes(data)
    with pytest.raises(DataError, match="not the log of a run"):
        truncate_log(path, 50)
    assert path.read_bytes() == data


def test_tensorboard_holds_every_step_once_after_a_kill(data, tmp_path, monkeypatch):
    pytest.importorskip("tensorboard", reason="needs the extra 'tensorboard'")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    def fails(*_: object) -> None:
        raise KeyboardInterrupt

    # after the rows of step 1, then after those of step 1
    for home, name in ((deitalk.training.trainer, "save_checkpoints"), (TrainingTask, "draw")):
        monkeypatch.setattr(home, name, fails)
        with pytest.raises(KeyboardInterrupt):
            train_curves(tiny(), data, tmp_path / "run", resume=True, track=["tensorboard"])
        monkeypatch.undo()
    train_curves(tiny(), data, tmp_path / "run", resume=True, track=["tensorboard"])
    events = EventAccumulator(str(tmp_path / "run" / "tensorboard/deitalk"))
    events.Reload()
    assert [event.step for event in events.Scalars("development/score")] == [1, 2]
    assert [event.step for event in events.Scalars("metrics/total")] == [2]


def test_run_goes_on_with_its_own_clips_alone(data, run, tmp_path):
    moved, other = tmp_path / "moved", tmp_path / "other"
    shutil.copytree(data, moved)
    shutil.copytree(data, other)
    train_curves(tiny(), moved, run, resume=True)
    table = other / "clips.csv"
    table.write_text(table.read_text().replace(",train", ",validation", 1))
    with one_line(DataError, match="not the clips"):
        train_curves(tiny(), other, run, resume=True)
