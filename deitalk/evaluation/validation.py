"""Detection scores of bilabial closures against vowels.

A closure's score is the highest value of the lips-together curve within the closure widened by
two frames; a vowel's is the same within the vowel, if it stays 67 ms away from every closure and
every f, v, w. Letters: T frames at 30 per second, N events.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.evaluation.scores import (
    area_under_curve,
    hit_rate,
)
from deitalk.postprocess.phones import (
    BILABIALS,
    CLEAR_SECONDS,
    NEAR_LIPS,
    VOWELS,
    WIDEN_FRAMES,
    Phones,
)
from rig.arrays import Float32

JAW = "CTRL_C_jaw.ty"


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
        elif name in VOWELS and within.any() and is_clear(start, end, busy):
            vowels.append(lips[within].max())
            outside |= within
    return ClosureScores(
        np.array(closures, np.float32), np.array(vowels, np.float32), lips[inside], lips[outside]
    )


def is_clear(start: float, end: float, busy: Sequence[tuple[float, float]]) -> bool:
    """Whether times are `CLEAR_SECONDS` and more away from all others."""
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
