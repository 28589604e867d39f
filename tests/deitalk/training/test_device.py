"""Losses of a tuning off the CPU: every operand on the model's device, none in double precision."""

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from deitalk.data.seeded_batches import Share
from deitalk.training.curve_losses import CurveLoss
from deitalk.training.tuning.task import FinetuneTask
from tests.deitalk.training.conftest import recipe

DEVICE = torch.device("meta")
MOVES = ("aten::_to_copy", "aten::copy_")


class OneDevice(TorchDispatchMode):
    """Refuses what CUDA and MPS do: operands on two devices, and double precision on MPS."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        given = [t for t in tree_leaves((args, kwargs)) if isinstance(t, torch.Tensor)]
        devices = {t.device for t in given if t.ndim}
        assert len(devices) < 2 or func.name().split(".")[0] in MOVES, f"{func} on {devices}"
        out = func(*args, **(kwargs or {}))
        results = [t for t in tree_leaves(out) if isinstance(t, torch.Tensor)]
        doubles = [t for t in results if t.device == DEVICE and t.dtype == torch.float64]
        assert not doubles, f"{func} in double precision"
        return out


def test_losses_and_gradients_stay_on_the_device_of_the_model(base, data):
    task = FinetuneTask(recipe(base), data)
    task.build(torch.device("cpu"))
    batch = next(iter(task.batches(Share())))
    task.model.to(DEVICE)
    task.base.to(DEVICE)
    task._loss = CurveLoss(task.config.loss, hold=task.config.tune.hold)
    with OneDevice():
        there = type(batch)(*(part.to(DEVICE) for part in batch))
        with pytest.raises(AssertionError, match=r"on \{"):
            _ = there.curves + batch.curves
        parts = task.loss(task.model, there)
        parts["total"].backward()
    assert {part.device for part in parts.values()} == {DEVICE}
