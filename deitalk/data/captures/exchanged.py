"""Columns of captures that seem exchanged: by what follows the voice, and by the other side.

Jaws follow the jaw that a model predicts from the sound; brows, lids and gaze do not. Left and
right of a pair move together; of two pairs with one side exchanged each moves as the other.

Letters: T frames, C controls, L lags, P pairs.
"""

from dataclasses import dataclass, field

import numpy as np

from deitalk.data.clips import Clip
from rig import ControlSet, RigCurves
from rig.arrays import Bool, Float64

JAW = "CTRL_C_jaw.ty"
RATE = 30
LAGS = range(-9, 10)
"""Frames by which curves may be late."""
SMOOTH_SECONDS = 0.3
"""Slower movement is removed: postures and expressions."""
STILL = 0.02
"""Least standard deviation of a column that is judged."""
LEAST_SECONDS = 5.0
"""Least sound of a take that is judged."""
FOLLOWS, LEAD = 0.4, 0.1
"""Correlation with the predicted jaw from which on a column above the mouth has the jaw's movement,
if it is so much more than the jaw's own. Measured jaws of four people had .72 to .93, their brows
and lids .25 at most; in our own takes brows reached .58, where the jaw had .81 and more."""
MOUTH_FOLLOWS, JAW_LOST = 0.6, 0.4
"""Correlation of another column of the mouth, and of a jaw that has not its own movement."""
CROSSED = 1.0
"""Sum of two correlations across two pairs, less that of the two within them."""


@dataclass
class _Take:
    """Sums over the clips of one take."""

    seconds: float
    follows: Float64
    """Signed squared correlations with the predicted jaw, times seconds [shape=(L, C)]."""
    products: Float64
    """Products of every two columns about their means in a clip [shape=(C, C)]."""
    frames: int


@dataclass
class Exchanged:
    """Evidence for exchanged columns, by take."""

    controls: ControlSet
    takes: dict[str, _Take] = field(default_factory=dict)

    def add(self, clip: Clip, predicted: RigCurves | None, curves: RigCurves, known: Bool) -> None:
        """Add a clip's captured curves, and what a model predicts of its sound."""
        from scipy.ndimage import gaussian_filter1d

        seconds = curves.duration if predicted is None else min(curves.duration, predicted.duration)
        at = np.arange(int(seconds * RATE)) / RATE
        values = np.stack([np.interp(at, curves.times, column) for column in curves.values.T], 1)
        values[:, ~known] = 0
        follows = np.zeros((len(LAGS), len(self.controls)))
        if predicted is not None and len(at) > 4 * LAGS[-1]:
            rows = np.column_stack(
                (values, np.interp(at + clip.offset_seconds, predicted.times, predicted[JAW]))
            )
            rows = rows - gaussian_filter1d(rows, SMOOTH_SECONDS * RATE, axis=0, mode="nearest")
            *_, jaw = rows.T
            for place, lag in enumerate(LAGS):
                late = rows[max(lag, 0) : len(rows) + min(lag, 0), :-1]
                r = _correlations(late, jaw[max(-lag, 0) : len(jaw) + min(-lag, 0)])
                follows[place] = np.sign(r) * r**2
        about = values - values.mean(axis=0)
        take = self.takes.setdefault(
            clip.take, _Take(0.0, np.zeros_like(follows), np.zeros((len(known), len(known))), 0)
        )
        take.seconds += seconds
        take.follows += seconds * follows
        take.products += about.T @ about
        take.frames += len(about)

    def found(self) -> list[str]:
        """Takes with the columns that seem exchanged, and why."""
        return [
            f"{name} ({why})"
            for name, take in self.takes.items()
            if take.seconds >= LEAST_SECONDS
            for why in (*self._by_voice(take), *self._by_side(take))
        ]

    def _by_voice(self, take: _Take) -> list[str]:
        if JAW not in self.controls:
            return []
        r = np.sqrt(np.maximum(take.follows.max(axis=0) / take.seconds, 0))
        r[_spread(take) < STILL] = 0
        own = r[self.controls.index(JAW)]
        upper = self.controls.subset("upper_face")
        others = np.setdiff1d(np.arange(len(r)), [*upper, self.controls.index(JAW)])
        best, other = upper[r[upper].argmax()], others[r[others].argmax()]
        if not (r[best] >= FOLLOWS and r[best] > own + LEAD):
            if not (r[other] >= MOUTH_FOLLOWS and own < JAW_LOST):
                return []
            best = other
        names = self.controls.names
        return [f"{names[best]} moves with the voice, r {r[best]:.2f}, {JAW} r {own:.2f}"]

    def _by_side(self, take: _Take) -> list[str]:
        mirror, spread = self.controls.mirror_index, _spread(take)
        moves = np.minimum(spread, spread[mirror]) >= STILL
        left = np.flatnonzero(moves & (np.arange(len(mirror)) < mirror))
        size = np.maximum(spread * np.sqrt(take.frames), 1e-9)
        across = (take.products / np.outer(size, size))[np.ix_(left, mirror[left])]
        within = np.diagonal(across)
        crossed = across + across.T - within - within[:, None]
        names = self.controls.names
        return [
            f"{names[left[p]]} moves as {names[mirror[left[q]]]}, {names[left[q]]} as "
            f"{names[mirror[left[p]]]}"
            for p, q in np.argwhere(np.triu(crossed > CROSSED, 1))
        ]


def _spread(take: _Take) -> Float64:
    """Standard deviations [shape=(C,)]."""
    spread: Float64 = np.sqrt(np.diagonal(take.products) / max(take.frames, 1))
    return spread


def _correlations(rows: Float64, one: Float64) -> Float64:
    """Correlation of every column of `rows` [shape=(T, C)] with a signal [shape=(T,)]."""
    rows, one = rows - rows.mean(axis=0), one - one.mean()
    size = np.sqrt((rows**2).sum(axis=0) * (one @ one))
    found: Float64 = one @ rows / np.maximum(size, 1e-9)
    return found
