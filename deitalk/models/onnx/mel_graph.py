"""Mel spectra in a graph: the Fourier transform is a product with two matrices."""

import math
from fractions import Fraction

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.mel import FLOOR, MEAN, SPREAD, MelSpectrogram, derivative

MARGIN = 4096
"""Zeros on either side of the sound, longer than any window and shift."""


def fourier_products(mel: MelSpectrogram) -> tuple[Tensor, Tensor]:
    """Matrices of mel power: samples (W,) to parts of each taper's spectrum, squares to (F,)."""
    angle = 2 * math.pi / mel.n_fft * torch.arange(mel.n_fft // 2 + 1, dtype=torch.float64)
    angle = torch.arange(mel.length, dtype=torch.float64)[:, None] * angle
    waves = torch.cat((angle.cos(), angle.sin()), dim=1)
    tapers = mel.tapers.double()
    transform = torch.cat([taper[:, None] * waves for taper in tapers], dim=1).float()
    return transform, mel.filters.repeat(2 * len(tapers), 1) / (mel.length * len(tapers))


class MelGraph(nn.Module):
    """`MelSpectrogram` of a whole sound, at several shifts side by side."""

    index: Tensor
    transform: Tensor
    filters: Tensor

    def __init__(self, mel: MelSpectrogram, shifts: list[int]) -> None:
        super().__init__()
        step = Fraction(SAMPLE_RATE) / Fraction(mel.frame_rate).limit_denominator(1000)
        self.period, self.count, self.phases = step.numerator, step.denominator, len(shifts)
        self.length = mel.length
        starts = torch.round(torch.arange(self.count, dtype=torch.float64) * float(step)).long()
        within = torch.arange(mel.length) - mel.length // 2 + MARGIN
        index = torch.tensor(shifts)[:, None, None] + starts[:, None] + within
        self.register_buffer("index", index.flatten())
        transform, filters = fourier_products(mel)
        self.register_buffer("transform", transform)
        self.register_buffer("filters", filters)

    def forward(self, sound: Tensor, n_spectra: int) -> Tensor:
        """Map (S,) to (phases, 3, F, n_spectra)."""
        mel = self.scaled(sound, n_spectra)
        slope = derivative(mel)
        return torch.stack((mel, slope, derivative(slope)), dim=1)

    def scaled(self, sound: Tensor, n_spectra: int) -> Tensor:
        """Map (S,) to (phases, F, n_spectra), without the derivatives."""
        periods = torch.arange((n_spectra + self.count - 1) // self.count) * self.period
        padded = F.pad(sound, (MARGIN, MARGIN))
        frames = padded[(periods[:, None] + self.index).flatten()]
        frames = frames.view(-1, self.phases, self.count, self.length)
        frames = frames.transpose(0, 1).reshape(self.phases, -1, self.length)[:, :n_spectra]
        power = (frames @ self.transform).square() @ self.filters
        return ((torch.log(power + FLOOR) - MEAN) / SPREAD).transpose(1, 2)
