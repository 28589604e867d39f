"""Detection scores of bilabial closures against vowels.

A closure's score is the highest value of the lips-together curve within the closure widened by
two frames; a vowel's is the same within the vowel, if it stays 67 ms away from every closure and
every f, v, w. Letters: T frames at 30 per second, N events.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.data.offset import area_under_curve, correlation, hit_rate
from deitalk.errors import DataError
from deitalk.phones import (
    BILABIALS,
    CLEAR_SECONDS,
    NEAR_LIPS,
    SILENCE,
    VOWELS,
    WIDEN_FRAMES,
    Phones,
)
from rig import ControlSet, read_curves
from rig.arrays import Float32

MAX_LAG_FRAMES = 4


class ClosureScores(NamedTuple):
    """Highest lips-together values of events, and frames inside and outside closures."""

    closures: Float32
    """[shape=(N,)]."""
    vowels: Float32
    inside: Float32
    """Values of the frames within closures."""
    outside: Float32
    """Values of the frames within clear vowels."""


class Closures(NamedTuple):
    """Detection scores of closures."""

    hit_rate: float
    """Hit rate at 5 % false alarms over vowels."""
    window_auc: float
    frame_auc: float
    reached: float
    """Share of found closures with a curve of at least 0.9 for two frames."""
    n_closures: int
    n_vowels: int


def closure_scores(lips: Float32, phones: Phones) -> ClosureScores:
    """Score one clip.

    Parameters
    ----------
    lips : ndarray [shape=(T,)]
        Mean of the lips-together controls at 30 frames per second.
    phones : sequence of (start, end, name)
        Seconds.
    """
    times = np.arange(len(lips)) / FRAME_RATE
    busy = [(start, end) for start, end, name in phones if name in NEAR_LIPS]
    closures, vowels = [], []
    inside, outside = np.zeros(len(lips), bool), np.zeros(len(lips), bool)
    for start, end, name in phones:
        within = (times >= start) & (times < end)
        if name in BILABIALS:
            slack = WIDEN_FRAMES / FRAME_RATE
            window = (times >= start - slack - 1e-9) & (times <= end + slack + 1e-9)
            if window.any():
                closures.append(lips[window].max())
            inside |= within
        elif name in VOWELS and within.any() and _clear(start, end, busy):
            vowels.append(lips[within].max())
            outside |= within
    return ClosureScores(
        np.array(closures, np.float32), np.array(vowels, np.float32), lips[inside], lips[outside]
    )


def _clear(start: float, end: float, busy: Sequence[tuple[float, float]]) -> bool:
    return all(end + CLEAR_SECONDS <= b or start - CLEAR_SECONDS >= e for b, e in busy)


def summarise_closures(scores: Sequence[ClosureScores], held: Sequence[bool] = ()) -> Closures:
    """Scores of several clips; `held` is true for closures of at least 0.9 for two frames."""
    closures, vowels, inside, outside = (
        np.concatenate([score[i] for score in scores]) if scores else np.zeros(0, np.float32)
        for i in range(4)
    )
    found = closures > (np.quantile(vowels, 0.95) if len(vowels) else np.inf)
    kept = np.asarray(held, bool)
    reached = float(kept[found].mean()) if len(kept) and found.any() else float("nan")
    return Closures(
        hit_rate(closures, vowels),
        area_under_curve(closures, vowels),
        area_under_curve(inside, outside),
        reached,
        len(closures),
        len(vowels),
    )


def held_closures(lips: Float32, phones: Phones, level: float = 0.9) -> list[bool]:
    """For every bilabial, whether the curve is at least `level` for two frames of its window."""
    times = np.arange(len(lips)) / FRAME_RATE
    out = []
    slack = WIDEN_FRAMES / FRAME_RATE + 1e-9
    for start, end, name in phones:
        window = (times >= start - slack) & (times <= end + slack)
        if name in BILABIALS and window.any():
            high = lips[window] >= level
            out.append(bool((high[1:] & high[:-1]).any()))
    return out


def best_lag(target: Float32, predicted: Float32) -> int:
    """Lag of the prediction in frames: the shift of highest correlation within ±4."""
    lags = range(-MAX_LAG_FRAMES, MAX_LAG_FRAMES + 1)
    edge = MAX_LAG_FRAMES
    if len(target) <= 3 * edge:
        return 0
    middle = target[edge:-edge]
    scores = [
        correlation(middle, predicted[edge + lag : len(predicted) - edge + lag]) for lag in lags
    ]
    return list(lags)[int(np.nanargmax(scores))] if np.isfinite(scores).any() else 0


# Opening of the mouth from curves, in speech and in silence.


JAW = "CTRL_C_jaw.ty"
OPENING = (JAW, "CTRL_L_mouth_upperLipRaise.ty", "CTRL_R_mouth_upperLipRaise.ty",
           "CTRL_L_mouth_lowerLipDepress.ty", "CTRL_R_mouth_lowerLipDepress.ty")  # fmt: skip
"""Controls whose mean is the mouth's opening."""
LONG_SECONDS = 0.6
"""Least length of a pause in which the mouth should close."""


def mouth_opening(curves: Float32, controls: ControlSet) -> Float32:
    """Mean of jaw, upper-lip and lower-lip opening [shape=(T,)]."""
    mean: Float32 = curves[:, [controls.index(name) for name in OPENING]].mean(axis=1)
    return mean


def opening_in_silence(opening: Float32, phones: Phones) -> float:
    """Mean opening in long pauses over its 95th percentile in speech.

    Pauses are those of the phones' times, not of the detector that closes the mouth in them. Their
    first 0.25 s and last 0.15 s, in which people relax and prepare, do not count.

    Parameters
    ----------
    opening : ndarray [shape=(T,)]
        At 30 frames per second.
    phones : sequence of (start, end, name)
        Seconds.

    Returns
    -------
    float
        NaN without a pause of `LONG_SECONDS`, or without speech.
    """
    times = np.arange(len(opening)) / FRAME_RATE
    silent, speaking = np.zeros(len(opening), bool), np.zeros(len(opening), bool)
    for start, end, name in phones:
        if name != SILENCE:
            speaking |= (times >= start) & (times < end)
        elif end - start > LONG_SECONDS:
            silent |= (times > start + 0.25) & (times < end - 0.15)
    if not silent.any() or not speaking.any():
        return float("nan")
    return float(opening[silent].mean() / (np.percentile(opening[speaking], 95) + 1e-9))


# Steps and jerk of curves, for comparison with captured curves.
#
# Letters: T frames, C controls.


MOVING = 0.02
"""Least standard deviation of a moving control."""


def smoothness(curves: Float32, fps: float = 30.0) -> dict[str, float]:
    """Steps and jerk of the controls that move.

    Parameters
    ----------
    curves : ndarray [shape=(T, C)]
        Values.
    fps : float
        Frames per second.

    Returns
    -------
    dict
        ``largest_step`` (control units per frame), ``step_p99`` (99th percentile of steps), and
        ``jerk_per_speed``: RMS of the third derivative over RMS of the first, 1/s², median of
        the controls; independent of their range.
    """
    moving = curves[:, curves.std(axis=0) > MOVING].astype(np.float64)
    if len(moving) < 4 or not moving.shape[1]:
        return {}
    steps = np.diff(moving, axis=0)
    speed = np.sqrt(np.square(steps).mean(axis=0)) * fps
    jerk = np.sqrt(np.square(np.diff(moving, 3, axis=0)).mean(axis=0)) * fps**3
    return {
        "largest_step": float(np.abs(steps).max()),
        "step_p99": float(np.percentile(np.abs(steps), 99)),
        "jerk_per_speed": float(np.median(jerk / speed)),
    }


def captured_smoothness(path: Path, controls: ControlSet) -> dict[str, float]:
    """`smoothness` of captured curves at 30 frames per second, over controls of the rig.

    Raises
    ------
    DataError
        If no control moves.
    """
    curves = read_curves(path).resample(30.0)
    places = [i for i, name in enumerate(curves.names) if name in controls.names]
    measured = smoothness(curves.values[:, places]) if places else {}
    if not measured:
        raise DataError(f"{path}: no control of {controls.id} moves; give a take of speech")
    return measured
