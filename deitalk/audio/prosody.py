"""Prosody of a voice: level, spectral tilt, pitch and bands of every frame."""

import math
from typing import NamedTuple

import numpy as np

from deitalk.array_functions import Array, library, like, percentile
from deitalk.audio.frames import SAMPLE_RATE, frame_centres
from rig.arrays import Float32, Float64, Int64

LEVEL_DB, PITCH_SEMITONES, TILT_DB = 5.0, 3.5, 5.0
"""One standard deviation of each measure within a lively reading."""
SMOOTHING_SECONDS = 0.2
"""Sigma of the Gaussian that smooths the index: about 0.5 s wide at half its height."""
LEVEL_WINDOW = 800  # samples, 50 ms
WINDOW = 1024  # samples, 64 ms, centred on the frame's time
ACTIVE_DB = 25.0  # below the loudest speech; quieter frames are not active
VOICED = 0.35  # least autocorrelation
SHORTEST, LONGEST = 36, 230  # samples of a period: 444 to 70 Hz
PIECE = 16  # frames at once, which stay in the cache of a processor
BANDS = 26
BAND_EDGES_HZ = 700 * (
    (1 + 80 / 700) ** (1 - np.linspace(0, 1, BANDS + 1))
    * (1 + 7600 / 700) ** np.linspace(0, 1, BANDS + 1)
    - 1
)
"""Edges of bands of equal width on the mel scale, 80 to 7600 Hz."""
SONORANT = slice(3, 18)
"""Bands of the first three formants, 330 to 3300 Hz, in which syllables stand out most."""


FREQUENCIES = np.fft.rfftfreq(2 * WINDOW, 1 / SAMPLE_RATE)
_EDGES = np.searchsorted(FREQUENCIES, BAND_EDGES_HZ)
_NUMBER = np.arange(WINDOW + 1)[:, None]
SUMS = np.concatenate(
    (
        ((FREQUENCIES > 1000) & (FREQUENCIES < 4000))[:, None],
        ((FREQUENCIES > 80) & (FREQUENCIES < 1000))[:, None],
        (_NUMBER >= _EDGES[:-1]) & (_NUMBER < _EDGES[1:]),
    ),
    axis=1,
).astype(float)
"""Bins of the spectrum that are summed: bright, dark and the bands [shape=(1025, 28)]."""


class Prosody(NamedTuple):
    """Measures of frames, arrays or tensors."""

    level: Array
    """dB [shape=(..., T)]."""
    bright: Array
    """Power from 1 to 4 kHz [shape=(..., T)]."""
    dark: Array
    """Power from 80 Hz to 1 kHz [shape=(..., T)]."""
    pitch: Array
    """Semitones over 100 Hz [shape=(..., T)]."""
    periodicity: Array
    """Largest autocorrelation at the lags of a pitch, -1 to 1 [shape=(..., T)]."""
    tone: Array
    """Periodicity where there is a pitch, else 0 [shape=(..., T)].

    That of a rumble, which has none, rises towards lags that are shorter than any of a pitch.
    """
    bands: Array
    """Power in bands of equal mel width [shape=(..., T, 26)]."""

    @property
    def tilt(self) -> Array:
        """Bright over dark, dB [shape=(..., T)]."""
        return 10 * library(self.dark).log10((self.bright + 1e-12) / (self.dark + 1e-12))

    @property
    def sonority(self) -> Array:
        """Power of the bands of the formants, dB [shape=(..., T)]."""
        return 10 * library(self.bands).log10(self.bands[..., SONORANT].sum(-1) + 1e-12)

    @property
    def active(self) -> Array:
        """Frames of a whole recording that are loud enough to be speech [shape=(T,)]."""
        level = self.level
        if level.shape[0] == 0:
            return level > 0
        return level > percentile(level, 95, level == level) - ACTIVE_DB

    @property
    def voiced(self) -> Array:
        """Active and periodic frames [shape=(T,)]."""
        return self.active & (self.periodicity > VOICED)


def level_db(waveform: Float32, centres: Int64, width: int = LEVEL_WINDOW) -> Float64:
    """Mean power around some samples.

    Parameters
    ----------
    waveform : ndarray [shape=(S,)]
        Full scale is 1; silence before and after it.
    centres : ndarray of int [shape=(T,)]
        Samples, 0 to S.
    width : int
        Samples that are averaged, the first of them at ``centre - width // 2``.

    Returns
    -------
    ndarray [shape=(T,)]
        dB re full scale, -100 or more.
    """
    total = np.concatenate(([0.0], np.cumsum(np.square(waveform, dtype=np.float64))))
    first = np.clip(centres - width // 2, 0, len(waveform))
    last = np.clip(centres - width // 2 + width, 0, len(waveform))
    level: Float64 = 10 * np.log10((total[last] - total[first]) / width + 1e-10)
    return level


def rms_db(waveform: Float32) -> float:
    """RMS of a whole recording, dB re full scale; ``-inf`` for digital silence."""
    power = float(np.square(waveform, dtype=np.float64).mean())
    return 10 * math.log10(power) if power > 0 else -math.inf


def measure_prosody(waveform: Float32, n_frames: int) -> Prosody:
    """Measure level, tilt and pitch of a recording.

    Parameters
    ----------
    waveform : ndarray [shape=(S,)]
        16 kHz, any level.
    n_frames : int
        Frames T; frame i is at i / 30 seconds.
    """
    parts = [measure_windows(np.zeros((0, WINDOW)))]
    for start in range(0, n_frames, PIECE):
        centres = frame_centres(np.arange(start, min(start + PIECE, n_frames)))
        low, high = int(centres[0]) - WINDOW // 2, int(centres[-1]) + WINDOW // 2
        piece = waveform[max(low, 0) : high].astype(np.float64)
        piece = np.pad(piece, (max(-low, 0), high - low - max(-low, 0) - len(piece)))
        windows = np.lib.stride_tricks.sliding_window_view(piece, WINDOW)
        parts.append(measure_windows(windows[centres - centres[0]]))
    return Prosody(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def measure_windows(windows: Array) -> Prosody:
    """Measures of `WINDOW` samples each (T, WINDOW), arrays or tensors."""
    fft = library(windows).fft
    spectra = fft.rfft(windows * like(np.hanning(WINDOW), windows), 2 * WINDOW)
    power = spectra.real**2 + spectra.imag**2
    return prosody_of(power, fft.irfft(power)[:, :LONGEST])


def prosody_of(power: Array, correlation: Array) -> Prosody:
    """Measures of the power of spectra and of their autocorrelation.

    Parameters
    ----------
    power : array or Tensor [shape=(T, 1025)]
        Of windows of `WINDOW` samples by the Hann function and as many zeros.
    correlation : array or Tensor [shape=(T, `LONGEST`)]
        Inverse Fourier transform of the power.
    """
    xp = library(power)
    sums = power @ like(SUMS, power)
    correlation = correlation / (correlation[:, :1] + 1e-12)
    lag = correlation[:, SHORTEST:].argmax(1) + SHORTEST
    periodicity = xp.amax(correlation[:, SHORTEST:], axis=1)
    is_peak = (lag > SHORTEST) | (correlation[:, SHORTEST - 1] < periodicity)
    return Prosody(
        10 * xp.log10(power.mean(1) + 1e-12),
        sums[:, 0],
        sums[:, 1],
        12 * xp.log2(SAMPLE_RATE / 100 / lag),
        periodicity,
        periodicity * is_peak,
        sums[:, 2:],
    )
