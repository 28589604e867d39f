"""The networks of `deitalk.audio.vocal_strength` in torch, where they are trained.

Letters: F features.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.vocal_strength import (
    CHANNELS,
    DILATIONS,
    FEATURES,
    KERNEL,
    MEMBERS,
    UNIT_DB,
)
from rig.arrays import Float32


class Member(nn.Module):
    """Frames of speech to its strength: one network."""

    mean: Tensor
    spread: Tensor

    def __init__(self, dropout: float = 0.2) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(FEATURES))
        self.register_buffer("spread", torch.ones(FEATURES))
        sizes = (FEATURES, *[CHANNELS] * len(DILATIONS))
        self.layers = nn.ModuleList(
            nn.Conv1d(sizes[i], CHANNELS, KERNEL, padding=KERNEL // 2 * d, dilation=d)
            for i, d in enumerate(DILATIONS)
        )
        self.dropout = nn.Dropout(dropout)
        self.hidden = nn.Linear(2 * CHANNELS, CHANNELS)
        self.output = nn.Linear(CHANNELS, 1)
        self.direct = nn.Linear(2 * FEATURES, 1)

    def forward(self, frames: Tensor, weight: Tensor) -> Tensor:
        """Strength in dB.

        Parameters
        ----------
        frames : Tensor [shape=(B, T, F)]
            From `deitalk.audio.vocal_strength.without_level`.
        weight : Tensor [shape=(B, T)]
            Of every frame in the means.

        Returns
        -------
        Tensor [shape=(B,)]
        """
        x = ((frames - self.mean) / self.spread).transpose(1, 2)
        share = (weight / weight.sum(dim=1, keepdim=True)).unsqueeze(1)
        direct: Tensor = self.direct(_mean_and_spread(x, share))
        x = F.gelu(self.layers[0](x))
        for layer in self.layers[1:]:
            x = self.dropout(x)
            x = x + F.gelu(layer(x))
        hidden = self.dropout(F.gelu(self.hidden(_mean_and_spread(x, share))))
        output: Tensor = UNIT_DB * (direct + self.output(hidden))[:, 0]
        return output


class StrengthNetwork(nn.Module):
    """Frames of speech to its strength: the mean of several networks."""

    def __init__(self, members: int = MEMBERS) -> None:
        super().__init__()
        self.members = nn.ModuleList(Member() for _ in range(members))

    def forward(self, frames: Tensor, weight: Tensor) -> Tensor:
        """Strength in dB [shape=(B,)]; arguments as for `Member`."""
        return torch.stack([member(frames, weight) for member in self.members]).mean(dim=0)

    def weights(self) -> dict[str, Float32]:
        """State as arrays, for `deitalk.audio.vocal_strength.VocalStrength`."""
        return {name: value.numpy() for name, value in self.state_dict().items()}


def _mean_and_spread(x: Tensor, share: Tensor) -> Tensor:
    """Weighted mean and standard deviation over time: (B, C, T) and (B, 1, T) to (B, 2 C)."""
    mean = (x * share).sum(dim=2)
    square = ((x - mean.unsqueeze(2)) ** 2 * share).sum(dim=2)
    return torch.cat([mean, square.clamp_min(1e-4).sqrt()], dim=1)
