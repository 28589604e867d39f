"""The two ablations of parts of SDFA's encoder (SDFA §5.2.2).

N windows, W spectra of a window.
"""

from itertools import pairwise
from typing import Any, cast

from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.frontends.mel_bilstm import normalise_weights
from deitalk.frontends.sdfa_encoder import SDFAEncoder
from deitalk.research.config import AblatedMelConfig


class ConvolutionGathering(nn.Module):
    """Ablation: convolutions along frequency in place of the Spec-BiLSTM (§5.2.2, Fig. 6a).

    Paper silent: their sizes. Here two of kernel 3, as wide as the BiLSTM's output, then the same
    projection.

    Parameters
    ----------
    config : AblatedMelConfig
    """

    def __init__(self, config: AblatedMelConfig) -> None:
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


class AblatedEncoder(SDFAEncoder):
    """SDFA's encoder with convolutions in place of a BiLSTM or an attention.

    They have the methods of what they replace, and no common base class.

    Parameters
    ----------
    config : AblatedMelConfig
    """

    def __init__(self, config: AblatedMelConfig) -> None:
        super().__init__(config)
        frontend = self.frontend
        new: list[nn.Module] = []
        if config.gathering == "convolution":
            frontend.spectral = cast("Any", ConvolutionGathering(config))
            new.append(frontend.spectral)
        if config.summary == "convolution":
            summary = ConvolutionSummary(frontend.output_size, config.window_frames)
            frontend.attention = cast("Any", summary)
            new.append(frontend.attention)
        if config.weight_norm:
            for module in new:
                normalise_weights(module)
