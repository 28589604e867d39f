"""Files of a run: tables, events, the best weights, the state and pictures."""

import errno
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch

from deitalk.models.folder import ENCODER
from deitalk.training import run_folder
from deitalk.training.journal import Journal
from deitalk.training.run_folder import picture_path, restore_state, resume_run, save_checkpoints


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


def test_resuming_drops_rows_and_pictures_beyond_the_state(tmp_path):
    journal = Journal(tmp_path)
    for step in (3, 6, 9):
        journal.write("metrics", step, {"total": 1 / step})
        picture_path(tmp_path, step).touch()
    (tmp_path / "curves" / "mine.png").touch()
    save_checkpoints(tmp_path, parts(), 6, {"score": 0.5}, 0.0, lambda *_: None)
    assert resume_run(tmp_path, parts(), truncate_logs=False) == (6, 0.5)
    assert len(list((tmp_path / "curves").iterdir())) == 4, "another process does not touch them"
    resume_run(tmp_path, parts(), truncate_logs=True)
    assert sorted(p.name for p in (tmp_path / "curves").iterdir()) == [
        "000003.png", "000006.png", "mine.png"
    ]  # fmt: skip
    assert (tmp_path / "metrics.csv").read_text() == "step,total\n3,0.333333\n6,0.166667\n"


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


def test_tensorboard_holds_the_rows_of_the_tables(tmp_path):
    pytest.importorskip("tensorboard", reason="needs the extra 'tensorboard'")
    first = Journal(tmp_path, tensorboard=True)
    for step in (25, 50, 75):
        first.write("metrics", step, {"total": 100.0 / step, "gradient_norm": float("inf")})
    first.write("development", 50, {"dev_score": 0.5, "dev_auc": float("nan")})
    first.close()
    second = Journal(tmp_path, step=50, tensorboard=True)  # a run that goes on from 50
    second.write("metrics", 75, {"total": 7.0, "gradient_norm": 1.0})
    second.close()
    assert scalars(tmp_path / "tensorboard") == {
        "metrics/total": [(25, 4.0), (50, 2.0), (75, 7.0)],
        "metrics/gradient_norm": [(75, 1.0)],
        "development/score": [(50, 0.5)],
    }
