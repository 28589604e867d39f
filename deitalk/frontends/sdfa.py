"""SDFA's speech encoder at any frame rate, and the two ablations of its parts (SDFA §5.2.2).

N windows, W spectra of a window.
"""

from itertools import pairwise
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.config.frontends import SDFAMelConfig
from deitalk.errors import CheckpointError
from deitalk.frontends.base import NO_ATTENTION, Encoder, window_index
from deitalk.frontends.mel_bilstm import (
    MelFrontend,
    SpectralGathering,
    TemporalAttention,
    normalise_weights,
)

WINDOWS_AT_ONCE = 64
CONTEXT_SECONDS = 1.0
"""Context of a Time-BiLSTM along the clip, on either side of the requested frames."""


class SDFAEncoder(Encoder):
    """Formant analysis, Time-BiLSTM, attention (SDFA §3.2-3.3).

    Parameters
    ----------
    config : SDFAMelConfig
        ``recurrence: window`` runs the Time-BiLSTM in every window, as printed; ``segment`` once
        along all spectra, which is some ten times less work (Deviation).
    """

    def __init__(self, config: SDFAMelConfig) -> None:
        super().__init__()
        self.config, self.frame_rate = config, config.frame_rate
        self.frontend = MelFrontend(config)
        self.output_size = self.frontend.output_size
        self.reach = config.window_frames // 2
        if config.recurrence == "segment":
            self.context_seconds = CONTEXT_SECONDS
        # The replacements have the methods of what they replace, and no common base class.
        if config.gathering == "convolution":
            self.frontend.spectral = cast("SpectralGathering", ConvolutionGathering(config))
        if config.summary == "convolution":
            summary = ConvolutionSummary(self.output_size, config.window_frames)
            self.frontend.attention = cast("TemporalAttention", summary)
        if config.weight_norm:
            if config.gathering == "convolution":
                normalise_weights(self.frontend.spectral)
            if config.summary == "convolution":
                normalise_weights(self.frontend.attention)

    def features(self, waveform: Tensor, n_spectra: int, first: int = 0) -> Tensor:
        """Log-mel and its derivatives [shape=(B, 3, F, n_spectra)]."""
        mel: Tensor = self.frontend.mel(waveform, n_spectra, first)
        return mel

    def forward(self, features: Tensor, places: Tensor) -> Tensor:
        """Map (B, 3, F, L) to z_att (B, T, D)."""
        spectral = self.frontend.spectral(features)  # z_spec (B, L, 256)
        if self.config.recurrence == "segment":
            memory, _ = self.frontend.recurrent(spectral)
            attended = self.frontend.attention.along(memory, places, self.config.window_frames)
            return self._centred(attended, memory[:, places])
        index = window_index(places, self.config.window_frames, spectral.shape[1])
        rows = [
            self.attend(spectral[:, part].flatten(0, 1))[0].view(len(spectral), len(part), -1)
            for part in torch.split(index, WINDOWS_AT_ONCE)
        ]
        return torch.cat(rows, dim=1)

    def attend(self, spectral: Tensor) -> tuple[Tensor, Tensor]:
        """Articulation analysis of windows (§3.3): (N, W, 256) to z_att (N, D), weights (N, W)."""
        memory, _ = self.frontend.recurrent(spectral)
        return self._attend(memory)

    def _attend(self, memory: Tensor) -> tuple[Tensor, Tensor]:
        config = self.config
        half = config.window_frames // 2
        first = half - config.query_frames // 2
        query = memory[:, first : first + config.query_frames]
        attended, weights = self.frontend.attention.windows(memory, query)
        return self._centred(attended, memory[:, half]), weights

    @torch.no_grad()
    def attention_weights(self, features: Tensor, places: Tensor) -> Tensor:
        """Attention weights [shape=(T, W)] of each place in features (1, 3, F, L)."""
        if self.config.summary != "attention":
            raise CheckpointError(NO_ATTENTION)
        spectral = self.frontend.spectral(features)[0]
        index = window_index(places, self.config.window_frames, len(spectral))
        if self.config.recurrence == "segment":
            memory = self.frontend.recurrent(spectral)[0]
            parts = [self._attend(memory[part])[1] for part in torch.split(index, WINDOWS_AT_ONCE)]
        else:
            parts = [self.attend(spectral[part])[1] for part in torch.split(index, WINDOWS_AT_ONCE)]
        return torch.cat(parts)

    def _centred(self, attended: Tensor, centre: Tensor) -> Tensor:
        normalise = self.frontend.normalise
        if normalise is None:
            return attended
        out: Tensor = normalise(attended + centre)
        return out


class ConvolutionGathering(nn.Module):
    """Ablation: convolutions along frequency in place of the Spec-BiLSTM (§5.2.2, Fig. 6a).

    Paper silent: their sizes. Here two of kernel 3, as wide as the BiLSTM's output, then the same
    projection.

    Parameters
    ----------
    config : SDFAMelConfig
    """

    def __init__(self, config: SDFAMelConfig) -> None:
        super().__init__()
        first, second, third = config.conv_channels
        wide = 2 * config.spec_hidden
        sizes = (3, first, second, third, wide, wide)
        layers: list[nn.Module] = []
        for i, (before, after) in enumerate(pairwise(sizes)):
            kernel = 1 if i == 2 else 3
            layers += [
                nn.Conv1d(before, after, kernel, padding=kernel // 2),
                nn.BatchNorm1d(after),
                nn.LeakyReLU(0.2),
            ]
            if i < 2:
                layers.append(nn.MaxPool1d(2))
        self.convolve = nn.Sequential(*layers)
        self.project = nn.Linear(wide * (config.n_mels // 4), config.spectral_size)

    def forward(self, mel: Tensor) -> Tensor:
        """Map (B, 3, F, L) to (B, L, spectral_size)."""
        batch, channels, bins, length = mel.shape
        x = self.convolve(mel.permute(0, 3, 1, 2).reshape(batch * length, channels, bins))
        out: Tensor = self.project(x.transpose(1, 2).flatten(1)).view(batch, length, -1)
        return out


class ConvolutionSummary(nn.Module):
    """Ablation: convolutions along time in place of the attention (§5.2.2, Fig. 6b).

    Paper silent: their sizes. Here dilated, of kernel 3, with the window as receptive field.

    Parameters
    ----------
    size : int
        Width of the memory.
    window : int
        Spectra of the window.
    """

    def __init__(self, size: int, window: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList()
        dilation = 1
        while 2 * dilation <= window // 2 + 1:
            self.layers.append(nn.Conv1d(size, size, 3, dilation=dilation))
            dilation *= 2

    def _all(self, memory: Tensor) -> Tensor:
        x = memory.transpose(1, 2)
        for layer in self.layers:
            assert isinstance(layer, nn.Conv1d)
            (wide,) = layer.dilation
            x = F.leaky_relu(layer(F.pad(x, (wide, wide))), 0.2)
        return x.transpose(1, 2)

    def windows(self, memory: Tensor, query: Tensor) -> tuple[Tensor, Tensor]:
        """As `TemporalAttention.windows`, with even weights: there is no attention."""
        length = memory.shape[1]
        return self._all(memory)[:, length // 2], memory.new_full(memory.shape[:2], 1 / length)

    def along(self, memory: Tensor, centres: Tensor, window: int) -> Tensor:
        """As `TemporalAttention.along`."""
        return self._all(memory)[:, centres]
