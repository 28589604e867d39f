"""Response of the face to the prosody of modified recordings.

`deitalk.corpus.prosody_contours.apply_contour` changes level, treble, pitch and speed along a known
contour. Two scores: the rank correlation of predicted intensity with the contour (Spearman, within
speech), and the share of pairs in which the take of raised prosody opens and expresses more. The
baseline of the first is the level of the recording at a fixed gain, smoothed over speech as the
label is. The label is the sum of the contour and the voice's own prosody, weighted as in the
corpus. Letters: T frames.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.stats import spearmanr

from deitalk.audio.frames import FRAME_RATE, frame_centres
from deitalk.audio.load import Recording
from deitalk.audio.prosody import level_db
from deitalk.corpus.performance import NATURAL_WEIGHT
from deitalk.corpus.prosody_contours import (
    SMOOTHING_SECONDS,
    Contour,
    apply_contour,
    contour_at,
    prosody_index,
    random_contour,
)
from rig.arrays import Bool, Float32

STEP_Z = 1.2
"""Standard deviations by which the prosody of a take is raised or lowered."""
RAMP_SECONDS = 0.3


def spearman(label: Float32, predicted: Float32, within: Bool) -> float:
    """Rank correlation over some frames; NaN if one is constant or there are under 10."""
    a, b = label[within], predicted[within]
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


class Modified(NamedTuple):
    """A recording with modified prosody."""

    take: Recording
    z: Float32
    """The contour at every frame of the take [shape=(T,)]."""
    frames: NDArray[np.intp]
    """Frame of the recording for every frame of the take [shape=(T,)]."""


def modified(recording: Recording, contour: Contour) -> Modified:
    """Recording modified along a contour."""
    waveform, (source, moved) = apply_contour(recording.waveform, contour)
    take = replace(recording, waveform=waveform)
    times = np.interp(np.arange(take.n_frames) / FRAME_RATE, moved, source)
    frames = np.round(times * FRAME_RATE).astype(np.intp).clip(0, recording.n_frames - 1)
    return Modified(take, contour_at(contour, times).astype(np.float32), frames)


def constant(z: float, seconds: float) -> Contour:
    """Constant contour."""
    return np.array([0.0, max(seconds, 0.1)]), np.array([z, z])


def halves(z: float, seconds: float) -> Contour:
    """Contour of `z` in the first half and -`z` in the second."""
    middle = seconds / 2
    knots = np.array([0.0, middle - RAMP_SECONDS / 2, middle + RAMP_SECONDS / 2, seconds])
    return knots, np.array([z, z, -z, -z])


def wandering(recording: Recording, seed: int) -> tuple[Recording, Float32, Float32]:
    """Recording along a random contour, the contour and the resulting label [shape=(T,)].

    The label is the contour plus `NATURAL_WEIGHT` times the voice's own prosody, as in the corpus.
    """
    contour = random_contour(recording.duration, np.random.default_rng(seed))
    waveform, (source, moved) = apply_contour(recording.waveform, contour)
    take = replace(recording, waveform=waveform)
    times = np.interp(np.arange(take.n_frames) / FRAME_RATE, moved, source)
    applied = contour_at(contour, times)
    own = prosody_index(recording.waveform, recording.n_frames)
    natural = np.interp(times, np.arange(recording.n_frames) / FRAME_RATE, own)
    label = applied + NATURAL_WEIGHT * natural
    return take, applied.astype(np.float32), label.astype(np.float32)
