"""Columns of curves in torch; in a graph of ONNX none scatters, which not every runtime can."""

from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn


class Columns(nn.Module):
    """Some columns of curves.

    Parameters
    ----------
    places : array of int [shape=(K,)]
        Which; each once.
    size : int
        C, all columns.
    """

    places: Tensor
    order: Tensor
    mask: Tensor

    def __init__(self, places: ArrayLike, size: int) -> None:
        super().__init__()
        columns = np.asarray(places, np.int64)
        order, mask = np.arange(size), np.zeros(size, np.float32)
        order[columns], mask[columns] = size + np.arange(len(columns)), 1
        constant(self, "places", columns)
        constant(self, "order", order)
        constant(self, "mask", mask)

    def __len__(self) -> int:
        return len(self.places)

    def forward(self, curves: Tensor) -> Tensor:
        """Read them (..., K) of curves (..., C)."""
        return curves.index_select(-1, self.places)

    def put(self, curves: Tensor, values: Tensor) -> Tensor:
        """Replace them in curves (..., C) by values (..., K)."""
        if torch.onnx.is_in_onnx_export():
            return torch.cat((curves, values), dim=-1).index_select(-1, self.order)
        return curves.index_copy(-1, self.places, values)  # in a quarter of the time


def constant(module: nn.Module, name: str, values: Any) -> None:
    """Give a module an array that goes to its device and is no weight; float64 as float32."""
    tensor = torch.as_tensor(np.array(values))
    tensor = tensor.float() if tensor.is_floating_point() else tensor
    module.register_buffer(name, tensor, persistent=False)


def smoothstep(share: Tensor) -> Tensor:
    """3 x^2 - 2 x^3 of values that are limited to 0 to 1."""
    share = share.clamp(0, 1)
    return share * share * (3 - 2 * share)
