"""Convolutions of few frames as one product of matrices."""

import torch
from torch import Tensor


class FlatKernel:
    """Weights of a convolution as one matrix (out, K in), kept until they change."""

    def __init__(self) -> None:
        self._kept: tuple[tuple[int, int], Tensor] | None = None

    def __call__(self, weight: Tensor) -> Tensor:
        """Matrix of weights (out, in, K), whose rows are those of `joined_taps`."""
        if torch.jit.is_tracing() or (  # type: ignore[attr-defined, no-untyped-call]
            weight.requires_grad and torch.is_grad_enabled()
        ):
            return weight.permute(0, 2, 1).flatten(1)
        state = (weight.data_ptr(), weight._version)
        if self._kept is None or self._kept[0] != state:
            self._kept = (state, weight.detach().permute(0, 2, 1).flatten(1).contiguous())
        return self._kept[1]


def joined_taps(rows: Tensor, taps: int, dilation: int = 1) -> Tensor:
    """Rows (..., T + span, in) that the taps of a causal kernel are given, (..., T, K in)."""
    span = dilation * (taps - 1)
    ends = range(-span, 0, dilation)
    return torch.cat(
        [*(rows[..., span + end : end, :] for end in ends), rows[..., span:, :]], dim=-1
    )
