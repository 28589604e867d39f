"""Lip measures from frozen speech features: a linear regression taught by measured lips.

What it learns of people's lips carries over to speech whose faces nobody measured: the curves of
such speech can be corrected by it (`deitalk.data.lips.transfer`).

Letters: T frames at 30 per second, D features, K features in context, M measures.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deitalk.errors import DataError
from rig.arrays import Float32, Float64

CONTEXT_FRAMES = (-4, -2, -1, 0, 1, 2, 4)
RIDGE = 10_000.0
"""Penalty on squared weights of standardised features; fewer speakers want more."""
SPEAKER_CLIPS = 40
"""A speaker with more recordings counts as so many."""


@dataclass(frozen=True)
class LipRidge:
    """Standardisation and weights.

    Attributes
    ----------
    mean, scale : ndarray [shape=(K,)]
    weights : ndarray [shape=(K, M)]
    constant : ndarray [shape=(M,)]
    """

    mean: Float64
    scale: Float64
    weights: Float64
    constant: Float64

    @classmethod
    def fit(
        cls, recordings: Sequence[tuple[str, Float32, Float32]], *, ridge: float = RIDGE
    ) -> "LipRidge":
        """Fit to recordings of several speakers, who count alike.

        Parameters
        ----------
        recordings : sequence of (str, ndarray [shape=(T, D)], ndarray [shape=(T, M)])
            Speaker, features and measures; frames whose measures are NaN are left out.
        ridge : float
            Penalty on the squared weights.

        Raises
        ------
        DataError
            If all measures are missing.
        """
        clips: dict[str, int] = {}
        for who, _, _ in recordings:
            clips[who] = clips.get(who, 0) + 1
        rows = [in_context(f)[np.isfinite(m).all(axis=1)] for _, f, m in recordings]
        wanted = [m[np.isfinite(m).all(axis=1)].astype(np.float64) for _, _, m in recordings]
        shares = [min(1.0, SPEAKER_CLIPS / clips[who]) for who, _, _ in recordings]
        n = sum(len(row) for row in rows)
        if not n:
            raise DataError("no frame of the training speakers has all lip measures")
        mean = sum(row.sum(axis=0, dtype=np.float64) for row in rows) / n
        square = sum(((row - mean) ** 2).sum(axis=0) for row in rows)
        scale = np.sqrt(square / n) + 1e-5
        weight = sum(share * len(row) for share, row in zip(shares, rows, strict=True))
        constant = (
            sum(share * y.sum(axis=0) for share, y in zip(shares, wanted, strict=True)) / weight
        )
        # One product of many rows: an update of the matrix for every recording takes ten times as
        # long.
        roots = np.concatenate([np.full(len(r), s**0.5) for s, r in zip(shares, rows, strict=True)])
        every = ((np.concatenate(rows) - mean) / scale * roots[:, None]).astype(np.float32)
        errors = (np.concatenate(wanted) - constant) * roots[:, None]
        gram = (every.T @ every).astype(np.float64) + ridge * np.eye(len(mean))
        cross = every.T.astype(np.float64) @ errors
        weights = np.asarray(np.linalg.solve(gram, cross), np.float64)
        return cls(mean, scale, weights, constant)

    def __call__(self, features: Float32) -> Float32:
        """Measures (T, M) of features (T, D)."""
        z = (in_context(features) - self.mean) / self.scale
        return np.asarray(z @ self.weights + self.constant, np.float32)


def in_context(features: Float32) -> Float32:
    """Features of `CONTEXT_FRAMES` around every frame [shape=(T, K)]; held beyond the ends."""
    places = np.arange(len(features))
    rows = [features[np.clip(places + k, 0, len(features) - 1)] for k in CONTEXT_FRAMES]
    return np.concatenate(rows, axis=1)
