"""One update of any training: take the gradient, or leave the batch out, and follow with a mean."""

import math
from typing import Protocol

import torch
from torch import nn

from deitalk.errors import DataError

MAX_BAD_STEPS = 20


class Training(Protocol):
    """What an update changes."""

    @property
    def model(self) -> nn.Module:
        """What learns."""

    @property
    def average(self) -> nn.Module:
        """What follows it."""

    optimizer: torch.optim.Optimizer
    scheduler: torch.optim.lr_scheduler.LRScheduler
    step: int
    bad_steps: int


def update(
    run: Training, gradient_norm: float, decay: float | None, frozen: frozenset[str] = frozenset()
) -> None:
    """Step the optimiser, the schedule and the average; leave a batch out that is not finite.

    Parameters
    ----------
    run : Training
        Its gradients are clipped already.
    gradient_norm : float
        Before clipping.
    decay : float or None
        Of the moving average; None keeps the weights as they are.
    frozen : frozenset of str
        Names in the state dict that never change, and need no average.

    Raises
    ------
    DataError
        If `MAX_BAD_STEPS` gradients in a row are not finite.
    """
    if math.isfinite(gradient_norm):
        run.bad_steps = 0
        run.optimizer.step()
        run.scheduler.step()
        _follow(run, decay, frozen)
    else:
        _leave_out(run)


@torch.no_grad()
def _follow(run: Training, decay: float | None, frozen: frozenset[str]) -> None:
    """Exponential moving average of weights and buffers; a young average truncate_logs faster."""
    rate = 1.0 if decay is None else 1 - min(decay, (1 + run.step) / (10 + run.step))
    values = run.model.state_dict()
    for name, mean in run.average.state_dict().items():
        if name in frozen:
            continue
        if mean.dtype.is_floating_point:
            mean.lerp_(values[name], rate)
        else:
            mean.copy_(values[name])


@torch.no_grad()
def _leave_out(run: Training) -> None:
    """Undo what a bad batch did to running means; give up after too many in a row."""
    for mean, value in zip(run.average.buffers(), run.model.buffers(), strict=True):
        if not value.isfinite().all():
            value.copy_(mean)
    run.bad_steps += 1
    if run.bad_steps >= MAX_BAD_STEPS:
        raise DataError(
            f"step {run.step}: {run.bad_steps} gradients in a row are not finite; lower "
            "train.learning_rate, set train.gradient_clip, or check the data with "
            "`deitalk data check`"
        )
