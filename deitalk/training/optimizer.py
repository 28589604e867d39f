"""The optimizer, the learning rate's schedule and the averaged weights of any training."""

import copy
from collections.abc import Callable, Set
from typing import TypeVar

import torch
from torch import nn

from deitalk.config.curves import TrainConfig
from deitalk.config.section import Optimisation

NetworkT = TypeVar("NetworkT", bound=nn.Module)


def shared_copy(model: NetworkT, frozen: Set[str]) -> NetworkT:
    """Copy of a network that shares the tensors of its state dict that never change."""
    state = model.state_dict(keep_vars=True)
    return copy.deepcopy(model, {id(state[name]): state[name] for name in frozen})


def new_optimizer(
    model: nn.Module, settings: TrainConfig, factor: Callable[[str], float] = lambda name: 1.0
) -> torch.optim.Optimizer:
    """Make the configured optimizer of all parameters that learn.

    Parameters
    ----------
    model : Module
        Parameters without gradient are left out.
    settings : TrainConfig
        Names the optimizer, its rate and weight decay.
    factor : callable
        Factor on the learning rate of the parameter of a name.
    """
    rates: dict[float, list[nn.Parameter]] = {}
    for name, parameter in model.named_parameters():
        if parameter.requires_grad:
            rates.setdefault(settings.learning_rate * factor(name), []).append(parameter)
    kind = torch.optim.AdamW if settings.optimizer == "adamw" else torch.optim.Adam
    groups = [{"params": parameters, "lr": rate} for rate, parameters in rates.items()]
    return kind(groups, weight_decay=settings.weight_decay)


def new_scheduler(
    optimizer: torch.optim.Optimizer, settings: Optimisation, total: int
) -> torch.optim.lr_scheduler.LRScheduler:
    """Make the configured schedule.

    Parameters
    ----------
    optimizer : Optimizer
        The rates of its groups are the highest of ``one_cycle``, which begins at a tenth and ends
        at a thousandth of them.
    settings : Optimisation
        Names the schedule.
    total : int
        Steps of the run.
    """
    if settings.schedule == "constant":
        return torch.optim.lr_scheduler.ConstantLR(optimizer, factor=1.0)
    return torch.optim.lr_scheduler.OneCycleLR(
        optimizer,
        [group["lr"] for group in optimizer.param_groups],
        total_steps=total + 1,
        pct_start=0.08,  # share of the steps in which the rate rises
        cycle_momentum=False,
        div_factor=10,
        final_div_factor=100,
    )


@torch.no_grad()
def update_average(
    average: nn.Module, model: nn.Module, step: int, decay: float | None, frozen: Set[str]
) -> None:
    """Move an exponential moving average of weights and buffers on by one step.

    Parameters
    ----------
    average, model : Module
        Of the same structure.
    step : int
        Steps done before; the decay is at most (1 + step) / (10 + step), so that a young average
        forgets the first weights fast.
    decay : float or None
        In 0..1; None makes the average equal the model.
    frozen : set of str
        Names in the state dict that never change, and are left out.
    """
    rate = 1.0 if decay is None else 1 - min(decay, (1 + step) / (10 + step))
    values = model.state_dict()
    for name, mean in average.state_dict().items():
        if name in frozen:
            continue
        if mean.dtype.is_floating_point:
            mean.lerp_(values[name], rate)
        else:
            mean.copy_(values[name])


@torch.no_grad()
def restore_buffers(model: nn.Module, average: nn.Module) -> None:
    """Replace buffers that a bad batch left not finite (running means) by those of the average."""
    for mean, value in zip(average.buffers(), model.buffers(), strict=True):
        if not value.isfinite().all():
            value.copy_(mean)
