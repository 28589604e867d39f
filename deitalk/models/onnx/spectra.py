"""Fourier transforms and waves as operators of a graph: products of small matrices, no tables."""

import math
from copy import copy
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.log_mel import N_FFT, SILENCE
from deitalk.frontends.whisper import PUBLISHED_FEATURES, LogMel, WhisperFrontend
from deitalk.postprocess.torch_columns import constant
from rig.arrays import Float64


def waves(a: Any, b: Any, count: int) -> Float64:
    """Cosines and negative sines (2, A, B) of a b turns of `count`."""
    angle = 2 * np.pi / count * (np.outer(a, b) % count)
    return np.stack((np.cos(angle), -np.sin(angle)))


class SpectralPower(nn.Module):
    """Power of the Fourier transform of real rows, by two steps of products of small matrices.

    With n = N2 n1 + n2 and k = k1 + N1 k2 the sum over n1 is a product with N1 x `rows` values, and
    that over n2 one with `columns` x N2 of them. Bin k is at place k of the result.

    Parameters
    ----------
    size : int
        Samples of a row, a multiple of N2; zeros follow them up to `points`.
    points : int
        Of the transform, N1 N2.
    bins : int
        That are needed, from 0 on; up to N1 more follow.
    split : int
        N2.
    """

    first: Tensor
    turn: Tensor
    second: Tensor

    def __init__(self, size: int, points: int, bins: int, split: int = 32) -> None:
        super().__init__()
        n1, n2 = points // split, split
        self.rows, self.split, self.bins = size // n2, n2, -(-bins // n1) * n1

        steps = np.arange(n1), np.arange(n2), np.arange(self.bins // n1)
        constant(self, "first", waves(steps[0], np.arange(self.rows), n1).reshape(2 * n1, -1))
        constant(self, "turn", waves(steps[0], steps[1], points))
        real, imaginary = waves(steps[1], steps[2], n2)
        both = np.block([[real, imaginary], [-imaginary, real]])
        constant(self, "second", both)

    def forward(self, rows: Tensor) -> Tensor:
        """Power (T, bins) of rows (T, size)."""
        n1 = self.turn.shape[1]
        parts = self.first @ rows.view(-1, self.rows, self.split)  # (T, 2 N1, N2)
        real, imaginary = parts[:, :n1], parts[:, n1:]
        cosine, sine = self.turn[0], self.turn[1]
        turned = (real * cosine - imaginary * sine, real * sine + imaginary * cosine)
        spectra = torch.cat(turned, dim=2) @ self.second  # (T, N1, 2 columns)
        columns = self.bins // n1
        power = spectra.square()
        power = power[..., :columns] + power[..., columns:]
        return power.transpose(1, 2).flatten(1)


class ProductMel(LogMel):
    """`LogMel` by products of matrices."""

    @classmethod
    def of(cls, mel: LogMel) -> "ProductMel":
        """The same spectrogram."""
        found = cls(mel.filters.shape[1], mel.rate)
        found.power = SpectralPower(N_FFT, N_FFT, len(mel.filters), split=16)
        found.filters = F.pad(mel.filters, (0, 0, 0, found.power.bins - len(mel.filters)))
        return found

    def decades(self, windows: Tensor) -> Tensor:
        """See `LogMel.decades`."""
        power: Tensor = self.power((windows * self.window).flatten(0, -2))  # type: ignore[operator]
        bands = power.view(*windows.shape[:-1], -1) @ self.filters
        return bands.clamp_min(SILENCE).log10()


class Positions:
    """The table of `deitalk.frontends.whisper.sinusoids`, by its formula.

    Parameters
    ----------
    step : float
        Between two rows.
    width : int
        D.
    """

    def __init__(self, step: float, width: int) -> None:
        half = width // 2
        self.step = step
        self.speed = torch.exp(-math.log(10_000) / (half - 1) * torch.arange(half))

    def __getitem__(self, places: Any) -> Tensor:
        """Rows at some places: a slice from 0 on, or a tensor (...)."""
        if isinstance(places, slice):
            places = torch.arange(places.stop)
        angles = (self.step * places.float()).unsqueeze(-1) * self.speed
        return torch.cat((angles.sin(), angles.cos()), dim=-1)


def with_formulas(frontend: WhisperFrontend) -> WhisperFrontend:
    """A copy of a frontend, with its weights, that computes spectra and positions here."""
    found = copy(frontend)
    found._modules = dict(frontend._modules)
    found.mel = ProductMel.of(frontend.mel)
    encoder = copy(frontend.encoder)
    encoder._buffers = {}
    positions = Positions(PUBLISHED_FEATURES / frontend.config.rate, frontend.config.width)
    object.__setattr__(encoder, "positions", positions)
    found.encoder = encoder
    return found
