"""Parts of the loss that trainings from the start have beside those of Eq. 8.

Letters: B batch, T frames, K lips-together controls.
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

from deitalk.errors import ConfigError
from deitalk.models.curve_model import Output
from deitalk.training.several_processes import are_several
from rig import ControlSet


def contact_loss(target: Tensor, predicted: Tensor, known: Tensor | None = None) -> Tensor:
    """Penalise lips that do not meet in bilabials.

    Not in the paper. Where the target's lips are closed (> 0.9), falling short of 0.95 costs the
    square of what is missing;
    everywhere, the prediction's side of one half is scored by a cross entropy, so that the curve
    is decided rather than blurred.

    Parameters
    ----------
    target, predicted : Tensor [shape=(B, T, K)]
        The lips-together controls.
    known : Tensor [shape=(B, K)] or None
        1 where the clip holds the control, else 0; None is 1 everywhere.
    """
    shut = F.relu(0.95 - predicted).square() * (target > 0.9)
    decided = F.binary_cross_entropy_with_logits(
        8 * (predicted - 0.5), target.clamp(0, 1), reduction="none"
    )
    cost = (shut + 0.1 * decided).mean(dim=1)
    known = torch.ones_like(cost) if known is None else known
    return (cost * known).sum() / known.sum().clamp(min=1)


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


def across_processes(output: Output) -> Output:
    """Embeddings of all processes' clips: contrast (Eq. 9-10) is of the whole batch."""
    if output.intensity is None or output.motion_embedding is None:
        return output
    speech, motion = gather_rows(output.intensity.embedding), gather_rows(output.motion_embedding)
    return output._replace(
        intensity=output.intensity._replace(embedding=speech), motion_embedding=motion
    )


def gather_rows(rows: Tensor) -> Tensor:
    """Rows (B, E) of all processes, one process after another; gradients flow back.

    The gradients of the gathered rows are summed over the processes and then averaged with all
    others, which gives the gradient of one process with the whole batch.
    """
    if not are_several():
        return rows
    gather: Callable[[Tensor], Tensor] = _Gather.apply
    return gather(rows)


class _Gather(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rows: Tensor) -> Tensor:
        parts = [torch.empty_like(rows) for _ in range(torch.distributed.get_world_size())]
        torch.distributed.all_gather(parts, rows.contiguous())
        return torch.cat(parts)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        gradient = gradient.clone()
        torch.distributed.all_reduce(gradient)
        return gradient.chunk(torch.distributed.get_world_size())[torch.distributed.get_rank()]
