"""Files of a run: tables, events, the best weights, the state and pictures."""

import errno
import importlib.util
import sys
import textwrap
from contextlib import contextmanager
from pathlib import Path

import accelerate.tracking
import numpy as np
import pytest
import torch

from deitalk.config.curves import Config
from deitalk.errors import ConfigError, MissingError
from deitalk.models.folder import ENCODER
from deitalk.training import run_folder
from deitalk.training.journal import Journal, read_log
from deitalk.training.run_folder import (
    KIND,
    restore_state,
    resume_run,
    save_checkpoints,
)
from deitalk.training.several_processes import new_accelerator
from rig.files import begin_folder


def parts() -> dict[str, torch.nn.Module]:
    return {"model": torch.nn.Linear(2, 1)}


def test_an_encoder_that_both_models_have_is_one_file(tmp_path):
    def save(folder, summary):
        folder.mkdir(exist_ok=True)
        (folder / ENCODER).unlink(missing_ok=True)  # as `output_folder`, which makes new files
        (folder / ENCODER).write_bytes(b"weights")

    best = -1.0
    for step, score in enumerate((0.1, 0.3, 0.2)):
        best = save_checkpoints(tmp_path, parts(), step, {"score": score}, best, save)
        assert (tmp_path / "best" / ENCODER).samefile(tmp_path / "last" / ENCODER)
        assert (tmp_path / "last" / ENCODER).read_bytes() == b"weights"
        assert len(list((tmp_path / "last").iterdir())) == 1


def test_best_weights_are_the_latest_of_the_highest_score(tmp_path):
    best, saved = -np.inf, []
    for step, score in ((3, 0.4), (6, 0.7), (9, 0.7), (12, 0.5)):
        best = save_checkpoints(
            tmp_path,
            parts(),
            step,
            {"score": score, "lpe": 1.0},
            best,
            lambda folder, summary: saved.append((folder.name, summary["step"])),
        )
    assert best == 0.7
    assert [step for name, step in saved if name == "best"] == [3, 6, 9]
    assert [step for name, step in saved if name == "last"] == [3, 6, 9, 12]
    assert restore_state(tmp_path, parts()) == {"step": 12, "best_score": 0.7}


def test_resuming_drops_rows_beyond_the_state(tmp_path):
    journal = Journal(tmp_path)
    for step in (3, 6, 9):
        journal.write("metrics", step, {"total": 1 / step})
    save_checkpoints(tmp_path, parts(), 6, {"score": 0.5}, 0.0, lambda *_: None)
    assert resume_run(tmp_path, parts(), truncate_logs=False) == (6, 0.5)
    assert (tmp_path / "metrics.csv").read_text().count("\n") == 4, "another process"
    resume_run(tmp_path, parts(), truncate_logs=True)
    assert (tmp_path / "metrics.csv").read_text() == "step,total\n3,0.333333\n6,0.166667\n"
    assert read_log(tmp_path / "metrics.csv") == {"step": [3, 6], "total": [0.333333, 0.166667]}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full (Linux)")
def test_state_on_a_full_disk_is_an_os_error_with_its_path(tmp_path, monkeypatch):
    @contextmanager
    def full(path):
        yield Path("/dev/full")

    monkeypatch.setattr(run_folder, "atomic_write", full)
    with pytest.raises(OSError, match="No space left on device") as caught:
        run_folder.save_state(tmp_path, parts(), {"step": 1})
    assert caught.value.errno == errno.ENOSPC
    assert caught.value.filename == str(tmp_path / "state.pt")


def scalars(folder) -> dict[str, list[tuple[int, float]]]:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(folder))
    events.Reload()
    return {
        tag: [(event.step, event.value) for event in events.Scalars(tag)]
        for tag in events.Tags()["scalars"]
    }


def journal(out, *track, step=0) -> Journal:
    accelerator = new_accelerator(Config().train, 1, track, out)
    return Journal(out, step=step, accelerator=accelerator)


def test_tensorboard_holds_the_rows_of_the_tables(tmp_path):
    pytest.importorskip("tensorboard", reason="needs the extra 'tensorboard'")
    first = journal(tmp_path, "tensorboard")
    for step in (25, 50, 75):
        first.write("metrics", step, {"total": 100.0 / step, "gradient_norm": float("inf")})
    first.write("development", 50, {"dev_score": 0.5, "dev_auc": float("nan")})
    first.close()
    second = journal(tmp_path, "tensorboard", step=50)  # a run that goes on from 50
    second.write("metrics", 75, {"total": 7.0, "gradient_norm": 1.0})
    second.close()
    assert scalars(tmp_path / "tensorboard/deitalk") == {
        "metrics/total": [(25, 4.0), (50, 2.0), (75, 7.0)],
        "metrics/gradient_norm": [(75, 1.0)],
        "development/score": [(50, 0.5)],
    }


STUBS = {
    "wandb": """
        from types import SimpleNamespace
        CALLS = []
        def init(**given):
            CALLS.append(("init", given))
            log = lambda values, step: CALLS.append((step, values))
            finish = lambda: CALLS.append("finish")
            return SimpleNamespace(id=given.get("id", "first"), log=log, finish=finish)
    """,
    "mlflow": """
        from types import SimpleNamespace
        CALLS = []
        def search_experiments(filter_string): return []
        def create_experiment(name, **_): CALLS.append(("experiment", name))
        def start_run(run_id=None, **given):
            CALLS.append(("init", given | ({} if run_id is None else {"id": run_id})))
            return SimpleNamespace(info=SimpleNamespace(run_id=run_id or "first"))
        def log_metrics(values, step): CALLS.append((step, values))
        def end_run(): CALLS.append("finish")
    """,
}


@pytest.mark.parametrize("name", STUBS)
def test_a_tracker_gets_every_finite_number_and_a_resumed_run_stays_one(
    tmp_path, monkeypatch, name
):
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / f"{name}.py").write_text(textwrap.dedent(STUBS[name]))
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    monkeypatch.delitem(sys.modules, name, raising=False)
    kind = accelerate.tracking.LoggerType(name)
    monkeypatch.setattr(accelerate.tracking, "_available_trackers", [kind])
    out = tmp_path / "anna"
    out.mkdir()
    begin_folder(out, kind=KIND)
    for step in (0, 25):
        run = journal(out, name, step=step)
        run.write("metrics", step + 25, {"total": 2.0, "gradient_norm": float("inf")})
        run.close()
    calls = sys.modules[name].CALLS
    begun = [given for call, given in (c for c in calls if c[0] == "init")]
    assert [given.get("id") for given in begun] == [None, "first"]
    assert "anna" in (begun[0].get("name"), begun[0].get("run_name"))
    assert [call for call in calls if isinstance(call[0], int)] == [
        (25, {"metrics/total": 2.0}),
        (50, {"metrics/total": 2.0}),
    ]
    assert calls.count("finish") == 2


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("wandb", MissingError, "pip install wandb"),
        ("excel", ConfigError, r"must be one of .*mlflow, .*tensorboard, .*wandb"),
    ],
)
def test_a_tracker_that_is_not_there_is_refused(tmp_path, name, error, message):
    if importlib.util.find_spec(name) is not None:
        pytest.skip("the package is installed")
    with pytest.raises(error, match=message):
        new_accelerator(Config().train, 1, [name], tmp_path)
