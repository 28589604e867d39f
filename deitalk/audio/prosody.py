"""Prosody of a voice: level, spectral tilt, pitch and bands of every frame."""

import math
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE, frame_centres
from rig.arrays import Bool, Float32, Float64, Int64

LEVEL_DB, PITCH_SEMITONES, TILT_DB = 5.0, 3.5, 5.0
"""One standard deviation of each measure within a lively reading."""
SMOOTHING_SECONDS = 0.2
"""Sigma of the Gaussian that smooths the index: about 0.5 s wide at half its height."""
LEVEL_WINDOW = 800  # samples, 50 ms
WINDOW = 1024  # samples, 64 ms, centred on the frame's time
ACTIVE_DB = 25.0  # below the loudest speech; quieter frames are not active
VOICED = 0.35  # least autocorrelation
SHORTEST, LONGEST = 36, 230  # samples of a period: 444 to 70 Hz
PIECE = 512  # frames at once, so that an hour fits
BANDS = 26
BAND_EDGES_HZ = 700 * (
    (1 + 80 / 700) ** (1 - np.linspace(0, 1, BANDS + 1))
    * (1 + 7600 / 700) ** np.linspace(0, 1, BANDS + 1)
    - 1
)
"""Of equal width on the mel scale, 80 to 7600 Hz."""
SONORANT = slice(3, 18)
"""Bands of the first three formants, 330 to 3300 Hz, in which syllables stand out most."""


class Prosody(NamedTuple):
    """Measures of every frame."""

    level: Float64
    """dB [shape=(T,)]."""
    bright: Float64
    """Power from 1 to 4 kHz [shape=(T,)]."""
    dark: Float64
    """Power from 80 Hz to 1 kHz [shape=(T,)]."""
    pitch: Float64
    """Semitones over 100 Hz [shape=(T,)]."""
    active: Bool
    """Loud enough to be speech [shape=(T,)]."""
    voiced: Bool
    """Active and periodic [shape=(T,)]."""
    periodicity: Float64
    """Largest autocorrelation at the lags of a pitch, -1 to 1 [shape=(T,)]."""
    bands: Float64
    """Power in bands of equal mel width [shape=(T, 26)]."""

    @property
    def tilt(self) -> Float64:
        """Bright over dark, dB [shape=(T,)]."""
        tilt: Float64 = 10 * np.log10((self.bright + 1e-12) / (self.dark + 1e-12))
        return tilt

    @property
    def sonority(self) -> Float64:
        """Power of the bands of the formants, dB [shape=(T,)]."""
        return sonority_db(self.bands.T)


def sonority_db(bands: Float64) -> Float64:
    """Power of the bands of the formants, dB [shape=(T,)], of all bands (26, T)."""
    sonority: Float64 = 10 * np.log10(bands[SONORANT].sum(axis=0) + 1e-12)
    return sonority


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
    columns = [
        _measure(waveform, np.arange(first, min(first + PIECE, n_frames)))
        for first in range(0, n_frames, PIECE)
    ]
    measured = np.concatenate(columns, axis=1) if columns else np.zeros((5 + BANDS, 0))
    level, bright, dark, pitch, periodicity = measured[:5]
    active = level > np.percentile(level, 95) - ACTIVE_DB if n_frames else np.zeros(0, bool)
    voiced = active & (periodicity > VOICED)
    return Prosody(level, bright, dark, pitch, active, voiced, periodicity, measured[5:].T)


def _measure(waveform: Float32, frames: Int64) -> Float64:
    """Level, bright and dark power, pitch, periodicity and power of the bands [shape=(31, T)]."""
    centres = frame_centres(frames)
    low, high = int(centres[0]) - WINDOW // 2, int(centres[-1]) + WINDOW // 2
    piece = waveform[max(low, 0) : high].astype(np.float64)
    piece = np.pad(piece, (max(-low, 0), high - low - max(-low, 0) - len(piece)))
    windows = np.lib.stride_tricks.sliding_window_view(piece, WINDOW)
    return measure_windows(windows[centres - centres[0]])


def tonality(pitch: Float64, periodicity: Float64) -> Float64:
    """Periodicity of `Prosody` where it has a pitch, else 0.

    That of a rumble, which has none, is largest at the shortest lag.
    """
    highest = 12 * math.log2(SAMPLE_RATE / SHORTEST / 100)
    return np.where(pitch < highest - 1e-6, periodicity, 0.0)


def measure_windows(windows: Float64) -> Float64:
    """Measures of `WINDOW` samples each (T, WINDOW).

    Returns
    -------
    ndarray [shape=(31, T)]
        Level, bright and dark power, pitch, periodicity and power of the bands, as in `Prosody`.
    """
    rows = windows * np.hanning(WINDOW)
    spectra = np.fft.rfft(rows, 2 * WINDOW)
    power = np.square(spectra.real) + np.square(spectra.imag)
    frequency = np.fft.rfftfreq(2 * WINDOW, 1 / SAMPLE_RATE)
    above = power[:, (frequency > 1000) & (frequency < 4000)].sum(axis=1)
    below = power[:, (frequency > 80) & (frequency < 1000)].sum(axis=1)
    edges = np.searchsorted(frequency, BAND_EDGES_HZ)
    bands = np.add.reduceat(power, edges, axis=1)[:, :-1]
    correlation = np.fft.irfft(power, axis=1)[:, :LONGEST]
    correlation = correlation / (correlation[:, :1] + 1e-12)
    lag = correlation[:, SHORTEST:].argmax(axis=1) + SHORTEST
    return np.stack(
        [
            10 * np.log10(power.mean(axis=1) + 1e-12),
            above,
            below,
            12 * np.log2(SAMPLE_RATE / lag / 100),
            correlation[np.arange(len(lag)), lag],
            *bands.T,
        ]
    )
