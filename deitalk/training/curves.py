"""Training: windows in, a model folder out (DEITalk §4.1). ``deitalk train CONFIG --data --out``.

The main path is `train`, then `_fit`, then `_step`; `deitalk.training.run_folder` writes the files.
"""

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import nn
from torch.utils.data import DataLoader

from deitalk.config import Config, TrainConfig
from deitalk.data.clips import Clip, read_clips
from deitalk.data.frozen_features import FrozenFeatures
from deitalk.data.windows import Batches, Window, count_windows
from deitalk.errors import ConfigError
from deitalk.evaluation.validation import ValidationSet
from deitalk.figures.canvas import can_draw
from deitalk.models.checkpoint import require_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import describe_model
from deitalk.models.weights_file import network_shapes
from deitalk.training.curve_loss import Loss
from deitalk.training.distillation import Teacher, read_teacher, start_as
from deitalk.training.run_folder import open_folder, picture_path, resume_run, save_checkpoints
from deitalk.training.run_tables import Journal, summary_writer
from deitalk.training.update import update
from deitalk.training.validation_figure import FixedClips
from deitalk.workers import end_with_parent
from rig import ControlSet

LOG_EVERY = 25

Progress = Callable[[int, int, dict[str, float]], None]


def _silent(step: int, total: int, values: dict[str, float]) -> None:
    """Tell nobody."""


@dataclass
class Run:
    """What changes while training."""

    model: DEITalk
    average: DEITalk
    optimizer: torch.optim.Optimizer
    scheduler: torch.optim.lr_scheduler.LRScheduler
    total: int
    """Steps of the whole run."""
    step: int = 0
    best_score: float = -math.inf
    bad_steps: int = 0

    @property
    def parts(self) -> dict[str, Any]:
        """What ``state.pt`` keeps."""
        names = ("model", "average", "optimizer", "scheduler")
        return {name: getattr(self, name) for name in names}


class Validation(NamedTuple):
    """The validation clips: those that are scored, and those that are drawn."""

    development: ValidationSet
    drawn: FixedClips | None
    """None without matplotlib."""

    @classmethod
    def of(cls, data: Path, controls: ControlSet) -> "Validation":
        """Read them from a dataset folder."""
        clips = read_clips(data, "validation")
        drawn = FixedClips.of(clips, controls) if clips and can_draw() else None
        return cls(ValidationSet.of(clips, controls), drawn)


def train(
    config: Config,
    data: Path,
    out: Path,
    *,
    resume: bool = False,
    start_from: Path | None = None,
    tensorboard: bool = False,
    frozen_features: FrozenFeatures | None = None,
    progress: Progress = _silent,
) -> dict[str, Any]:
    """Train a model.

    Two validation clips are drawn at every evaluation if matplotlib is installed.

    Parameters
    ----------
    config : Config
        Model, loss, data and schedule.
    data : Path
        Dataset folder.
    out : Path
        Run folder (see `deitalk.training.run_folder`); new or empty unless `resume`.
    resume : bool
        Go on from the run folder's ``state.pt``: on a CPU the weights become those of an
        uninterrupted run, bit for bit. Where there is none yet the run begins, so that one and
        the same call may be repeated until it ends.
    start_from : Path or None
        Model folder whose weights are the start (fine-tuning).
    tensorboard : bool
        Write TensorBoard's events to the run folder too.
    frozen_features : FrozenFeatures or None
        Those of ``train.frozen_frontend``, where several runs share what they heard.
    progress : callable
        Told the step, the number of steps and the values that were logged; by one process.

    Returns
    -------
    dict
        Step and development scores of the best model.

    Raises
    ------
    DataError
        If the dataset or the run folder is not as it must be, or gradients stay not finite.
    ConfigError
        If `config` differs from the run that is resumed, or from the weights to start from, or
        the batch cannot be shared among the processes.
    MissingError
        If TensorBoard is asked for and not installed.
    rig.errors.TargetError
        If the run folder holds what no run wrote, or edited files, or is in use.
    """
    if tensorboard:
        summary_writer()  # known before anything is read
    accelerator = _accelerator(config.train)
    clips = read_clips(data, "train")
    with open_folder(out, config, resume=resume, writes=accelerator.is_main_process):
        accelerator.wait_for_everyone()  # all see what was there before the first step
        run, teacher, frozen_features = _prepare(config, clips, start_from, frozen_features)
        if resume:
            run.step, run.best_score = resume_run(
                out, run.parts, truncate_logs=accelerator.is_main_process
            )
        loader = _loader(clips, run, config, accelerator, frozen_features)
        witness = Validation.of(data, run.model.controls)
        if not accelerator.is_main_process:
            progress, tensorboard = _silent, False
        progress(run.step, run.total, {})
        journal = Journal(out, step=run.step, tensorboard=tensorboard)
        try:
            _fit(run, loader, witness, config, journal, accelerator, progress, teacher)
        finally:
            journal.close()
        return dict(describe_model(out / "best")["training"])


def _prepare(
    config: Config,
    clips: Sequence[Clip],
    start_from: Path | None,
    frozen_features: FrozenFeatures | None,
) -> tuple[Run, DEITalk | None, FrozenFeatures | None]:
    """The run at step 0, its teacher and what it hears with."""
    network_shapes(lambda: DEITalk(config.model, pretrained=False))  # not too large to be built
    torch.manual_seed(config.train.seed)
    model = DEITalk(config.model)
    teacher = read_teacher(config.train.teacher, model)
    if teacher is not None:
        start_as(model, teacher)
    if start_from is not None:
        _copy_weights(model, start_from)
    if config.train.frozen_frontend is not None:
        frozen_features = frozen_features or FrozenFeatures(config.train.frozen_frontend)
        frozen_features.copy_into(model)
    run = _start(config, model, n_steps(config, clips), is_taught=teacher is not None)
    return run, teacher, frozen_features


def _accelerator(settings: TrainConfig) -> Any:
    from accelerate import Accelerator, DistributedDataParallelKwargs

    accelerator = Accelerator(
        cpu=not torch.cuda.is_available(),
        mixed_precision="bf16" if settings.precision == "bfloat16" else "no",
        # Without contrast or intensity the motion encoder has no gradient.
        kwargs_handlers=[DistributedDataParallelKwargs(find_unused_parameters=True)],
    )
    if settings.batch_size % accelerator.num_processes:
        raise ConfigError(
            f"train.batch_size={settings.batch_size} cannot be shared by "
            f"{accelerator.num_processes} processes; make it a multiple of them"
        )
    return accelerator


def _copy_weights(model: DEITalk, folder: Path) -> None:
    try:
        model.load_state_dict(require_model(folder, DEITalk).state_dict())
    except RuntimeError:
        raise ConfigError(
            f"{folder}: its weights do not fit the configuration's model; begin with "
            f"{folder / 'config.yaml'}"
        ) from None


def _loader(
    clips: Sequence[Clip],
    run: Run,
    config: Config,
    accelerator: Any,
    frozen_features: FrozenFeatures | None,
) -> DataLoader[Any]:
    """Batches from the run's step on; this process's share of each."""
    batches = Batches(
        clips,
        run.model.controls,
        config.data,
        config.train.seed,
        config.train.batch_size,
        skip=run.step,
        rank=accelerator.process_index,
        world=accelerator.num_processes,
        frozen_features=frozen_features,
        clean=config.train.teacher is not None,
    )
    return DataLoader(
        batches, batch_size=None, num_workers=config.train.workers, worker_init_fn=end_with_parent
    )


def _fit(
    run: Run,
    loader: DataLoader[Any],
    witness: Validation,
    config: Config,
    journal: Journal,
    accelerator: Any,
    progress: Progress,
    teacher: DEITalk | None,
) -> None:
    """Step to the end of the run; log, evaluate and save on the way."""
    # Accelerate wraps the network for several processes; `run.model` stays the plain one.
    network, run.optimizer = accelerator.prepare(run.model, run.optimizer)
    run.average.to(accelerator.device)
    taught = None if teacher is None else Teacher(teacher, accelerator)
    loss = Loss(config, run.model.controls, accelerator.device, taught)
    batches: Iterator[Window] = iter(loader if run.step < run.total else ())
    while run.step < run.total:
        batch = Window(*(part.to(accelerator.device) for part in next(batches)))
        # Dropout depends on the step alone, so that a resumed run meets the same.
        torch.manual_seed((config.train.seed * 2**20 + run.step) * 64 + accelerator.process_index)
        values = _step(run, network, loss, batch, config.train, accelerator)
        run.step += 1
        is_last = run.step == run.total
        if run.step % LOG_EVERY == 0 or is_last:
            if accelerator.is_main_process:
                journal.write("metrics", run.step, values)
            progress(run.step, run.total, values)
        if run.step % config.train.evaluate_every == 0 or is_last:
            if accelerator.is_main_process:
                progress(run.step, run.total, _evaluate(run, witness, config, journal))
            accelerator.wait_for_everyone()


def n_steps(config: Config, clips: Sequence[Clip]) -> int:
    """Steps of a run: given, or from passes over all windows of all clips."""
    if config.train.steps is not None:
        return config.train.steps
    windows = count_windows(clips, config.data)
    return max(math.ceil(config.train.epochs * windows / config.train.batch_size), 1)


def _start(config: Config, model: DEITalk, total: int, *, is_taught: bool = False) -> Run:
    settings = config.train
    groups = _groups(model, settings.learning_rate, is_taught)
    kind = torch.optim.AdamW if settings.optimizer == "adamw" else torch.optim.Adam
    optimizer = kind(groups, weight_decay=settings.weight_decay)
    scheduler: torch.optim.lr_scheduler.LRScheduler
    if settings.schedule == "one_cycle":
        scheduler = torch.optim.lr_scheduler.OneCycleLR(
            optimizer,
            [group["lr"] for group in groups],
            total_steps=total + 1,
            pct_start=0.08,
            cycle_momentum=False,
            div_factor=10,
            final_div_factor=100,
        )
    else:
        scheduler = torch.optim.lr_scheduler.ConstantLR(optimizer, factor=1.0)
    average = copy.deepcopy(model).eval().requires_grad_(False)
    return Run(model, average, optimizer, scheduler, total)


def _groups(model: DEITalk, rate: float, is_taught: bool) -> list[dict[str, Any]]:
    """What learns, and how fast: what began as the teacher's at a third, as in `train_sdfa`."""
    if not is_taught:
        return [{"params": [p for p in model.parameters() if p.requires_grad], "lr": rate}]
    frontend: list[nn.Parameter] = []
    rest: list[nn.Parameter] = []
    for name, parameter in model.named_parameters():
        if parameter.requires_grad:
            (frontend if name.startswith("frontend.") else rest).append(parameter)
    return [{"params": frontend, "lr": rate}, {"params": rest, "lr": rate / 3}]


def _step(
    run: Run,
    network: nn.Module,
    loss: "Loss",
    batch: Window,
    settings: TrainConfig,
    accelerator: Any,
) -> dict[str, float]:
    """One update; a batch whose gradient is not finite is left out.

    The norm is that of the averaged gradient, so that all processes leave out the same batches.
    """
    run.model.train()
    if settings.frozen_frontend is not None:
        run.model.get_submodule("frontend").eval()
    parts = loss(network, batch)
    run.optimizer.zero_grad(set_to_none=True)
    accelerator.backward(parts["total"])
    limit = settings.gradient_clip or math.inf
    norm = float(accelerator.clip_grad_norm_(network.parameters(), limit))
    update(run, norm, settings.ema)
    values = {name: float(part.detach()) for name, part in parts.items()}
    rate = float(run.scheduler.get_last_lr()[0])
    return values | {"gradient_norm": norm, "learning_rate": rate}


def _evaluate(run: Run, witness: Validation, config: Config, journal: Journal) -> dict[str, float]:
    """Score and draw the averaged weights, keep them if none were better, and save the state."""
    run.average.eval()
    scores = witness.development.score(run.average)
    named = {f"dev_{name}": value for name, value in scores.items()}
    journal.write("development", run.step, named)

    def save(folder: Path, summary: dict[str, Any]) -> None:
        save_model(folder, run.average, config, summary)

    if witness.drawn is not None:
        witness.drawn.draw(run.average, picture_path(journal.out, run.step))
    run.best_score = save_checkpoints(
        journal.out, run.parts, run.step, scores, run.best_score, save
    )
    return named
