"""A first layer that begins by hearing bands: cosines on the mel scale, under Hann windows.

Filters that begin at random must first become a filter bank, which takes raw audio and many steps
(SincNet, Ravanelli & Bengio 2018, and LEAF, Zeghidour et al. 2021, begin with one too). The shape
of the layer stays, and so does its freedom: every tap is learnt on.
"""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from deitalk.errors import ConfigError
from deitalk.features import SAMPLE_RATE

PHASES = 3
"""Channels a band: rectified cosines a third of a turn apart sum to its level, within 14 %."""
LOWEST_HZ, HIGHEST_HZ = 60.0, 7600.0
NORM = 10.0
"""Length of a filter. The norm after the layer takes it out again; Adam's steps, all of one size,
change a long filter little."""


def cosine_bank(n_bands: int, kernel_size: int) -> NDArray[np.float64]:
    """Filters [shape=(PHASES * n_bands, kernel_size)] of length `NORM`, a band's phases together.

    A window is as long as its band's width wants, between half the kernel and all of it.
    """
    low, high = (2595 * math.log10(1 + hertz / 700) for hertz in (LOWEST_HZ, HIGHEST_HZ))
    edges = 700 * (10 ** (np.linspace(low, high, n_bands + 2) / 2595) - 1)  # Hz, of mel filters
    centres, widths = edges[1:-1, None, None], (edges[2:] - edges[:-2])[:, None, None]
    lengths = np.clip(4 * SAMPLE_RATE / widths, kernel_size / 2, kernel_size)
    time = np.arange(kernel_size) - (kernel_size - 1) / 2  # samples
    window = np.cos(np.pi * np.clip(time / lengths, -0.5, 0.5)) ** 2
    turns = centres * time / SAMPLE_RATE + np.arange(PHASES)[:, None] / PHASES
    bank = (window * np.cos(2 * np.pi * turns)).reshape(-1, kernel_size)
    filters: NDArray[np.float64] = NORM * bank / np.linalg.norm(bank, axis=1, keepdims=True)
    return filters


@torch.no_grad()
def begin_as_cosines(layer: nn.Conv1d) -> None:
    """Give a convolution over one channel the bank's filters.

    Raises
    ------
    ConfigError
        If its channels are no multiple of `PHASES`, or its kernel is too short to tell bands apart.
    """
    channels, kernel_size = layer.out_channels, layer.kernel_size[0]
    if channels % PHASES or kernel_size < SAMPLE_RATE // 100:
        raise ConfigError(
            f"model.frontend.cosine_bank: the first of conv_dim, {channels}, must be a multiple of "
            f"{PHASES}, and of conv_kernel, {kernel_size}, at least {SAMPLE_RATE // 100} (10 ms); "
            "change them or leave the bank out"
        )
    bank = cosine_bank(channels // PHASES, kernel_size)
    layer.weight.copy_(torch.from_numpy(bank).unsqueeze(1))
