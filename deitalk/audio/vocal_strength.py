"""Strength of a whole voice from its sound without its level.

One number of a recording at any gain: the decibels by which the speaker is louder than usual, as
far as spectrum and pitch tell. Three small networks, trained from different seeds, are averaged;
each is three convolutions on prosody and spectrum, whose mean and spread over the speech are mapped
to the number. `deitalk.training.vocal_strength` trains them.

Not in the paper: DEITalk's saliency compares frames of one clip, not clips. Letters: F features.
"""

from functools import lru_cache
from importlib import resources

import numpy as np
import torch
from safetensors.torch import load
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.prosody import BANDS, Prosody
from rig.arrays import Float32

WEIGHTS = "vocal_strength.safetensors"
FEATURES = BANDS + 4
PITCH, VOICED = BANDS, BANDS + 1
"""Columns of the frames."""
MEMBERS, CHANNELS, KERNEL, DILATIONS = 3, 48, 5, (1, 2, 4)
LOWEST, HIGHEST = -4.5, 1.0
"""Limits of a band below and above the power of all speech, in powers of ten."""
FEWEST_FRAMES = 3
UNIT_DB = 3.0
"""Decibels per unit of the network's output."""
REST_WEIGHT = 1e-3
"""Weight of frames without speech."""


def strength_frames(prosody: Prosody, activity: Float32) -> Float32:
    """Input of the network: features of every frame, not yet level-normalised [shape=(T, F)].

    Log power of the bands (powers of ten), octaves of pitch over 100 Hz where voiced, voiced,
    periodicity of speech, speech.
    """
    voiced, speech = prosody.voiced, activity > 0
    return np.concatenate(
        [
            np.log10(prosody.bands + 1e-9),
            np.where(voiced, prosody.pitch / 12, 0)[:, None],
            voiced[:, None],
            np.where(speech, prosody.periodicity, 0)[:, None],
            speech[:, None],
        ],
        axis=1,
    ).astype(np.float32)


def without_level(frames: Float32) -> tuple[Float32, float]:
    """Features with the power of the speech taken off its bands, and that power in dB."""
    speech = frames[:, -1] > 0
    if speech.sum() < FEWEST_FRAMES:
        speech = np.ones(len(frames), bool)
    power = np.log10((10.0 ** frames[speech, :BANDS].astype(np.float64)).sum(axis=1).mean())
    out = frames.copy()
    out[:, :BANDS] = np.clip(frames[:, :BANDS] - power, LOWEST, HIGHEST)
    return out, 10 * float(power)


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
            From `without_level`.
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


class VocalStrength(nn.Module):
    """Frames of speech to its strength: the mean of several networks."""

    def __init__(self, members: int = MEMBERS) -> None:
        super().__init__()
        self.members = nn.ModuleList(Member() for _ in range(members))

    def forward(self, frames: Tensor, weight: Tensor) -> Tensor:
        """Strength in dB [shape=(B,)]; arguments as for `Member`."""
        return torch.stack([member(frames, weight) for member in self.members]).mean(dim=0)

    @torch.no_grad()
    def measure(self, frames: Float32) -> float:
        """Strength of a recording in dB above the usual; 0 where nothing is voiced.

        Parameters
        ----------
        frames : array [shape=(T, F)]
            From `strength_frames`.
        """
        if not frames[:, VOICED].any():
            return 0.0
        frames, _ = without_level(frames)
        weight = np.maximum(frames[:, -1], REST_WEIGHT)
        return float(self(torch.tensor(frames)[None], torch.tensor(weight)[None]))


def _mean_and_spread(x: Tensor, share: Tensor) -> Tensor:
    """Weighted mean and standard deviation over time: (B, C, T) and (B, 1, T) to (B, 2 C)."""
    mean = (x * share).sum(dim=2)
    square = ((x - mean.unsqueeze(2)) ** 2 * share).sum(dim=2)
    return torch.cat([mean, square.clamp_min(1e-4).sqrt()], dim=1)


@lru_cache(maxsize=1)
def vocal_strength() -> VocalStrength:
    """The network with the weights of the package."""
    content = resources.files("deitalk.audio").joinpath(WEIGHTS).read_bytes()
    network = VocalStrength()
    network.load_state_dict({name: value.float() for name, value in load(content).items()})
    return network.eval()
