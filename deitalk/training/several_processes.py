"""Several processes that train one model, each on its share of every batch.

One process is the case of a share that is the whole; nothing is exchanged then.
"""

from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from deitalk.config.section import Optimisation
from deitalk.errors import ConfigError
from deitalk.training.journal import check_trackers

PATIENCE = timedelta(hours=6)
"""The other processes wait so long for the first, which builds meshes and evaluates."""


def new_accelerator(
    settings: Optimisation, item_size: int = 1, track: Sequence[str] = (), out: Path | None = None
) -> Any:
    """Join the processes of this training and choose the device.

    Parameters
    ----------
    settings : Optimisation
        Size of a batch.
    item_size : int
        What one item counts in ``train.batch_size``: the frames of a segment.
    track, out
        Trackers and run folder, as for `deitalk.training.trainer.run_training`.

    Returns
    -------
    accelerate.Accelerator

    Raises
    ------
    ConfigError
        If the items of a batch cannot be shared equally, or there is no such tracker.
    MissingError
        If the package of a tracker is not installed.
    """
    from accelerate import Accelerator, DistributedDataParallelKwargs, InitProcessGroupKwargs

    check_trackers(track)
    accelerator = Accelerator(
        cpu=not torch.accelerator.is_available(),
        mixed_precision="no",  # `in_precision` does it: accelerate fixes one for the whole process
        log_with=list(track) or None,
        project_dir=None if out is None else str(out / "tensorboard"),
        kwargs_handlers=[
            # Without contrast or intensity the motion encoder has no gradient. Buffers are running
            # means, of which the first process's are saved, and bases, which never change.
            DistributedDataParallelKwargs(find_unused_parameters=True, broadcast_buffers=False),
            InitProcessGroupKwargs(timeout=PATIENCE),
        ],
    )
    whole = item_size * accelerator.num_processes
    if settings.batch_size % whole:
        raise ConfigError(
            f"train.batch_size={settings.batch_size} cannot be shared by "
            f"{accelerator.num_processes} processes; make it a multiple of {whole}"
        )
    return accelerator


class InBfloat16(nn.Module):
    """A network that computes in bfloat16 and returns float32; its weights stay float32."""

    def __init__(self, network: nn.Module, device: torch.device) -> None:
        super().__init__()
        self.network, self.kind = network, device.type

    def forward(self, *inputs: Any) -> Any:
        """As the network's."""
        from accelerate.utils import convert_to_fp32

        with torch.autocast(self.kind, torch.bfloat16):
            output = self.network(*inputs)
        return convert_to_fp32(output)


def in_precision(network: nn.Module, precision: str, device: torch.device) -> nn.Module:
    """The network itself for ``float32``, an `InBfloat16` of it for ``bfloat16``."""
    return InBfloat16(network, device) if precision == "bfloat16" else network


def mean_over_processes(values: Tensor) -> Tensor:
    """Mean of every number over the processes; no gradient flows through it."""
    if not are_several():
        return values
    total = values.detach().clone()
    torch.distributed.all_reduce(total)
    return total / torch.distributed.get_world_size()


def are_several() -> bool:
    """Whether several processes train together."""
    return torch.distributed.is_available() and torch.distributed.is_initialized()
