"""Transfer of measured lips to other speech: corrected curves of an acted corpus.

The faces of a corpus follow tables (`deitalk.research.corpus`). Its lips are moved towards the
prediction of a regression on measured lips (below) for the same speech, and
towards the amplitude of measured lips; contacts, emotional poses and all that is not lips stay.

Letters: T frames at 30 per second, C controls, D features, M measures.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deitalk.errors import DataError
from deitalk.research.lips.fit import fit_curves
from deitalk.research.lips.head_lips import MEASURES, HeadLips
from rig import ControlSet
from rig.arrays import Bool, Float32, Float64

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


MIX = 0.7
"""Share of the regression; the rest is the model's own lips at the measured amplitude."""
LARGEST_GAIN = 2.0
"""Largest factor for the amplitude that a mean of predictions lacks."""
CONTACT = "lipsTogether"
"""Controls that close the lips, by a part of their names."""
EDGE_FRAMES = 9
"""The correction fades in and out over so many frames at the edges of speech."""


@dataclass(frozen=True)
class LipTransfer:
    """Correction of lips by what was measured.

    Attributes
    ----------
    ridge : LipRidge
        From features to measures.
    gain, offset : ndarray [shape=(M,)]
        What brings the model's lips to the spread and mean of measured ones.
    spread, mean : ndarray [shape=(M,)]
        What brings the mix of both to the spread of measured lips about their mean.
    """

    ridge: LipRidge
    gain: Float32
    offset: Float32
    spread: Float32
    mean: Float32

    @classmethod
    def fit(cls, recordings: Sequence[tuple[str, Float32, Float32, Float32]]) -> "LipTransfer":
        """Fit to measured recordings.

        Parameters
        ----------
        recordings : sequence of (str, (T, D), (T, M), (T, M))
            Speaker, features, the model's own lips, measured lips (NaN where missing), both
            displacements from rest in cm.
        """
        triples = [(who, f, measured) for who, f, _, measured in recordings]
        ridge = LipRidge.fit(triples)
        known = [np.isfinite(m).all(axis=1) for _, _, _, m in recordings]
        own = np.concatenate([o[k] for (_, _, o, _), k in zip(recordings, known, strict=True)])
        real = np.concatenate([m[k] for (_, _, _, m), k in zip(recordings, known, strict=True)])
        gain = real.std(axis=0) / np.maximum(own.std(axis=0), 1e-6)
        offset = real.mean(axis=0) - gain * own.mean(axis=0)
        # The amplitude of a regression on a speaker that it was not fitted to.
        mixed = []
        for left_out in sorted({who for who, _, _, _ in recordings}):
            others = [row for row in triples if row[0] != left_out] or triples
            without = LipRidge.fit(others)
            for (who, f, o, _), k in zip(recordings, known, strict=True):
                if who == left_out:
                    mixed.append((MIX * without(f) + (1 - MIX) * (gain * o + offset))[k])
        every = np.concatenate(mixed)
        spread = np.clip(real.std(axis=0) / np.maximum(every.std(axis=0), 1e-6), 1, LARGEST_GAIN)
        return cls(ridge, gain, offset, spread, real.mean(axis=0))

    def change(self, features: Float32, own: Float32) -> Float32:
        """What to add to the lips of neutral speech [shape=(T, M)], cm.

        Parameters
        ----------
        features : ndarray [shape=(T, D)]
            Speech features.
        own : ndarray [shape=(T, M)]
            Displacements that the model predicts in the neutral emotion.
        """
        amplified = self.gain * own + self.offset
        mixed = MIX * self.ridge(features) + (1 - MIX) * amplified
        wanted = self.mean + self.spread * (mixed - self.mean)
        return np.asarray(wanted - own, np.float32)

    def correct(
        self,
        reading: tuple[Tensor, Tensor],
        lips: HeadLips,
        controls: ControlSet,
        curves: Float32,
        speaking: Bool,
    ) -> Float32:
        """Curves whose lips are corrected.

        Parameters
        ----------
        reading : (Tensor [shape=(T, D)], Tensor [shape=(T, C)])
            Features and neutral curves of the recording (`neutral_reading`).
        lips : HeadLips
            The head.
        controls : ControlSet
            Columns of the curves.
        curves : ndarray [shape=(T, C)]
            Of any emotion.
        speaking : ndarray [shape=(T,)]
            Frames with speech.

        Returns
        -------
        ndarray [shape=(T, C)]
        """
        features, neutral = reading
        own, start = lips.displacements(neutral).numpy(), torch.tensor(curves)
        given = lips.displacements(start).numpy()
        places = [i for i, name in enumerate(controls.names) if CONTACT in name]
        shut = np.clip(np.asarray(curves[:, places].mean(axis=1)), 0, 1)[:, None]
        fade = np.convolve(speaking, np.ones(EDGE_FRAMES) / EDGE_FRAMES, "same")[:, None]
        wanted = given + fade * self.change(features.numpy(), own)
        opening = MEASURES.index("opening")
        wanted[:, opening] = np.maximum(wanted[:, opening], 0) * (1 - shut[:, 0])
        target = torch.from_numpy(wanted).float()
        fitted = fit_curves(start, target, lips, controls, kept=(CONTACT,)).numpy()
        kept = np.where(fade > 0, fitted, curves)
        return np.asarray(kept, np.float32)
