"""Prosody as intensity: measured on a voice, and changed on purpose.

The index that follows human ratings of arousal best without training is the mean of level, pitch
and spectral tilt, each against the speaker's own average. `prosody_index` measures it;
`apply_contour` moves all three along a known contour, so that the contour is an exact label.

Letters: S samples, N frames at 30 per second.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, sosfilt

from deitalk.audio import FRAME_RATE, SAMPLE_RATE

Floats = NDArray[np.float64]
Audio = NDArray[np.float32]
Contour = tuple[Floats, Floats]
"""Knots: seconds, and standard deviations of liveliness."""

LEVEL_DB, PITCH_SEMITONES, TILT_DB = 5.0, 3.5, 5.0
"""One standard deviation of each measure within a lively reading."""
SMOOTHING_SECONDS = 0.2
"""Sigma of the Gaussian that smooths the index: about 0.5 s wide at half its height."""
GAIN_DB_PER_Z, SHELF_DB_PER_Z, SPEED_PER_Z = 4.5, 2.5, 0.05
"""What one standard deviation of an applied contour does to gain, treble and speed with pitch."""


def prosody_index(waveform: Audio, n_frames: int) -> Floats:
    """Level, pitch and tilt against the clip's own mean, in standard deviations [shape=(N,)].

    Frames without speech take the index of their neighbours (weighted smoothing).

    Parameters
    ----------
    waveform : ndarray [shape=(S,)]
        16 kHz, any level.
    n_frames : int
        Frames N; frame i is at i / 30 seconds.
    """
    centres = np.round(np.arange(n_frames) * SAMPLE_RATE / FRAME_RATE).astype(int)
    length = 1024
    padded = np.pad(waveform.astype(np.float64), (length // 2, length))
    frames = padded[centres[:, None] + np.arange(length)] * np.hanning(length)
    spectrum = np.abs(np.fft.rfft(frames, 2 * length)) ** 2
    level = 10 * np.log10(spectrum.mean(axis=1) + 1e-12)
    active = level > np.percentile(level, 95) - 25
    if active.sum() < 8:
        return np.zeros(n_frames)
    frequency = np.fft.rfftfreq(2 * length, 1 / SAMPLE_RATE)
    high = spectrum[:, (frequency > 1000) & (frequency < 4000)].sum(axis=1)
    low = spectrum[:, (frequency > 80) & (frequency < 1000)].sum(axis=1)
    tilt = 10 * np.log10((high + 1e-12) / (low + 1e-12))
    pitch, voiced = _pitch(spectrum)
    voiced &= active
    parts = [
        _standard(level, active, LEVEL_DB),
        _standard(tilt, active, TILT_DB),
        _standard(pitch, voiced, PITCH_SEMITONES),
    ]
    index: Floats = np.mean(parts, axis=0)
    return index


def _pitch(power: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Semitones over 100 Hz by autocorrelation, and where it can be trusted."""
    correlation = np.fft.irfft(power, axis=1)[:, :230]
    correlation = correlation / (correlation[:, :1] + 1e-12)
    lag = correlation[:, 36:].argmax(axis=1) + 36  # 70 to 444 Hz
    strength = correlation[np.arange(len(lag)), lag]
    return 12 * np.log2(SAMPLE_RATE / lag / 100), strength > 0.35


def _standard(values: Floats, known: NDArray[np.bool_], spread: float) -> Floats:
    """Smoothed deviation from the mean of the known frames; unknown frames are filled in."""
    if known.sum() < 5:
        return np.zeros(len(values))
    deviation = np.where(known, values - values[known].mean(), 0.0)
    sigma = SMOOTHING_SECONDS * FRAME_RATE
    weight = gaussian_filter1d(known.astype(float), sigma, mode="constant")
    smooth = gaussian_filter1d(deviation, sigma, mode="constant") / (weight + 0.02)
    return np.clip(smooth / spread, -2.5, 2.5)


def random_contour(seconds: float, rng: np.random.Generator) -> Contour:
    """Knots (times, z) of a contour: 0.7 to 2 s apart, mean 0, at most 3.6 apart."""
    times = np.concatenate(([0.0], np.cumsum(rng.uniform(0.7, 2.0, int(seconds / 0.7) + 2))))
    z = np.clip(rng.normal(0, 1.0, len(times)), -1.8, 1.8)
    return times, z - z[times <= seconds].mean()


def contour_at(contour: Contour, times: Floats) -> Floats:
    """Value of a contour: cosine-eased between knots."""
    knots, z = contour
    place = np.interp(times, knots, np.arange(len(knots)))
    below = np.minimum(place.astype(int), len(knots) - 2)
    ease = (1 - np.cos(np.pi * (place - below))) / 2
    eased: Floats = z[below] + ease * (z[below + 1] - z[below])
    return eased


def apply_contour(waveform: Audio, contour: Contour) -> tuple[Audio, tuple[Floats, Floats]]:
    """Make a voice livelier and duller along a contour.

    Gain, treble and speed (which carries pitch) follow the contour: one standard deviation is
    4.5 dB, 2.5 dB more above 1.5 kHz, and 5 % of speed. What would clip is scaled down as a whole.

    Parameters
    ----------
    waveform : ndarray [shape=(S,)]
        16 kHz.
    contour : Contour
        At least two knots; it holds beyond the first and the last.

    Returns
    -------
    waveform : ndarray [shape=(S',)]
        Within ±1 (0.99 where it had to be scaled).
    time_map : (ndarray, ndarray)
        Seconds in the source, and the seconds they have moved to; linear between.
    """
    grid = np.arange(0, len(waveform) / SAMPLE_RATE + 0.02, 0.01)
    z = contour_at(contour, grid)
    moved = np.concatenate(([0.0], np.cumsum(0.01 / (1 + SPEED_PER_Z * z))))[:-1]
    sections = butter(1, 1500, "highpass", fs=SAMPLE_RATE, output="sos")
    treble = sosfilt(sections, waveform)
    at = contour_at(contour, np.arange(len(waveform)) / SAMPLE_RATE)
    shaped = waveform + (10 ** (SHELF_DB_PER_Z * at / 20) - 1) * treble
    shaped = shaped * 10 ** (GAIN_DB_PER_Z * at / 20)
    out = _warp(shaped, grid, moved)
    peak = float(np.abs(out).max(initial=0))
    if peak > 1:
        out = out * (0.99 / peak)
    return out.astype(np.float32), (grid, moved)


def _warp(waveform: Floats, source: Floats, moved: Floats) -> Floats:
    """Read a waveform at warped times; four-fold oversampling keeps interpolation below -60 dB."""
    import soxr

    fine = soxr.resample(waveform, SAMPLE_RATE, 4 * SAMPLE_RATE)
    last = np.interp(len(waveform) / SAMPLE_RATE, source, moved)
    times = np.arange(int(last * SAMPLE_RATE)) / SAMPLE_RATE
    at = np.interp(times, moved, source) * 4 * SAMPLE_RATE
    warped: Floats = np.interp(at, np.arange(len(fine)), fine)
    return warped
