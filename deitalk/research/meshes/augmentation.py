"""Augmentations of SDFA §4.3: of the frame's time, of the audio, of the mel spectrogram.

Letters: W spectra of the piece around a window. Mel values are those of
`deitalk.audio.mel.MelSpectrogram`, the logarithm of power; its derivatives are taken afterwards.
Every function takes a Generator; none changes its input.

Paper silent: every range and probability below, and whether zeros and the sine curve apply to the
power or to its logarithm. Here zeros are zeros of the power (silence, `SILENCE` in the
logarithm), and the curve is a gain in decibels.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy import signal
from torch import Tensor
from torch.nn import functional as F

from deitalk.audio.mel import FLOOR
from deitalk.audio.prosody import rms_db
from deitalk.research.evaluation.noise import mix_at_level, pink_noise
from rig.arrays import Float32

LEVEL_SPREAD = 3.5
"""Nepers of power per unit of `MelSpectrogram`'s scale, whose zero is at -6.5."""
SILENCE = (math.log(FLOOR) + 6.5) / LEVEL_SPREAD
"""Mel value of zero power."""
SHIFT_FRAMES = 0.5
"""Largest shift of a frame (§4.3 i)."""
PRE_EMPHASIS = (0.0, 0.95)
"""Range of the coefficient (§4.3 ii)."""
SNR_DB = (5.0, 40.0)
PADDED_SHARE = 0.12
"""Largest share of bins that are padded below or above."""
STRETCH = (0.8, 1.25)
"""Range of the factor of time; below 1 the speech is compressed."""
ZEROED_SHARE = 0.12
"""Largest share of bins set to zero."""
SINE_DB = 6.0
"""Largest amplitude of the gain over the bins."""
SINE_PERIODS = (0.25, 3.0)
PROBABILITY = 0.5
"""Probability of every augmentation of audio and mel, independently."""


def frame_shift(rng: np.random.Generator) -> float:
    """Shift in frames, within half a frame; one for both frames of a pair (§4.3 i)."""
    return float(rng.uniform(-SHIFT_FRAMES, SHIFT_FRAMES))


def augment_audio(waveform: Float32, rng: np.random.Generator) -> Float32:
    """Noise, then pre-emphasis, each with probability one half (§4.3 ii) [shape=(S,)]."""
    x = waveform
    if rng.random() < PROBABILITY:
        x = add_noise(x, rng.uniform(*SNR_DB), rng, pink=bool(rng.random() < 0.5))
    if rng.random() < PROBABILITY:
        x = pre_emphasise(x, rng.uniform(*PRE_EMPHASIS))
    return x


def add_noise(
    waveform: Float32, snr_db: float, rng: np.random.Generator, *, pink: bool = False
) -> Float32:
    """Add white noise, or pink: its power falls by 3 dB an octave.

    Parameters
    ----------
    waveform : ndarray [shape=(S,)]
        Speech.
    snr_db : float
        Power of the waveform over that of the noise. Silence gets no noise.
    rng : numpy.random.Generator
        Source of the noise.
    pink : bool
        Pink instead of white.
    """
    n = len(waveform)
    noise = pink_noise(n, rng) if pink else rng.standard_normal(n)
    return mix_at_level(waveform, noise, rms_db(waveform) - snr_db)


def pre_emphasise(waveform: Float32, coefficient: float) -> Float32:
    """y_i = x_i - coefficient x_(i-1) [shape=(S,)]; 0 changes nothing."""
    filtered: Float32 = signal.lfilter([1.0, -coefficient], [1.0], waveform).astype(np.float32)
    return filtered


@dataclass(frozen=True)
class MelWarp:
    """Mel augmentations shared by the two frames of a pair (§4.3 iii).

    Parameters
    ----------
    padded : int
        Bins of silence below the lowest (positive) or above the highest (negative).
    stretch : float
        Factor of time; 1.25 takes L / 1.25 spectra to L.
    zeroed : tuple of int
        Bins set to silence.
    sine : (float, float, float)
        Amplitude in decibels, periods over the bins, phase in radians.
    """

    padded: int = 0
    stretch: float = 1.0
    zeroed: tuple[int, ...] = ()
    sine: tuple[float, float, float] = (0.0, 1.0, 0.0)

    @classmethod
    def draw(cls, n_mels: int, rng: np.random.Generator) -> "MelWarp":
        """Choose each of the four with probability one half."""
        chosen = rng.random(4) < PROBABILITY
        most = int(PADDED_SHARE * n_mels)
        padded = int(rng.integers(1, most + 1)) if most else 0
        padded = padded if rng.random() < 0.5 else -padded
        stretch = float(np.exp(rng.uniform(*np.log(STRETCH))))
        zeroed = rng.choice(n_mels, int(rng.integers(1, int(ZEROED_SHARE * n_mels) + 2)), False)
        sine = (
            float(rng.uniform(0, SINE_DB)),
            float(rng.uniform(*SINE_PERIODS)),
            float(rng.uniform(0, 2 * np.pi)),
        )
        nothing = cls()
        return cls(
            padded if chosen[0] else nothing.padded,
            stretch if chosen[1] else nothing.stretch,
            tuple(sorted(int(b) for b in zeroed)) if chosen[2] else nothing.zeroed,
            sine if chosen[3] else nothing.sine,
        )

    def __call__(self, mel: Tensor, n_spectra: int) -> Tensor:
        """Warp a piece of spectrogram and cut the window from its middle.

        Parameters
        ----------
        mel : Tensor [shape=(F, W)]
            W at least `n_spectra`, and 1 / stretch as many where time is compressed; beyond its
            ends the last spectrum holds.
        n_spectra : int
            L. The middle, spectrum W // 2, becomes spectrum L // 2.

        Returns
        -------
        Tensor [shape=(F, L)]
        """
        mel = pad_bins(mel, self.padded)
        mel = stretch_time(mel, self.stretch, n_spectra)
        mel = scale_bins(mel, *self.sine)
        return zero_bins(mel, self.zeroed)


def pad_bins(mel: Tensor, count: int) -> Tensor:
    """Pad silence below the lowest bin (count > 0) or above the highest (< 0), then resize to F.

    Parameters
    ----------
    mel : Tensor [shape=(F, L)]
        Log-power.
    count : int
        Bins before the resizing, which is linear.
    """
    if count == 0:
        return mel
    padded = F.pad(mel, (0, 0, max(count, 0), max(-count, 0)), value=SILENCE)
    resized = F.interpolate(padded.T.unsqueeze(0), size=len(mel), mode="linear", align_corners=True)
    return resized[0].T


def stretch_time(mel: Tensor, factor: float, n_spectra: int) -> Tensor:
    """Play slower (factor > 1) or faster about the middle [shape=(F, W)] -> [shape=(F, L)]."""
    width = mel.shape[1]
    place = width // 2 + (torch.arange(n_spectra) - n_spectra // 2) / factor
    place = place.clamp(0, width - 1)
    below = place.floor().long().clamp(max=max(width - 2, 0))
    above = (below + 1).clamp(max=width - 1)
    return torch.lerp(mel[:, below], mel[:, above], (place - below).to(mel.dtype))


def zero_bins(mel: Tensor, bins: tuple[int, ...]) -> Tensor:
    """Silence some bins [shape=(F, L)]."""
    out = mel.clone()
    out[list(bins)] = SILENCE
    return out


def scale_bins(mel: Tensor, amplitude_db: float, periods: float, phase: float) -> Tensor:
    """Gain of amplitude_db sin(2 pi periods f / F + phase) decibels at bin f [shape=(F, L)]."""
    place = torch.arange(len(mel), dtype=mel.dtype) / len(mel)
    gain_db = amplitude_db * torch.sin(2 * math.pi * periods * place + phase)
    return mel + (gain_db * math.log(10) / 10 / LEVEL_SPREAD).unsqueeze(1)
