"""Shares of a batch, and arithmetic in bfloat16."""

from typing import NamedTuple

import pytest
import torch
from torch import Tensor, nn

from deitalk.config.load import parse_config
from deitalk.errors import ConfigError
from deitalk.research.training.curve_losses import gather_rows
from deitalk.training.several_processes import (
    in_precision,
    mean_over_processes,
    new_accelerator,
)


class Result(NamedTuple):
    value: Tensor
    missing: None


class Network(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.layer = nn.Linear(64, 64)

    def forward(self, x: Tensor) -> Result:
        return Result(self.layer(x), None)


def test_bfloat16_is_coarser_and_gives_float32():
    torch.manual_seed(0)
    network, x = Network(), torch.randn(8, 64)
    device = torch.device("cpu")
    assert in_precision(network, "float32", device) is network
    exact, coarse = network(x).value, in_precision(network, "bfloat16", device)(x)
    assert isinstance(coarse, Result) and coarse.missing is None
    assert coarse.value.dtype == torch.float32
    error = (coarse.value - exact).abs().max()
    assert 1e-4 < error < 2**-6 * exact.abs().max()  # 8 bits of mantissa
    coarse.value.sum().backward()
    assert network.layer.weight.grad.dtype == torch.float32


def test_batch_that_cannot_be_shared_is_refused(monkeypatch):
    import accelerate

    monkeypatch.setattr(accelerate.Accelerator, "num_processes", property(lambda self: 3))
    settings = parse_config({"train": {"batch_size": 24}}).train
    assert new_accelerator(settings, 8).num_processes == 3  # a segment of 8 frames each
    message = r"train\.batch_size=24 cannot be shared by 3 processes; make it a multiple of 48"
    with pytest.raises(ConfigError, match=message):
        new_accelerator(settings, 16)


def test_one_process_exchanges_nothing():
    rows = torch.randn(3, 2)
    assert gather_rows(rows) is rows and mean_over_processes(rows) is rows
