"""Does the face follow how strongly the voice speaks? Voices made livelier, on purpose.

`deitalk.corpus.prosody.apply_contour` changes level, treble, pitch and speed along a known
contour. Two questions: does the intensity heard follow the contour (Spearman, within speech), and
does the livelier of two takes of one recording open and express more? The baseline for the first
is the level of the recording on a fixed scale, smoothed like the label. Letters: T frames.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.stats import spearmanr

from deitalk.audio import FRAME_RATE, Recording
from deitalk.corpus.prosody import (
    SMOOTHING_SECONDS,
    Contour,
    apply_contour,
    contour_at,
    random_contour,
)

Floats = NDArray[np.float32]
STEP_Z = 1.2
"""Standard deviations by which a take is made livelier, or duller."""
RAMP_SECONDS = 0.3


def spearman(label: Floats, heard: Floats, within: NDArray[np.bool_]) -> float:
    """Rank correlation over some frames; NaN if one does not move or there are under 10."""
    a, b = label[within], heard[within]
    if len(a) < 10 or np.ptp(a) < 1e-6 or np.ptp(b) < 1e-6:
        return float("nan")
    return float(spearmanr(a, b).statistic)


def level_curve(waveform: Floats, n_frames: int) -> Floats:
    """Level in dB at a fixed gain, smoothed over half a second [shape=(T,)]: the baseline.

    Parameters
    ----------
    waveform : ndarray [shape=(S,)]
        16 kHz.
    n_frames : int
        Frames T, 30 per second.
    """
    centres = np.round(np.arange(n_frames) * 16_000 / FRAME_RATE).astype(int)
    padded = np.pad(waveform.astype(np.float64), (400, 800))
    power = np.square(padded[centres[:, None] + np.arange(800)]).mean(axis=1)
    level = np.maximum(10 * np.log10(power + 1e-10), -60)
    smooth: Floats = gaussian_filter1d(level, SMOOTHING_SECONDS * FRAME_RATE).astype(np.float32)
    return smooth


def modified(recording: Recording, contour: Contour) -> tuple[Recording, Floats]:
    """A recording along a contour, and the contour's value at every frame [shape=(T,)]."""
    waveform, (source, moved) = apply_contour(recording.waveform, contour)
    take = replace(recording, waveform=waveform)
    times = np.interp(np.arange(take.n_frames) / FRAME_RATE, moved, source)
    return take, contour_at(contour, times).astype(np.float32)


def constant(z: float, seconds: float) -> Contour:
    """One liveliness throughout."""
    return np.array([0.0, max(seconds, 0.1)]), np.array([z, z])


def halves(z: float, seconds: float) -> Contour:
    """`z` in the first half and -`z` in the second."""
    middle = seconds / 2
    knots = np.array([0.0, middle - RAMP_SECONDS / 2, middle + RAMP_SECONDS / 2, seconds])
    return knots, np.array([z, z, -z, -z])


def wandering(recording: Recording, seed: int) -> tuple[Recording, Floats]:
    """A recording along a random contour, as the corpus draws them."""
    contour = random_contour(recording.duration, np.random.default_rng(seed))
    return modified(recording, contour)
