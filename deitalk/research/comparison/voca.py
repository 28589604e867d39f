"""An encoder after VOCA (Cudeiro et al. 2019), for comparison (SDFA §5.1.3, Table 4).

VOCA convolves over a window of DeepSpeech's outputs; its decoder gives vertex offsets in a PCA
basis. Layer sizes are from memory of their paper. Deviation: DeepSpeech's own input, 26
mel-frequency cepstral coefficients, takes the place of its output, so that this model needs no
pretrained recogniser; DeepSpeech is timed apart (`deitalk.research.evaluation.benchmark_mesh`).
Approximate: the speaker's label joins once, before the decoder.
"""

import math

import torch
from torch import Tensor, nn

from deitalk.audio.mel import MelSpectrogram
from deitalk.frontends.base import Encoder, window_index
from deitalk.research.config import VocaConfig


class VocaEncoder(Encoder):
    """Cepstrum, batch normalisation, strided convolutions over time.

    Parameters
    ----------
    config : VocaConfig
    """

    cosines: Tensor

    def __init__(self, config: VocaConfig) -> None:
        super().__init__()
        self.config, self.frame_rate = config, config.frame_rate
        self.reach = config.window_frames // 2
        self.mel = MelSpectrogram(config.window_seconds, config.frame_rate, config.n_mels)
        self.register_buffer("cosines", _cosines(config.n_mels, config.n_mfcc), persistent=False)
        layers: list[nn.Module] = [nn.BatchNorm1d(config.n_mfcc)]
        before, left = config.n_mfcc, config.window_frames
        for after in config.channels:
            layers += [nn.Conv1d(before, after, 3, 2, 1), nn.ReLU()]
            before, left = after, -(-left // 2)
        self.convolve = nn.Sequential(*layers)
        self.output_size = before * left

    def features(self, waveform: Tensor, n_spectra: int, first: int = 0) -> Tensor:
        """Log-mel and its derivatives [shape=(B, 3, F, n_spectra)]."""
        mel: Tensor = self.mel(waveform, n_spectra, first)
        return mel

    def forward(self, features: Tensor, places: Tensor) -> Tensor:
        """Map (B, 3, F, L) to (B, T, D); the derivatives are not used."""
        cepstrum = features[:, 0].transpose(1, 2) @ self.cosines  # (B, L, n_mfcc)
        index = window_index(places, self.config.window_frames, cepstrum.shape[1])
        windows = cepstrum[:, index].flatten(0, 1).transpose(1, 2)  # (B T, n_mfcc, W)
        out: Tensor = self.convolve(windows).flatten(1)
        return out.view(len(features), len(places), -1)


def _cosines(n_mels: int, n_mfcc: int) -> Tensor:
    """Orthonormal DCT-II [shape=(n_mels, n_mfcc)]."""
    place = (torch.arange(n_mels, dtype=torch.float64) + 0.5).unsqueeze(1)
    table = torch.cos(math.pi / n_mels * place * torch.arange(n_mfcc, dtype=torch.float64))
    table *= math.sqrt(2 / n_mels)
    table[:, 0] /= math.sqrt(2)
    return table.float()
