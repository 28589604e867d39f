"""Base classes of the speech encoders: at 30 Hz for curves, at any moments for meshes.

An encoder of a mesh model has two halves. `features` turns sound into spectra, evenly spaced, which
augmentation may change; calling it turns spectra into a row for each given place. What depends on
one spectrum alone is computed once a spectrum, not once in every window that holds it.

C channels of a spectrum, T places, W spectra of a window.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.frames import SAMPLE_RATE
from rig.arrays import Float32


class Frontend(nn.Module):
    """Base of the speech encoders of one row per frame at 30 Hz; defaults are those of most.

    Attributes
    ----------
    output_size : int
        D.
    is_causal : bool
        Whether rows depend on a bounded look-ahead only.
    layers : tuple of int
        Layers whose standardised states are mixed; none: the output is taken.
    """

    output_size: int
    is_causal = False
    layers: tuple[int, ...] = ()

    def encode(
        self,
        waveform: Tensor,
        n_frames: int,
        *,
        progress: Callable[[float], None] = lambda share: None,
        gain: float = 1.0,
    ) -> Tensor:
        """Map a whole clip (S,) times `gain` to (n_frames, D) in bounded memory, no gradient.

        Row i is time i / 30 s. `progress` is called with the share done, 0 to 1.
        """
        raise NotImplementedError

    def measure(self, sounds: Sequence[Float32]) -> None:
        """Take what standardises the states of `layers` from recordings at the normal level."""
        raise NotImplementedError

    def encode_together(self, waveforms: Sequence[Tensor], counts: Sequence[int]) -> list[Tensor]:
        """Map clips (S,) to rows (T, D) of each, as `encode` of each, to rounding.

        `counts` are the rows T of each. Here one after the other; frontends that read several in
        one pass do so on any device.
        """
        return [self.encode(*given) for given in zip(waveforms, counts, strict=True)]

    def described(self, config: Any) -> Any:
        """Configuration that builds this frontend where its checkpoint is no longer there."""
        return config

    def is_fixed(self, name: str) -> bool:
        """Whether a weight is that of a published encoder, which does not learn."""
        return False


class Encoder(ABC, nn.Module):
    """Base of the encoders of mesh models.

    Attributes
    ----------
    output_size : int
        D.
    frame_rate : float
        Spectra per second; spectrum k is centred at k / frame_rate seconds.
    reach : int
        Spectra on either side of a place on which its row depends.
    context_seconds : float
        Context of a recurrence before the first and after the last place; 0 without one.
    warps : bool
        Whether `MelWarp` may change the features: they are a mel spectrogram.
    """

    output_size: int
    frame_rate: float
    reach: int
    context_seconds: float = 0.0
    warps: bool = True

    @abstractmethod
    def features(self, waveform: Tensor, n_spectra: int, first: int = 0) -> Tensor:
        """Map (B, S) at 16 kHz to (B, C, F, n_spectra) from spectrum `first`, silence outside."""

    @abstractmethod
    def forward(self, features: Tensor, places: Tensor) -> Tensor:
        """Map (B, C, F, L) to rows (B, T, D) for the spectra `places` [shape=(T,)]."""

    def features_between(self, waveform: Tensor, first: int, last: int) -> Tensor:
        """Features (B, C, F, last - first) of spectra first..last - 1; `first` may be negative."""
        hop = Fraction(SAMPLE_RATE) / Fraction(self.frame_rate).limit_denominator(1000)
        # Whole samples of silence before it, and two spectra for the derivatives.
        before = max(2 - first, 0)
        before += -before % hop.denominator
        padded = F.pad(waveform, (round(before * hop), 0))
        spectra = self.features(padded, last - first + 4, first + before - 2)
        return spectra[..., 2:-2]


def window_index(places: Tensor, window: int, length: int) -> Tensor:
    """Spectra [shape=(T, W)] of the windows about places, their centre at W // 2; ends repeat."""
    around = torch.arange(window, device=places.device) - window // 2
    return (places.unsqueeze(1) + around).clamp(0, length - 1)


def nearest_places(n_frames: int, fps: float, frame_rate: float, start: int = 0) -> Tensor:
    """Spectrum nearest to each of frames start..n_frames - 1, at most half a hop away."""
    times = torch.arange(start, n_frames, dtype=torch.float64) / fps
    return torch.round(times * frame_rate).long()
