"""Training: windows in, a model folder out (DEITalk §4.1). ``deitalk train CONFIG --data --out``.

A run folder holds ``config.yaml``, ``metrics.csv`` (a row a log interval), ``best/`` and ``last/``
(model folders) and ``state.pt`` (everything a killed run needs to go on exactly).
"""

import copy
import csv
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from torch import Tensor, nn
from torch.utils.data import DataLoader

from deitalk.checkpoint import save_model
from deitalk.config import Config, TrainConfig
from deitalk.data.folder import read_clips
from deitalk.data.windows import Batches, Window
from deitalk.development import DevelopmentSet
from deitalk.errors import ConfigError, DataError
from deitalk.losses import total_loss
from deitalk.models import DEITalk
from rig import ControlSet
from rig.files import atomic_write

LOG_EVERY = 25
MAX_BAD_STEPS = 20
"""Steps in a row with a loss or gradient that is not finite before the run gives up."""

Progress = Callable[[int, int, dict[str, float]], None]


@dataclass
class Run:
    """What changes while training."""

    model: DEITalk
    average: DEITalk
    optimizer: torch.optim.Optimizer
    scheduler: torch.optim.lr_scheduler.LRScheduler
    step: int = 0
    best_score: float = -math.inf
    bad_steps: int = 0


def train(
    config: Config,
    data: Path,
    out: Path,
    *,
    resume: bool = False,
    start_from: Path | None = None,
    progress: Progress = lambda step, total, values: None,
) -> dict[str, Any]:
    """Train a model.

    Parameters
    ----------
    config : Config
    data : Path
        Dataset folder.
    out : Path
        Run folder; must be new unless `resume`.
    resume : bool
        Go on from the run folder's ``state.pt``.
    start_from : Path or None
        Model folder whose weights are the start (fine-tuning).
    progress : callable
        Told the step, the number of steps and the values that were logged.

    Returns
    -------
    dict
        Step and development scores of the best model.
    """
    from accelerate import Accelerator

    accelerator = Accelerator(
        cpu=not torch.cuda.is_available(),
        mixed_precision="bf16" if config.train.precision == "bfloat16" else "no",
    )
    torch.manual_seed(config.train.seed)
    model = DEITalk(config.model)
    if start_from is not None:
        from deitalk.checkpoint import load_model

        model.load_state_dict(load_model(start_from).state_dict())
    clips = read_clips(data, "train")
    total = n_steps(config, clips_frames=len(clips) * 250)
    run = _start(config, model, total)
    _open_folder(out, config, resume)
    if resume:
        _restore(run, out)
    batches = Batches(
        clips,
        model.controls,
        config.data,
        config.train.seed,
        config.train.batch_size,
        skip=run.step,
        rank=accelerator.process_index,
        world=accelerator.num_processes,
    )
    loader = DataLoader(batches, batch_size=None, num_workers=config.train.workers)
    development = DevelopmentSet.of(read_clips(data, "validation"), model.controls)
    # Accelerate wraps the network for several processes; `run.model` stays the plain one.
    network, run.optimizer = accelerator.prepare(run.model, run.optimizer)
    run.average.to(accelerator.device)
    best: dict[str, Any] = {}
    loss = Loss(config, model.controls, accelerator.device)
    for batch in loader:
        if run.step >= total:
            break
        values = _step(run, network, loss, Window(*(x.to(accelerator.device) for x in batch)),
                       config.train, accelerator)
        run.step += 1
        if run.step % LOG_EVERY == 0 or run.step == total:
            _log(out, run, values)
            progress(run.step, total, values)
        if run.step % config.train.evaluate_every == 0 or run.step == total:
            if accelerator.is_main_process:
                best = _evaluate(run, development, config, out) or best
            accelerator.wait_for_everyone()
    return best


def n_steps(config: Config, clips_frames: int) -> int:
    """Steps of a run: given, or from epochs over all windows of the given number of frames."""
    if config.train.steps is not None:
        return config.train.steps
    windows = max(clips_frames // config.data.stride_frames, 1)
    return max(math.ceil(config.train.epochs * windows / config.train.batch_size), 1)


def _start(config: Config, model: DEITalk, total: int) -> Run:
    settings = config.train
    parameters = [p for p in model.parameters() if p.requires_grad]
    kind = torch.optim.AdamW if settings.optimizer == "adamw" else torch.optim.Adam
    optimizer = kind(parameters, lr=settings.learning_rate, weight_decay=settings.weight_decay)
    scheduler: torch.optim.lr_scheduler.LRScheduler
    if settings.schedule == "one_cycle":
        scheduler = torch.optim.lr_scheduler.OneCycleLR(
            optimizer, settings.learning_rate, total_steps=total + 1, pct_start=0.08,
            cycle_momentum=False, div_factor=10, final_div_factor=100,
        )
    else:
        scheduler = torch.optim.lr_scheduler.ConstantLR(optimizer, factor=1.0)
    average = copy.deepcopy(model).eval().requires_grad_(False)
    return Run(model, average, optimizer, scheduler)


class Loss:
    """The configured loss on one device."""

    def __init__(self, config: Config, controls: ControlSet, device: torch.device) -> None:
        self.config = config.loss
        self.weights = control_weights(config.loss.control_weights, controls).to(device)
        self.contact = torch.tensor(
            [i for i, name in enumerate(controls.names) if "lipsTogether" in name], device=device
        )

    def __call__(self, network: nn.Module, batch: Window) -> dict[str, Tensor]:
        """Every part of the loss of one batch."""
        output = network(batch.waveform, batch.emotion, batch.frames, batch.total, batch.curves)
        return total_loss(
            output, batch.curves, batch.voice, batch.intensity,
            config=self.config, weights=self.weights, contact_controls=self.contact,
        )


def control_weights(weights: dict[str, float], controls: ControlSet) -> Tensor:
    """Weight of every control from names of controls and of subsets; later entries win.

    Raises
    ------
    ConfigError
        If a name is neither.
    """
    out = torch.ones(len(controls.names))
    for name, value in weights.items():
        if name in controls.names:
            out[controls.index(name)] = value
        elif name in controls.subset_names:
            out[torch.as_tensor(controls.subset(name).copy())] = value
        else:
            matching = [i for i, control in enumerate(controls.names) if name in control]
            if not matching:
                raise ConfigError(
                    f"loss.control_weights: {name!r} is no control, part of one, or subset; "
                    f"subsets are {', '.join(controls.subset_names)}"
                )
            out[matching] = value
    return out


def _step(
    run: Run,
    network: nn.Module,
    loss: Loss,
    batch: Window,
    settings: TrainConfig,
    accelerator: Any,
) -> dict[str, float]:
    """One update; a batch whose loss or gradient is not finite is left out."""
    run.model.train()
    parts = loss(network, batch)
    run.optimizer.zero_grad(set_to_none=True)
    accelerator.backward(parts["total"])
    norm = accelerator.clip_grad_norm_(network.parameters(), settings.gradient_clip or 1e9)
    if not (torch.isfinite(parts["total"]) and torch.isfinite(norm)):
        run.bad_steps += 1
        if run.bad_steps >= MAX_BAD_STEPS:
            raise DataError(
                f"step {run.step}: {run.bad_steps} losses in a row are not finite; lower "
                "train.learning_rate, set train.gradient_clip, or check the data"
            )
    else:
        run.bad_steps = 0
        run.optimizer.step()
        _average(run, settings.ema)
    run.scheduler.step()
    values = {name: float(part.detach()) for name, part in parts.items()}
    return values | {"gradient_norm": float(norm), "learning_rate": run.scheduler.get_last_lr()[0]}


@torch.no_grad()
def _average(run: Run, decay: float | None) -> None:
    """Exponential moving average of weights and buffers; a young average forgets faster."""
    rate = 1.0 if decay is None else 1 - min(decay, (1 + run.step) / (10 + run.step))
    for mean, value in zip(
        run.average.state_dict().values(), run.model.state_dict().values(), strict=True
    ):
        if mean.dtype.is_floating_point:
            mean.lerp_(value, rate)
        else:
            mean.copy_(value)


def _evaluate(
    run: Run, development: DevelopmentSet, config: Config, out: Path
) -> dict[str, Any] | None:
    """Score the averaged weights, keep them if they are the best, and save the state."""
    run.average.eval()
    scores = development.score(run.average)
    _log(out, run, {f"dev_{name}": value for name, value in scores.items()}, "development.csv")
    summary = {"step": run.step, "development": scores}
    best = None
    if scores["score"] > run.best_score:
        run.best_score, best = scores["score"], summary
        save_model(out / "best", run.average, config, summary)
    save_model(out / "last", run.average, config, summary)
    with atomic_write(out / "state.pt") as beside:
        torch.save(
            {
                "model": run.model.state_dict(),
                "average": run.average.state_dict(),
                "optimizer": run.optimizer.state_dict(),
                "scheduler": run.scheduler.state_dict(),
                "step": run.step,
                "best_score": run.best_score,
                "random": torch.get_rng_state(),
            },
            beside,
        )
    return best


def _restore(run: Run, out: Path) -> None:
    state = torch.load(out / "state.pt", weights_only=True, map_location="cpu")
    run.model.load_state_dict(state["model"])
    run.average.load_state_dict(state["average"])
    run.optimizer.load_state_dict(state["optimizer"])
    run.scheduler.load_state_dict(state["scheduler"])
    run.step, run.best_score = state["step"], state["best_score"]
    torch.set_rng_state(state["random"])


def _open_folder(out: Path, config: Config, resume: bool) -> None:
    """Refuse to mix two runs in one folder."""
    has_state = (out / "state.pt").is_file()
    if resume and not has_state:
        raise DataError(f"{out}: no state.pt to go on from; leave out --resume to begin")
    if not resume and (out / "metrics.csv").exists():
        raise DataError(f"{out}: holds a run already; use --resume, or name another folder")
    out.mkdir(parents=True, exist_ok=True)
    settings = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
    (out / "config.yaml").write_text(settings)


def _log(out: Path, run: Run, values: dict[str, float], name: str = "metrics.csv") -> None:
    path = out / name
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.writer(file)
        if new:
            writer.writerow(["step", *values])
        writer.writerow([run.step, *(f"{np.float32(v):.6g}" for v in values.values())])
