"""The training loop of every model: step, average, evaluate, save, resume, log.

It depends on a `Task` and on no product, such as `deitalk.training.curves`. The main path is
`run_training`, then `Trainer.fit`, then `Trainer.update`; `deitalk.training.run_folder` writes the
files.
"""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from pathlib import Path
from types import MappingProxyType
from typing import Any, Generic, cast

import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader

from deitalk.config.section import RunConfig
from deitalk.data.seeded_batches import Item, SeededBatches, Share
from deitalk.errors import DataError
from deitalk.models.folder import describe_model, read_about
from deitalk.safe_path import safe_path
from deitalk.training.journal import Journal
from deitalk.training.optimizer import (
    new_scheduler,
    restore_buffers,
    shared_copy,
    update_average,
)
from deitalk.training.run_folder import (
    Learnt,
    open_folder,
    resume_run,
    save_checkpoints,
    save_state,
)
from deitalk.training.several_processes import in_precision, mean_over_processes, new_accelerator
from deitalk.workers import DATA_WORKERS, end_with_parent
from rig.errors import UserError

LOG_EVERY = 25
"""Steps between rows of ``metrics.csv``."""
MAX_BAD_STEPS = 20
"""A run ends after so many gradients in a row that are not finite."""

Progress = Callable[[int, int, dict[str, float]], None]


def silent(step: int, total: int, values: dict[str, float]) -> None:
    """Report no progress."""


class Task(ABC, Generic[Item]):
    """What is trained: a model, its batches, its loss and its scores.

    The trainer calls `read`, then `build`, then everything else.

    Attributes
    ----------
    config : RunConfig
        All settings; the trainer itself uses ``config.train``.
    model : Module
        What is trained; set by `build`.
    item_size : int
        What one item counts in ``train.batch_size``.
    frozen : set of str
        Names in the model's state dict that never change.
    state : mapping of str to Module
        What ``state.pt`` keeps beside the model.
    scores_start : bool
        Whether the weights before the first step are scored, and kept if none are better.
    keeps_state : bool
        Whether ``state.pt`` of a run that is over still holds weights and optimiser.
    """

    config: RunConfig
    model: nn.Module
    item_size: int = 1
    frozen: Set[str] = frozenset()
    state: Mapping[str, nn.Module] = MappingProxyType({})
    scores_start: bool = False
    keeps_state: bool = True

    def read(self, out: Path) -> None:
        """Read the data, or build it in the run folder; the first process does so before others."""

    @abstractmethod
    def build(self, device: torch.device) -> None:
        """Build the model, from the seed that is set, and what the loss needs on the device."""

    @abstractmethod
    def epoch_size(self) -> int:
        """Size of an epoch in the unit of ``train.batch_size``."""

    @abstractmethod
    def optimizer(self) -> torch.optim.Optimizer:
        """Make the optimiser of the model's weights."""

    @abstractmethod
    def batches(self, share: Share) -> SeededBatches[Item]:
        """Make the training batches."""

    @abstractmethod
    def loss(self, network: nn.Module, batch: Item) -> dict[str, Tensor]:
        """Compute every part of the loss, and their sum as ``total``.

        Parameters
        ----------
        network : Module
            The model, perhaps wrapped; to be called in its place.
        batch : Item
            On the device.
        """

    @abstractmethod
    def validate(self, model: nn.Module) -> dict[str, float]:
        """Scores on the validation clips; the weights with the highest ``score`` are kept."""

    def draw(self, out: Path, step: int) -> None:
        """Draw what an evaluation shows into the run folder."""

    @abstractmethod
    def save(self, folder: Path, model: nn.Module, summary: dict[str, Any]) -> None:
        """Write a model folder; `summary` describes the training."""

    def set_training(self) -> None:
        """Put the model in training mode."""
        self.model.train()


def run_training(
    task: Task[Item],
    out: Path,
    *,
    resume: bool = False,
    track: Sequence[str] = (),
    progress: Progress = silent,
) -> dict[str, Any]:
    """Train to the end of a run.

    Parameters
    ----------
    task : Task
        What is trained.
    out : Path
        Run folder (see `deitalk.training.run_folder`); new or empty unless `resume`.
    resume : bool
        Continue from the run folder's ``state.pt``: on a CPU the weights become those of an
        uninterrupted run, bit for bit. Where there is none yet the run begins, so that one and
        the same call may be repeated until it ends.
    track : sequence of str
        Trackers of accelerate that get the numbers too: ``tensorboard``, whose events are in the
        run folder, ``wandb``, ``mlflow`` …; a continued run stays one run there.
    progress : callable
        Called by one process with the step, the number of steps and the values that were logged.

    Returns
    -------
    dict
        Step and development scores of the best model.

    Raises
    ------
    DataError
        If the data or the run folder is not as it must be, or gradients stay not finite.
    ConfigError
        If the configuration differs from the run that is resumed, or the batch cannot be shared
        among the processes.
    MissingError
        If the package of a tracker is not installed.
    rig.errors.TargetError
        If the run folder holds what no run wrote, or edited files, or is in use.
    """
    accelerator = new_accelerator(task.config.train, task.item_size, track, out)
    is_main = accelerator.is_main_process
    with open_folder(out, task.config, resume=resume, writes=is_main):
        accelerator.wait_for_everyone()  # before the first process writes
        with accelerator.main_process_first():
            task.read(out)
        trainer = Trainer(task, accelerator, progress if is_main else silent)
        if resume:
            trainer.resume(out)
        journal = Journal(out, step=trainer.step, accelerator=accelerator if is_main else None)
        try:
            trainer.fit(journal)
        finally:
            journal.close()
        if is_main and not task.keeps_state:
            save_state(out, {}, {"step": trainer.total, "best_score": trainer.best_score})
        return dict(describe_model(out / "best")["training"])


class Trainer(Generic[Item]):
    """One run of a task.

    Parameters
    ----------
    task : Task
        Its data are read.
    accelerator : accelerate.Accelerator
        From `new_accelerator`.
    progress : callable
        As for `run_training`.

    Attributes
    ----------
    step, total : int
        Steps done, and steps of the whole run.
    average : Module
        The averaged weights, which are scored and saved.
    gradient_norm : float
        Of the last step, before clipping.
    seconds, taken : float, int
        Time in steps, evaluations left out, and what they took of ``train.batch_size``.
    """

    def __init__(self, task: Task[Item], accelerator: Any, progress: Progress = silent) -> None:
        self.task, self.accelerator, self.progress = task, accelerator, progress
        self.settings = task.config.train
        torch.manual_seed(self.settings.seed)
        task.build(accelerator.device)
        settings = self.settings
        if settings.steps is not None:
            self.total = settings.steps
        else:
            size = settings.batch_size * settings.accumulate
            self.total = max(math.ceil(settings.epochs * self.task.epoch_size() / size), 1)
        self.average = task.model  # without steps they are the same
        if self.total:
            average = shared_copy(task.model, task.frozen)
            self.average = average.eval().requires_grad_(False)
            self.optimizer = task.optimizer()
            self.scheduler = new_scheduler(self.optimizer, self.settings, self.total)
        self.step, self.best_score = 0, -math.inf
        self.gradient_norm, self.seconds, self.bad_steps, self.taken = 0.0, 0.0, 0, 0

    @property
    def parts(self) -> dict[str, Any]:
        """What ``state.pt`` keeps; nothing of a run without steps."""
        if not self.total:
            return {}
        model, average = (Learnt(m, self.task.frozen) for m in (self.task.model, self.average))
        own = {"model": model, "average": average, "optimizer": self.optimizer}
        return {**own, "scheduler": self.scheduler, **self.task.state}

    def resume(self, out: Path) -> None:
        """Continue the run of a folder from its last state."""
        self.step, self.best_score = resume_run(
            out, self.parts, truncate_logs=self.accelerator.is_main_process
        )

    def fit(self, journal: Journal) -> None:
        """Step to the end of the run, or of patience; log, evaluate and save on the way."""
        self.progress(self.step, self.total, {})
        if self._is_stale(journal.out):
            return
        network = self.prepare() if self.total else self.task.model
        if self.task.scores_start and not self.step and not (journal.out / "state.pt").is_file():
            self._evaluate(journal)
        batches = self._batches()
        while self.step < self.total:
            began = time.perf_counter()
            parts = self.update(network, batches)
            self.seconds += time.perf_counter() - began
            self.taken += self.settings.batch_size * self.settings.accumulate
            is_last = self.step == self.total
            if self.step % LOG_EVERY == 0 or is_last:
                # Log the parts of the loss, averaged over the processes, the gradient and the rate.
                mean = mean_over_processes(torch.stack([part.detach() for part in parts.values()]))
                values = dict(zip(parts, mean.tolist(), strict=True))
                values["gradient_norm"] = self.gradient_norm
                values["learning_rate"] = float(max(self.scheduler.get_last_lr()))
                if self.accelerator.is_main_process:
                    journal.write("metrics", self.step, values)
                self.progress(self.step, self.total, values | {"rate": self.taken / self.seconds})
            if self.step % self.settings.evaluate_every == 0 or is_last:
                self._evaluate(journal)
                if self._is_stale(journal.out):
                    return

    def _evaluate(self, journal: Journal) -> None:
        """Evaluate in the first process; the others wait."""
        if self.accelerator.is_main_process:
            self.progress(self.step, self.total, self.evaluate(journal))
        self.accelerator.wait_for_everyone()

    def _is_stale(self, out: Path) -> bool:
        """Whether the last evaluations, as many as ``train.patience``, brought nothing better."""
        patience = self.settings.patience
        if patience is None or not (out / "best").is_dir():
            return False
        since_best: int = self.step - read_about(out / "best")["training"]["step"]
        return since_best >= patience * self.settings.evaluate_every

    def prepare(self) -> nn.Module:
        """Move all to the device; return the network as the processes share it.

        ``task.model`` stays the plain one.
        """
        device = self.accelerator.device
        network = in_precision(self.task.model, self.settings.precision, device)
        if self.settings.compile:
            network = cast("nn.Module", torch.compile(network))
        shared: nn.Module
        shared, self.optimizer = self.accelerator.prepare(network, self.optimizer)
        self.average.to(device)
        return shared

    def _batches(self) -> Iterator[Item]:
        """Yield the process's share of the batches, from the run's step on."""
        if self.step == self.total:
            return
        done = self.step * self.settings.accumulate
        share = Share(done, self.accelerator.process_index, self.accelerator.num_processes)
        loader: DataLoader[Item] = DataLoader(
            self.task.batches(share),
            batch_size=None,
            num_workers=self.settings.workers,
            multiprocessing_context=DATA_WORKERS if self.settings.workers else None,
            worker_init_fn=end_with_parent,
        )
        with safe_path():
            batches = iter(loader)
        for batch in batches:
            if isinstance(batch, UserError):
                raise batch
            yield type(batch)(*(part.to(self.accelerator.device) for part in batch))

    def update(self, network: nn.Module, batches: Iterator[Item]) -> dict[str, Tensor]:
        """One step, of ``train.accumulate`` batches; without it where its gradient is not finite.

        The norm is that of the averaged gradient, so that all processes leave out the same batches.

        Returns
        -------
        dict
            Every part of the loss of the last batch.

        Raises
        ------
        DataError
            If `MAX_BAD_STEPS` gradients in a row are not finite.
        """
        items = [next(batches) for _ in range(self.settings.accumulate)]
        # Dropout depends on the step alone, and is the same in a resumed run.
        seed = (self.settings.seed * 2**20 + self.step) * 64 + self.accelerator.process_index
        torch.manual_seed(seed)
        self.task.set_training()
        self.optimizer.zero_grad(set_to_none=True)
        parts: dict[str, Tensor] = {}
        for item in items:
            parts = self.task.loss(network, item)
            self.accelerator.backward(parts["total"] / self.settings.accumulate)
        limit = self.settings.gradient_clip or math.inf
        self.gradient_norm = float(self.accelerator.clip_grad_norm_(network.parameters(), limit))
        if math.isfinite(self.gradient_norm):
            self._accept()
        else:
            restore_buffers(self.task.model, self.average)
            self.bad_steps += 1
            if self.bad_steps >= MAX_BAD_STEPS:
                raise DataError(
                    f"step {self.step}: {self.bad_steps} gradients in a row are not finite; lower "
                    "train.learning_rate, set train.gradient_clip, or check the data"
                )
        self.step += 1
        return parts

    def _accept(self) -> None:
        self.bad_steps = 0
        self.optimizer.step()
        self.scheduler.step()
        model, decay = self.task.model, self.settings.ema
        update_average(self.average, model, self.step, decay, self.task.frozen)

    def evaluate(self, journal: Journal) -> dict[str, float]:
        """Score the averaged weights, keep them if none were better, save the state."""
        scores = self.task.validate(self.average.eval())
        named = {f"dev_{name}": value for name, value in scores.items()}
        journal.write("development", self.step, named)
        self.task.draw(journal.out, self.step)
        self.best_score = save_checkpoints(
            journal.out,
            self.parts,
            self.step,
            scores,
            self.best_score,
            lambda folder, summary: self.task.save(folder, self.average, summary),
        )
        return named
