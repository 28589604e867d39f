"""A module of torch as one graph with its weights, which calls no Python."""

import warnings
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from deitalk.frontends.flat_kernel import by_columns

jit: Any = torch.jit


def frozen(module: nn.Module, example: tuple[Tensor, ...]) -> Callable[..., Any]:
    """A module as it is now, for any sizes of the axes that its operators take from its inputs.

    Constants are folded: products of few rows take a third less time. Modules that are not on the
    processor stay as they are.

    Parameters
    ----------
    module : nn.Module
        In evaluation mode.
    example : tuple of Tensor
        Its inputs, no axis of which is 1 that may have another size.
    """
    if example[0].device.type != "cpu":
        return module
    by_columns(module)
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # the tracer's own, on constants that are meant
        graph = jit.freeze(jit.trace(module.eval(), example, check_trace=False))

    def run(*inputs: Tensor) -> Any:
        with jit.optimized_execution(False):  # no search for fusions at each new size
            return graph(*inputs)

    return run
