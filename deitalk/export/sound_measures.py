"""Spectra of the windows of frames by operators of a graph; what follows is the rules' own.

`deitalk.audio.voice_activity` and `deitalk.audio.prosody` take them by a Fourier transform, which
few runtimes of ONNX have. Letters: S samples, T frames, W samples of a window.
"""

import math
from typing import cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.prosody import LONGEST, WINDOW, Prosody, prosody_of
from deitalk.audio.voice_activity import BINS, HANN, levels_of_power
from deitalk.models.onnx.spectra import SpectralPower
from deitalk.postprocess.torch_columns import constant

FFT = 2 * WINDOW
"""Points of the Fourier transform of prosody."""


def frame_windows(sound: Tensor, n_frames: Tensor | int, *, nearest: bool) -> Tensor:
    """`WINDOW` samples around the time of each frame (T, W), zeros outside of the sound.

    `nearest` rounds the time to the next sample, else to the one before.
    """
    half = WINDOW // 2
    padded = F.pad(sound, (half, half + SAMPLE_RATE // 10))
    frames = torch.arange(cast(int, n_frames)) * SAMPLE_RATE
    starts = (frames + (FRAME_RATE // 2 if nearest else 0)) // FRAME_RATE
    return padded[starts[:, None] + torch.arange(WINDOW)]


class BandLevels(nn.Module):
    """`deitalk.audio.voice_activity.window_levels`."""

    window: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.power = SpectralPower(WINDOW, WINDOW, len(BINS))
        constant(self, "window", HANN)

    def forward(self, windows: Tensor) -> Tensor:
        """Levels (T, K) in dB of windows (T, W)."""
        levels: Tensor = levels_of_power(self.power(windows * self.window))
        return levels


class WindowProsody(nn.Module):
    """`deitalk.audio.prosody.measure_windows`."""

    window: Tensor
    weight: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.power = SpectralPower(WINDOW, FFT, WINDOW + 1)
        constant(self, "window", np.hanning(WINDOW))
        weight = np.full((WINDOW + 1, 1), 2.0)
        weight[[0, -1]] = 1
        constant(self, "weight", weight / FFT)

    def forward(self, windows: Tensor) -> Prosody:
        """Measures of windows (T, W)."""
        power = self.power(windows * self.window)[:, : WINDOW + 1]
        # Inverse transform, of whole numbers of turns: not a table, which the file would hold.
        turns = torch.arange(power.shape[1])[:, None] * torch.arange(LONGEST) % FFT
        cosines = torch.cos(turns.float() * (2 * math.pi / FFT)) * self.weight
        return prosody_of(power, power @ cosines)
