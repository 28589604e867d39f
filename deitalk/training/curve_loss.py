"""The configured loss of a batch, over all processes of a training (DEITalk §4.1)."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from deitalk.config import Config
from deitalk.data.windows import Window
from deitalk.errors import ConfigError
from deitalk.models.curve_model import Output
from deitalk.training.curve_losses import total_loss
from deitalk.training.distillation import Teacher
from rig import ControlSet


class Loss:
    """The configured loss on one device."""

    def __init__(
        self,
        config: Config,
        controls: ControlSet,
        device: torch.device,
        teacher: Teacher | None = None,
    ) -> None:
        self.config = config.loss
        self.teacher = teacher
        self.weights = control_weights(config.loss.control_weights, controls).to(device)
        self.contact = torch.tensor(
            [i for i, name in enumerate(controls.names) if "lipsTogether" in name], device=device
        )

    def __call__(self, network: nn.Module, batch: Window) -> dict[str, Tensor]:
        """Every part of the loss of one batch."""
        curves = batch.curves if self.config.contrast else None
        output = network(batch.waveform, batch.emotion, batch.frames, batch.total, curves)
        parts = total_loss(
            _across_processes(output),
            batch.curves,
            batch.voice,
            batch.intensity,
            config=self.config,
            weights=self.weights,
            contact_controls=self.contact,
        )
        if self.teacher is not None:
            distance = self.teacher.distance(batch.clean, output.speech)
            parts["distillation"] = distance
            parts["total"] = parts["total"] + self.config.distillation * distance
        return parts


def _across_processes(output: Output) -> Output:
    """Embeddings of all processes' clips: contrast (Eq. 9-10) sees the whole batch."""
    distributed = torch.distributed
    if not (distributed.is_available() and distributed.is_initialized()):
        return output
    if output.intensity is None or output.motion_embedding is None:
        return output
    gather: Callable[[Tensor], Tensor] = _Gather.apply
    speech, motion = gather(output.intensity.embedding), gather(output.motion_embedding)
    return output._replace(
        intensity=output.intensity._replace(embedding=speech), motion_embedding=motion
    )


class _Gather(torch.autograd.Function):
    """Rows (B, E) of all processes, one after another.

    The gradients of the gathered rows are summed over the processes and then averaged with all
    others, which gives the gradient of one process with the whole batch.
    """

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
