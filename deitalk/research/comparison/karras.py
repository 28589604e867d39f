"""A convolutional encoder after Karras et al. 2017, for comparison (SDFA §5.2.1, Table 4).

SDFA describes it in a sentence: formant analysis convolves over the features of a spectrum,
articulation analysis over time, on linear-predictive features of a sliding window; the authors'
emotional state is replaced by the speaker's label. Layer sizes (72 to 256 channels, 64 spectra of
32 autocorrelations, 16 ms each) are from memory of the paper by Karras et al. Approximate: the
label joins once, before the decoder, not at every articulation layer; batch normalisation after
every convolution, without which short training fails.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.mel import spectra_centres
from deitalk.frontends.base import Encoder, window_index
from deitalk.research.config import KarrasConfig


class Autocorrelation(nn.Module):
    """Short-time autocorrelation, with the level in place of lag 0.

    Parameters
    ----------
    window_seconds, frame_rate : float
        Length of the Hann window, spectra per second.
    lags : int
        F: the level in place of lag 0, then lags 1..F - 1 over lag 0.
    """

    window: Tensor

    def __init__(self, window_seconds: float, frame_rate: float, lags: int) -> None:
        super().__init__()
        self.frame_rate, self.lags = frame_rate, lags
        self.length = round(window_seconds * SAMPLE_RATE)
        self.n_fft = 1 << (2 * self.length - 1).bit_length()
        self.register_buffer("window", torch.hann_window(self.length), persistent=False)

    def forward(self, waveform: Tensor, n_spectra: int, first: int = 0) -> Tensor:
        """Map (B, S) to (B, 1, lags, n_spectra); outside the waveform there is silence."""
        centres = spectra_centres(first + n_spectra, self.frame_rate)[first:]
        start = int(centres[0]) - self.length // 2
        stop = int(centres[-1]) + self.length
        piece = waveform[:, max(start, 0) : max(stop, 0)]
        before = max(-start, 0)
        piece = F.pad(piece, (before, max(stop - start - before - piece.shape[1], 0)))
        index = (centres - self.length // 2 - start).unsqueeze(1) + torch.arange(self.length)
        frames = piece[:, index.to(piece.device)]
        frames = (frames - frames.mean(dim=-1, keepdim=True)) * self.window
        power = torch.fft.rfft(frames, self.n_fft).abs().square()
        correlation = torch.fft.irfft(power, self.n_fft)[..., : self.lags]
        energy = correlation[..., :1] / self.length + 1e-6
        level = (torch.log(energy) + 6.5) / 3.5  # as the mel spectrogram's scale
        scaled = correlation[..., 1:] / self.length / energy
        return torch.cat((level, scaled), dim=-1).transpose(1, 2).unsqueeze(1)


class KarrasEncoder(Encoder):
    """Formant analysis of every spectrum, articulation analysis of every window.

    Parameters
    ----------
    config : KarrasConfig
    """

    warps = False

    def __init__(self, config: KarrasConfig) -> None:
        super().__init__()
        self.config, self.frame_rate = config, config.frame_rate
        self.reach = config.window_frames // 2
        self.correlate = Autocorrelation(config.window_seconds, config.frame_rate, config.lags)
        self.formant, wide = _halving(1, config.formant_channels, config.lags)
        features = wide * config.formant_channels[-1]
        self.articulation, left = _halving(
            features, config.articulation_channels, config.window_frames
        )
        self.output_size = left * config.articulation_channels[-1]

    def features(self, waveform: Tensor, n_spectra: int, first: int = 0) -> Tensor:
        """Autocorrelations [shape=(B, 1, F, n_spectra)]."""
        out: Tensor = self.correlate(waveform, n_spectra, first)
        return out

    def forward(self, features: Tensor, places: Tensor) -> Tensor:
        """Map (B, 1, F, L) to (B, T, D)."""
        batch, _, bins, length = features.shape
        rows = features.permute(0, 3, 1, 2).reshape(batch * length, 1, bins)
        formants = self.formant(rows).flatten(1).view(batch, length, -1)
        index = window_index(places, self.config.window_frames, length)
        windows = formants[:, index].flatten(0, 1).transpose(1, 2)  # (B T, D, W)
        out: Tensor = self.articulation(windows).flatten(1).view(batch, len(places), -1)
        return out


def _halving(before: int, channels: tuple[int, ...], length: int) -> tuple[nn.Sequential, int]:
    """Convolutions of kernel 3, of stride 2 while the length is above 1; the length left."""
    layers: list[nn.Module] = []
    for after in channels:
        stride = 2 if length > 1 else 1
        layers += [nn.Conv1d(before, after, 3, stride, 1), nn.BatchNorm1d(after), nn.ReLU()]
        before, length = after, -(-length // stride)
    return nn.Sequential(*layers), length
