"""Syllables that stand out, measured by other means than those that move the brows.

A syllable's prominence is the sum of the energy, the pitch and the length of its nucleus, each in
standard deviations of its recording: `deitalk.postprocess.life.voice` uses the level, a pitch and a
sonority of its own, at 30 frames a second.

Letters: S samples at 16 kHz, N syllables, K events.
"""

from typing import NamedTuple

import numpy as np
from scipy.signal import butter, find_peaks, sosfiltfilt

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.evaluation.scores import correlation
from rig.arrays import Float32, Float64

HOP, WINDOW = 160, 640
"""Samples from value to value, and of a pitch."""
RATE = SAMPLE_RATE // HOP
BAND_HZ = (300, 3000)
NUCLEUS_DB, FAINTEST_DB, EDGE_DB = 3.0, 30.0, 4.0
"""Least rise of a nucleus, its level below the loudest at most, and the fall that ends it."""
LAGS = slice(40, 229)
"""Samples of a period: 400 to 70 Hz."""
PERIODIC, MOST_PITCH = 0.45, 2.5
"""Least share of the power in a voiced window; limit of the standard deviations of pitch."""
NEAR_SECONDS = 0.2
"""From an event to the syllable that it is on."""


class Syllables(NamedTuple):
    """Nuclei of syllables [shape=(N,) each]."""

    times: Float64
    """Seconds."""
    prominence: Float64
    """Energy, pitch and length together."""

    def r(self, events: Float64) -> float:
        """Correlation of the prominence with there being an event (K,), seconds, at a syllable."""
        there = np.zeros(len(self.times))
        for time in events:
            nearest = np.abs(self.times - time).argmin()
            there[nearest] = abs(self.times[nearest] - time) < NEAR_SECONDS
        return float(correlation(there, self.prominence))


def find_syllables(waveform: Float32) -> Syllables:
    """Syllables of a recording [shape=(S,)]."""
    sos = butter(4, BAND_HZ, "band", fs=SAMPLE_RATE, output="sos")
    count = len(waveform) // HOP
    band = sosfiltfilt(sos, waveform.astype(float))[: count * HOP].reshape(count, HOP)
    kernel = np.hanning(11)
    energy = np.sqrt((band**2).mean(axis=1) + 1e-9)
    level = 20 * np.log10(np.convolve(energy, kernel / kernel.sum(), "same") + 1e-6)
    nuclei, _ = find_peaks(level, prominence=NUCLEUS_DB, distance=9)
    nuclei = nuclei[level[nuclei] > level.max() - FAINTEST_DB]
    lengths = []
    for nucleus in nuclei:
        quiet = np.flatnonzero(level < level[nucleus] - EDGE_DB)
        before, after = quiet[quiet < nucleus], quiet[quiet > nucleus]
        lengths.append((*after, count)[0] - (0, *before)[-1])
    pitch = _pitches(waveform, count)
    near = [pitch[max(n - 5, 0) : n + 6] for n in nuclei]
    tones = np.array([np.median(part[part > 0]) if (part > 0).any() else np.nan for part in near])
    tones = np.log2(np.where(np.isnan(tones), np.nanmedian(tones), tones))
    tall = _standard(level[nuclei]) + _standard(np.log(lengths))
    high = np.clip(_standard(tones), -MOST_PITCH, MOST_PITCH)
    return Syllables(nuclei / RATE, tall + high)


def _standard(values: Float64) -> Float64:
    standard: Float64 = (values - np.mean(values)) / (np.std(values) + 1e-6)
    return standard


def _pitches(waveform: Float32, count: int) -> Float64:
    """Hz by autocorrelation, of `count` windows; 0 where there is none."""
    padded = np.pad(waveform.astype(float), (WINDOW // 2, WINDOW))
    windows = np.lib.stride_tricks.sliding_window_view(padded, WINDOW)[::HOP][:count]
    windows = windows - windows.mean(axis=1, keepdims=True)
    correlations = np.fft.irfft(np.abs(np.fft.rfft(windows, 2048)) ** 2)
    lags = correlations[:, LAGS]
    best = lags.argmax(axis=1)
    clear = lags[np.arange(count), best] > PERIODIC * (correlations[:, 0] + 1e-9)
    loud = np.abs(windows).max(axis=1) > 0.01
    return np.where(clear & loud, SAMPLE_RATE / (best + LAGS.start), 0)
