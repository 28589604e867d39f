"""Changes of low rank of trained layers (LoRA, Hu et al. 2021), merged when the model is saved.

A weight W becomes W + B A, where A [shape=(rank, inputs)] is random and B [shape=(outputs, rank)]
begins at 0; W stays as it is. A convolution's weight counts as a matrix of its outputs and of all
its inputs at every offset, so that linear layers and convolutions are changed alike, and a saved
model is an ordinary one. (peft wraps each layer in a module of its own; merging by torch's
parametrisations needs neither that nor another dependency.)
"""

from collections.abc import Iterable

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize


class LowRank(nn.Module):
    """Change of one weight.

    Parameters
    ----------
    weight : Tensor [shape=(outputs, ...)]
        Gives the shape.
    rank : int
        At most the smaller side of the matrix is used.
    """

    def __init__(self, weight: Tensor, rank: int) -> None:
        super().__init__()
        outputs, inputs = weight.flatten(1).shape
        rank = min(rank, outputs, inputs)
        self.down = nn.Parameter(torch.randn(rank, inputs) * inputs**-0.5)
        self.up = nn.Parameter(torch.zeros(outputs, rank))

    def forward(self, weight: Tensor) -> Tensor:
        """Add the change."""
        return weight + (self.up @ self.down).view_as(weight)


def add_adapters(layers: Iterable[nn.Module], rank: int) -> None:
    """Give every linear layer and convolution a `LowRank` change, which alone learns."""
    for layer in layers:
        for module in [m for m in layer.modules() if isinstance(m, nn.Linear | nn.Conv1d)]:
            module.requires_grad_(False)
            parametrize.register_parametrization(module, "weight", LowRank(module.weight, rank))


def merged_weights(model: nn.Module) -> dict[str, Tensor]:
    """State dict of the model as it was without adapters, their changes added to its weights."""
    weights = dict(model.state_dict())
    for path, module in model.named_modules():
        if parametrize.is_parametrized(module, "weight"):
            parts = f"{path}.parametrizations.weight."
            weights = {name: w for name, w in weights.items() if not name.startswith(parts)}
            changed: Tensor = module.weight
            weights[f"{path}.weight"] = changed.detach()
    return weights
