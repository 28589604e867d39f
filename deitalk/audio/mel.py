"""Waveform to mel spectrogram with two derivatives (SDFA §3.1, §4.4).

Spectrum k is centred at k / frame_rate seconds, rig frame i at i / 30 seconds::

    frame_rate 120, rig 30:   spectra  0 1 2 3 4 5 6 7 8
                              rig      0       1       2
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.mel_filters import mel_filters

LOWEST_HZ, HIGHEST_HZ = 50, 7600
MEAN, SPREAD = -6.5, 3.5
"""Mean and spread of the logarithm, measured on level-normalised speech."""
FLOOR = 1e-5
"""Added to mel power before the logarithm; speech at -23 dB has cells of 1e-4 to 10."""


def spectra_centres(n_spectra: int, frame_rate: float) -> Tensor:
    """Sample at the centre of every spectrum, to the nearest sample."""
    return torch.round(
        torch.arange(n_spectra, dtype=torch.float64) * SAMPLE_RATE / frame_rate
    ).long()


def nearest_spectra(n_frames: int, frame_rate: float, stack: int = 1) -> Tensor:
    """Index of the (stacked) spectrum nearest to every rig frame [shape=(T,)]."""
    return torch.round(
        torch.arange(n_frames, dtype=torch.float64) * frame_rate / FRAME_RATE / stack
    ).long()


def derivative(x: Tensor) -> Tensor:
    """Half the difference of the neighbours along the last axis; ends repeat."""
    padded = F.pad(x, (1, 1), mode="replicate")
    return (padded[..., 2:] - padded[..., :-2]) / 2


def sine_tapers(length: int, count: int) -> Tensor:
    """Orthonormal windows [shape=(count, length)] that begin and end near zero.

    Taper k has k - 1 zero crossings; its spectrum lies within (k + 1) / (2 length) of the rate.
    """
    phase = torch.pi * torch.arange(1, length + 1, dtype=torch.float64, device="cpu") / (length + 1)
    orders = torch.arange(1, count + 1, device="cpu").unsqueeze(1)
    tapers: Tensor = (torch.sin(orders * phase) * (2 / (length + 1)) ** 0.5).float()
    return tapers


class MelSpectrogram(nn.Module):
    """Log-mel spectrogram with first and second derivative.

    Parameters
    ----------
    window_seconds : float
        Length of the Hann window.
    frame_rate : float
        Spectra per second.
    n_mels : int
    tapers : int
        Sine tapers (Riedel and Sidorenko 1995) whose spectra are averaged; 1: a Hann window. Three
        have its main lobe and a third of the variance: noise fluctuates less. Deviation: SDFA has
        one window.

    Notes
    -----
    Paper silent: scaling. The log-power is moved and divided by the fixed numbers `MEAN` and
    `SPREAD`, the same for every clip: nothing depends on how
    much silence a clip holds, and a piece of a clip gives the same spectra as the whole.
    """

    filters: Tensor
    tapers: Tensor
    """Windows of a spectrum [shape=(K, W)]; each has the energy of the Hann window."""

    def __init__(
        self, window_seconds: float, frame_rate: float, n_mels: int, tapers: int = 1
    ) -> None:
        super().__init__()
        self.frame_rate = frame_rate
        self.length = round(window_seconds * SAMPLE_RATE)
        self.n_fft = 1 << (self.length - 1).bit_length()
        filters = mel_filters(SAMPLE_RATE, self.n_fft, n_mels, LOWEST_HZ, HIGHEST_HZ)
        self.register_buffer("filters", torch.from_numpy(filters.T.copy()), persistent=False)
        # On the meta device it would import the compiler: two seconds.
        hann = torch.hann_window(self.length, device="cpu").unsqueeze(0)
        windows = hann if tapers == 1 else hann.norm() * sine_tapers(self.length, tapers)
        self.register_buffer("tapers", windows, persistent=False)

    def forward(self, waveform: Tensor, n_spectra: int, first: int = 0) -> Tensor:
        """Map (B, S) to (B, 3, F, n_spectra), beginning with spectrum `first` of the waveform.

        Outside the waveform there is silence.
        """
        mel = self.scaled(self.power(self.windows(waveform, n_spectra, first)))
        slope = derivative(mel)
        return torch.stack((mel, slope, derivative(slope)), dim=1)

    def windows(self, waveform: Tensor, n_spectra: int, first: int = 0) -> Tensor:
        """Samples (B, L, window) of the spectra; parameters as for `forward`."""
        centres = spectra_centres(first + n_spectra, self.frame_rate)[first:]
        half = self.length // 2
        start = int(centres[0]) - half
        stop = int(centres[-1]) + self.length
        piece = waveform[:, max(start, 0) : max(stop, 0)].to(self.tapers.device)
        piece = F.pad(
            piece, (max(-start, 0), max(stop - start - max(-start, 0) - piece.shape[1], 0))
        )
        index = (centres - half - start).unsqueeze(1) + torch.arange(self.length)
        return piece[:, index.to(piece.device)]

    def power(self, windows: Tensor) -> Tensor:
        """Mel power (B, L, F) of windows (B, L, window) of samples."""
        spectra = [torch.fft.rfft(windows * taper, self.n_fft) for taper in self.tapers]
        powers = [torch.view_as_real(spectrum).square().sum(dim=-1) for spectrum in spectra]
        power = powers[0] if len(powers) == 1 else torch.stack(powers).mean(dim=0)  # (B, L, bins)
        mel: Tensor = power @ self.filters / self.length
        return mel

    def scaled(self, power: Tensor) -> Tensor:
        """Logarithm (B, F, L) of mel power (B, L, F), on the network's scale."""
        return ((torch.log(power + FLOOR) - MEAN) / SPREAD).transpose(1, 2)
