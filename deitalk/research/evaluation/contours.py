"""Contours of prosody: a voice moved along one, an exact label; and what follows it how well."""

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, sosfilt
from scipy.stats import spearmanr

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, frame_centres
from deitalk.audio.prosody import (
    LEVEL_DB,
    PITCH_SEMITONES,
    SMOOTHING_SECONDS,
    TILT_DB,
    Prosody,
    level_db,
)
from rig.arrays import Bool, Float32, Float64
from rig.curves.filters import gaussian_smooth

Contour = tuple[Float64, Float64]
"""Knots: seconds, and standard deviations of prosody."""


GAIN_DB_PER_Z, SHELF_DB_PER_Z, SPEED_PER_Z = 4.5, 2.5, 0.05
"""Change of gain, treble and speed (with pitch) per standard deviation of an applied contour."""


def random_contour(seconds: float, rng: np.random.Generator) -> Contour:
    """Knots (times, z) of a contour: 0.7 to 2 s apart, mean 0, at most 3.6 apart."""
    times = np.concatenate(([0.0], np.cumsum(rng.uniform(0.7, 2.0, int(seconds / 0.7) + 2))))
    z = np.clip(rng.normal(0, 1.0, len(times)), -1.8, 1.8)
    return times, z - z[times <= seconds].mean()


def contour_at(contour: Contour, times: Float64) -> Float64:
    """Value of a contour: cosine-eased between knots."""
    knots, z = contour
    place = np.interp(times, knots, np.arange(len(knots)))
    below = np.minimum(place.astype(int), len(knots) - 2)
    ease = (1 - np.cos(np.pi * (place - below))) / 2
    eased: Float64 = z[below] + ease * (z[below + 1] - z[below])
    return eased


def apply_contour(waveform: Float32, contour: Contour) -> tuple[Float32, tuple[Float64, Float64]]:
    """Modify gain, treble and speed of a voice along a contour.

    Gain, treble and speed (which carries pitch) follow the contour: one standard deviation is
    4.5 dB, 2.5 dB more above 1.5 kHz, and 5 % of speed. A waveform that would clip is scaled down.

    Parameters
    ----------
    waveform : ndarray [shape=(S,)]
        16 kHz.
    contour : Contour
        At least two knots; constant before the first and after the last.

    Returns
    -------
    waveform : ndarray [shape=(S',)]
        Within ±1 (0.99 where it had to be scaled).
    time_map : (ndarray, ndarray)
        Seconds in the source and the corresponding seconds in the result; linear between.
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


def _warp(waveform: Float64, source: Float64, moved: Float64) -> Float64:
    """Waveform at warped times, with four-fold oversampling (interpolation error below -60 dB)."""
    import soxr

    fine = soxr.resample(waveform, SAMPLE_RATE, 4 * SAMPLE_RATE)
    last = np.interp(len(waveform) / SAMPLE_RATE, source, moved)
    times = np.arange(int(last * SAMPLE_RATE)) / SAMPLE_RATE
    at = np.interp(times, moved, source) * 4 * SAMPLE_RATE
    warped: Float64 = np.interp(at, np.arange(len(fine)), fine)
    return warped


def prosody_index(prosody: Prosody) -> Float64:
    """Level, pitch and tilt relative to the clip's mean, in standard deviations [shape=(T,)].

    Frames without speech are interpolated from their neighbours (weighted smoothing).
    """
    if prosody.active.sum() < 8:
        return np.zeros(len(prosody.level))
    parts = [
        _standard(prosody.level, prosody.active, LEVEL_DB),
        _standard(prosody.tilt, prosody.active, TILT_DB),
        _standard(prosody.pitch, prosody.voiced, PITCH_SEMITONES),
    ]
    index: Float64 = np.mean(parts, axis=0)
    return index


def _standard(values: Float64, known: Bool, spread: float) -> Float64:
    """Smoothed deviation from the mean of the known frames; the others are interpolated."""
    if known.sum() < 5:
        return np.zeros(len(values))
    deviation = np.where(known, values - values[known].mean(), 0.0)
    sigma = SMOOTHING_SECONDS * FRAME_RATE
    weight = gaussian_smooth(known.astype(float), sigma)
    smooth = gaussian_smooth(deviation, sigma) / (weight + 0.02)
    return np.clip(smooth / spread, -2.5, 2.5)


def spearman(label: Float32, predicted: Float32 | Float64, within: Bool) -> float:
    """Rank correlation over some frames; NaN if one is constant or there are under 10."""
    a, b = np.asarray(label[within], np.float64), np.asarray(predicted[within], np.float64)
    if len(a) < 10 or np.ptp(a) < 1e-6 or np.ptp(b) < 1e-6:
        return float("nan")
    return float(spearmanr(a, b).statistic)


def level_curve(waveform: Float32, n_frames: int) -> Float32:
    """Level in dB at a fixed gain, smoothed over half a second of speech [shape=(T,)].

    Pauses are left out, as in the prosody index: the strongest baseline of level alone.

    Parameters
    ----------
    waveform : ndarray [shape=(S,)]
        16 kHz.
    n_frames : int
        Frames T, 30 per second.
    """
    level = level_db(waveform, frame_centres(np.arange(n_frames)))
    speaking = level > np.percentile(level, 95) - 25
    sigma = SMOOTHING_SECONDS * FRAME_RATE
    usual = level[speaking].mean() if speaking.any() else 0.0
    total = gaussian_filter1d(np.where(speaking, level - usual, 0), sigma, mode="constant")
    weight = gaussian_filter1d(speaking.astype(float), sigma, mode="constant")
    smooth: Float32 = (usual + total / (weight + 0.02)).astype(np.float32)
    return smooth
