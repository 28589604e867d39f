"""The training loop on the task of a line: what is stepped, averaged, logged, saved, resumed."""

import json
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest
import torch
from torch import Tensor, nn

from deitalk.config.curves import Config
from deitalk.config.load import parse_config
from deitalk.data.seeded_batches import SeededBatches, Share
from deitalk.errors import ConfigError, DataError
from deitalk.training import trainer as module
from deitalk.training.several_processes import new_accelerator
from deitalk.training.trainer import MAX_BAD_STEPS, Task, Trainer, run_training
from rig.files import output_folder
from tests.deitalk.training.conftest import killed_at

SLOPE = 2.0
"""Of the line that is learnt."""


class Point(NamedTuple):
    x: Tensor
    y: Tensor


class Line(SeededBatches[Point]):
    """Points of y = 2 x; those of `bad` batches are not finite."""

    def __init__(self, seed: int, batch_size: int, share: Share, bad: Sequence[int]) -> None:
        super().__init__(seed, batch_size, share)
        self.bad = bad

    def item(self, number: int) -> Point:
        x = torch.tensor([self.rng(number).standard_normal()], dtype=torch.float32)
        return Point(x, SLOPE * x * (torch.nan if number // self.batch_size in self.bad else 1))


class LineTask(Task[Point]):
    """A network with batch statistics and dropout; a module beside it that counts."""

    def __init__(self, config: Config, bad: Sequence[int] = (), scores: Sequence[float] = ()):
        self.config, self.bad, self.scores = config, bad, iter(scores)
        self.seen: list[Any] = []

    def build(self, device: torch.device) -> None:
        layers = nn.Linear(1, 8), nn.BatchNorm1d(8), nn.Dropout(0.1), nn.Linear(8, 1)
        self.model = nn.Sequential(*layers)
        self.count = nn.Module()
        self.count.register_buffer("calls", torch.zeros((), dtype=torch.int64))
        self.state = {"count": self.count}

    def epoch_size(self) -> int:
        return 21

    def optimizer(self) -> torch.optim.Optimizer:
        return torch.optim.Adam(self.model.parameters(), lr=self.config.train.learning_rate)

    def batches(self, share: Share) -> Line:
        settings = self.config.train
        return Line(settings.seed, settings.batch_size, share, self.bad)

    def loss(self, network: nn.Module, batch: Point) -> dict[str, Tensor]:
        self.count.calls += 1
        self.seen.append(batch.x[0].item())
        error = (network(batch.x) - batch.y).square().mean()
        return {"error": error, "total": 3 * error}

    def validate(self, model: nn.Module) -> dict[str, float]:
        assert not model.training
        with torch.no_grad():
            error = float((model(torch.ones(1, 1)) - SLOPE).abs())
        score = next(self.scores, -error)
        return {"score": score, "error": error}

    def save(self, folder: Path, model: nn.Module, summary: dict[str, Any]) -> None:
        with output_folder(folder, kind="model", force=True) as beside:
            torch.save(model.state_dict(), beside / "weights.pt")
            (beside / "summary.json").write_text(json.dumps(summary))


@pytest.fixture(autouse=True)
def small_model_folders(monkeypatch):
    """The task's model folders hold weights and a summary alone."""

    def describe(folder: Path) -> dict[str, Any]:
        return {"training": json.loads((folder / "summary.json").read_text())}

    monkeypatch.setattr(module, "describe_model", describe)


def config(**train: Any) -> Config:
    settings = {"learning_rate": 0.05, "batch_size": 4, "steps": 6, "evaluate_every": 2, **train}
    return parse_config({"train": settings})


def trained(out: Path, task: LineTask | None = None, /, **options: Any) -> LineTask:
    task = task or LineTask(config())
    run_training(task, out, **options)
    return task


def same_state(a: Path, b: Path) -> bool:
    first, second = (torch.load(run / "state.pt", weights_only=True) for run in (a, b))
    return str(first) == str(second)


def test_line_is_learnt_and_the_loss_is_logged(tmp_path):
    settings = config(steps=200, evaluate_every=100, batch_size=32, ema=0.9)
    trained(tmp_path / "run", LineTask(settings))
    metrics = pd.read_csv(tmp_path / "run/metrics.csv")
    assert metrics["step"].tolist() == [25, 50, 75, 100, 125, 150, 175, 200]
    assert list(metrics) == ["step", "error", "total", "gradient_norm", "learning_rate"]
    np.testing.assert_allclose(metrics["total"], 3 * metrics["error"], rtol=1e-4)
    scores = pd.read_csv(tmp_path / "run/development.csv")
    assert scores["dev_error"].iloc[-1] < 0.2 * SLOPE
    assert (metrics["learning_rate"] == 0.05).all()


@pytest.mark.parametrize("workers", [0, 2])
def test_resumed_run_has_the_weights_of_an_uninterrupted_one(tmp_path, workers):
    """The order of batches, dropout, averages, running means and the state beside the model."""
    settings = config(ema=0.8, schedule="one_cycle", workers=workers)
    trained(tmp_path / "whole", LineTask(config(ema=0.8, schedule="one_cycle")))
    with killed_at(5):
        trained(tmp_path / "run", LineTask(settings))
    task = trained(tmp_path / "run", LineTask(settings), resume=True)
    assert len(task.seen) == 2, "from step 4, the last that was saved"
    assert same_state(tmp_path / "run", tmp_path / "whole")
    for name in ("metrics.csv", "development.csv"):
        assert (tmp_path / "run" / name).read_text() == (tmp_path / "whole" / name).read_text()


def test_state_has_nothing_that_never_changes(tmp_path, monkeypatch):
    """And a resumed run has those weights from `Task.build`."""
    trained(tmp_path / "whole")
    names = set(torch.load(tmp_path / "whole/state.pt", weights_only=True)["model"])
    fixed = min(names)
    monkeypatch.setattr(LineTask, "frozen", {fixed})
    with killed_at(5):
        trained(tmp_path / "run")
    state = torch.load(tmp_path / "run/state.pt", weights_only=True)
    assert set(state["model"]) == set(state["average"]) == names - {fixed}
    task = trained(tmp_path / "run", resume=True)
    assert set(task.model.state_dict()) == names


def test_compiled_network_learns_as_the_plain_one(tmp_path, monkeypatch):
    """By the tracer without a compiler of C++, so that any machine can."""
    used = []
    compiled = torch.compile
    monkeypatch.setattr(
        torch, "compile", lambda n: used.append(n) or compiled(n, backend="aot_eager")
    )
    trained(tmp_path / "plain")
    trained(tmp_path / "compiled", LineTask(config(compile=True)))
    assert len(used) == 1
    plain, other = (pd.read_csv(tmp_path / k / "metrics.csv") for k in ("plain", "compiled"))
    pd.testing.assert_frame_equal(plain, other, rtol=1e-5)


def test_used_folder_or_other_settings_are_refused(tmp_path):
    trained(tmp_path / "run")
    with pytest.raises(DataError, match="holds a run already; set `resume=True`"):
        trained(tmp_path / "run")
    with pytest.raises(ConfigError, match=r"begun with another train\.seed"):
        trained(tmp_path / "run", LineTask(config(seed=9)), resume=True)


class PlainTask(LineTask):
    """Of one linear layer: no batch statistics, no dropout."""

    def build(self, device: torch.device) -> None:
        super().build(device)
        self.model = nn.Linear(1, 1)


def test_accumulated_batches_make_the_step_of_one_large_batch(tmp_path):
    small = trained(tmp_path / "small", PlainTask(config(batch_size=4, accumulate=2)))
    large = trained(tmp_path / "large", PlainTask(config(batch_size=8)))
    assert len(small.seen) == 2 * len(large.seen)
    for one, other in zip(small.model.parameters(), large.model.parameters(), strict=True):
        torch.testing.assert_close(one, other)


def test_start_is_the_result_where_no_step_is_better(tmp_path):
    task = LineTask(config(), scores=(5.0, 1.0, 2.0, 3.0))
    task.scores_start = True
    trained(tmp_path / "run", task)
    assert json.loads((tmp_path / "run/best/summary.json").read_text())["step"] == 0
    rows = pd.read_csv(tmp_path / "run/development.csv")
    assert rows["step"].tolist() == [0, 2, 4, 6]


def prepared(task: LineTask) -> tuple[Trainer[Point], nn.Module]:
    trainer = Trainer(task, new_accelerator(task.config.train))
    return trainer, trainer.prepare()


def test_bad_batch_is_left_out_and_the_next_one_is_taken():
    task = LineTask(config(), bad=(0,))
    trainer, network = prepared(task)
    before = {name: value.clone() for name, value in task.model.state_dict().items()}
    batches = iter(task.batches(Share()))
    trainer.update(network, batches)
    assert not np.isfinite(trainer.gradient_norm) and trainer.bad_steps == 1
    learnt = [name for name, _ in task.model.named_parameters()]
    assert all(torch.equal(task.model.state_dict()[name], before[name]) for name in learnt)
    trainer.update(network, batches)
    assert trainer.bad_steps == 0 and trainer.step == 2
    assert any(not torch.equal(task.model.state_dict()[name], before[name]) for name in learnt)


def test_running_means_that_a_bad_batch_spoils_are_restored():
    task = LineTask(config())
    trainer, network = prepared(task)
    good = next(iter(task.batches(Share())))
    trainer.update(network, iter([good._replace(x=good.x * torch.nan)]))
    assert all(buffer.isfinite().all() for buffer in task.model.buffers())
    assert all(buffer.isfinite().all() for buffer in trainer.average.buffers())


def test_many_bad_batches_in_a_row_end_the_run(tmp_path):
    task = LineTask(config(steps=100), bad=range(100))
    with pytest.raises(DataError, match="20 gradients in a row are not finite; lower train"):
        trained(tmp_path / "run", task)
    assert len(task.seen) == MAX_BAD_STEPS


def test_gradient_is_clipped_and_its_norm_before_is_logged():
    task = LineTask(config(gradient_clip=1e-3))
    trainer, network = prepared(task)
    trainer.update(network, iter(task.batches(Share())))
    left = torch.stack([p.grad.norm() for p in task.model.parameters()]).norm()
    assert float(left) == pytest.approx(1e-3, rel=1e-3)
    assert trainer.gradient_norm > 0.1


def test_other_processes_neither_write_nor_evaluate(tmp_path, monkeypatch):
    """The second of two, by its accelerator alone: nothing is exchanged here."""
    real = new_accelerator(config().train)
    second = SimpleNamespace(
        **{name: getattr(real, name) for name in ("device", "prepare", "backward")},
        clip_grad_norm_=real.clip_grad_norm_, wait_for_everyone=lambda: None,
        main_process_first=real.main_process_first, is_main_process=False, process_index=1,
        num_processes=2,
    )  # fmt: skip
    monkeypatch.setattr(module, "new_accelerator", lambda *_: second)
    monkeypatch.setattr(module, "describe_model", lambda folder: {"training": {}})
    (tmp_path / "run").mkdir()
    task = LineTask(config())
    task.validate = lambda model: pytest.fail("evaluated")  # type: ignore[method-assign]
    trained(tmp_path / "run", task, progress=lambda *_: pytest.fail("reported"))
    assert list((tmp_path / "run").iterdir()) == []
    whole = next(iter(task.batches(Share())))
    assert task.seen[0] == whole.x[1].item(), "its share of the first batch"


@pytest.mark.parametrize("workers", [0, 1])
def test_fault_in_the_data_is_one_line_from_any_process(tmp_path, monkeypatch, workers):
    def fails(self: Line, number: int) -> Point:
        raise DataError(f"clip {number}: mend it")

    monkeypatch.setattr(Line, "item", fails)
    with pytest.raises(DataError, match=r"^clip 0: mend it$"):
        trained(tmp_path / "run", LineTask(config(workers=workers)))
