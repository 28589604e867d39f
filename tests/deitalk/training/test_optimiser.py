"""Schedules and averages, by hand."""

from itertools import pairwise

import pytest
import torch
from torch import nn

from deitalk.config.curves import Config
from deitalk.config.load import parse_config
from deitalk.training.optimizer import new_scheduler, restore_buffers, update_average


def rates(schedule: str, total: int = 100) -> list[float]:
    """Learning rate of every step."""
    settings = parse_config({"train": {"schedule": schedule}})
    assert isinstance(settings, Config)
    optimizer = torch.optim.SGD([{"params": [nn.Parameter(torch.zeros(1))], "lr": 2.0}])
    scheduler = new_scheduler(optimizer, settings.train, total)
    out = []
    for _ in range(total):
        out.append(float(scheduler.get_last_lr()[0]))
        optimizer.step()
        scheduler.step()
    return out


def test_one_cycle_rises_from_a_tenth_and_falls_to_a_thousandth():
    rate = rates("one_cycle")
    assert rate[0] == pytest.approx(0.2)
    assert max(rate) == pytest.approx(2.0, rel=1e-2) and 6 <= rate.index(max(rate)) <= 9
    assert rate[-1] < 0.01
    assert all(a >= b for a, b in pairwise(rate[9:]))


def normalised(value: float) -> nn.BatchNorm1d:
    layer = nn.BatchNorm1d(1)
    nn.init.constant_(layer.weight, value)
    layer.running_mean.fill_(value)
    layer.num_batches_tracked.fill_(int(value))
    return layer


@pytest.mark.parametrize(
    ("step", "decay", "expected"),
    [(0, 0.99, 9.2), (8, 0.99, 6.0), (10**6, 0.99, 2.08), (10**6, None, 10.0)],
)
def test_average_moves_by_hand(step, decay, expected):
    """From 2 to 10: the decay is at most (1 + step) / (10 + step), 0.1 at first, 0.5 at step 8."""
    average, model = normalised(2), normalised(10)
    update_average(average, model, step, decay, frozenset())
    assert average.weight.item() == pytest.approx(expected)
    assert float(average.running_mean) == pytest.approx(expected)
    assert int(average.num_batches_tracked) == 10, "whole numbers are copied"


def test_frozen_names_are_left_out_of_the_average():
    average, model = normalised(2), normalised(10)
    update_average(average, model, 0, None, {"running_mean"})
    assert average.weight.item() == 10 and float(average.running_mean) == 2


def test_only_buffers_that_are_not_finite_are_restored():
    average, model = normalised(2), normalised(10)
    model.running_mean.fill_(torch.nan)
    restore_buffers(model, average)
    assert float(model.running_mean) == 2 and int(model.num_batches_tracked) == 10
