"""Modification of a voice's prosody along a known contour.

`deitalk.audio.prosody` measures level, pitch and spectral tilt; `apply_contour` moves all three
along a known contour, so that the contour is an exact label.

Letters: S samples, N frames at 30 per second.
"""

import numpy as np
from scipy.signal import butter, sosfilt

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.prosody import SMOOTHING_SECONDS, measure_prosody
from deitalk.audio.prosody import prosody_index as index_of
from rig.arrays import Float32, Float64

__all__ = ["SMOOTHING_SECONDS", "apply_contour", "contour_at", "prosody_index", "random_contour"]

Contour = tuple[Float64, Float64]
"""Knots: seconds, and standard deviations of prosody."""

GAIN_DB_PER_Z, SHELF_DB_PER_Z, SPEED_PER_Z = 4.5, 2.5, 0.05
"""Change of gain, treble and speed (with pitch) per standard deviation of an applied contour."""


def prosody_index(waveform: Float32, n_frames: int) -> Float64:
    """`deitalk.audio.prosody.prosody_index` of a recording [shape=(N,)]."""
    return index_of(measure_prosody(waveform, n_frames))


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
