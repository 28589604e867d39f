"""SDFA's speech encoder at any frame rate, and the two ablations of its parts (SDFA §5.2.2).

N windows, W spectra of a window.
"""

import torch
from torch import Tensor

from deitalk.config.frontends import SDFAMelConfig
from deitalk.frontends.base import Encoder, window_index
from deitalk.frontends.mel_bilstm import MelFrontend

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
        return self.attend_in(self.frontend.recurrent(spectral)[0])

    def attend_in(self, memory: Tensor) -> tuple[Tensor, Tensor]:
        """As `attend`, of the Time-BiLSTM's states of windows (N, W, D)."""
        config = self.config
        half = config.window_frames // 2
        first = half - config.query_frames // 2
        query = memory[:, first : first + config.query_frames]
        attended, weights = self.frontend.attention.windows(memory, query)
        return self._centred(attended, memory[:, half]), weights

    def _centred(self, attended: Tensor, centre: Tensor) -> Tensor:
        normalise = self.frontend.normalise
        if normalise is None:
            return attended
        out: Tensor = normalise(attended + centre)
        return out
