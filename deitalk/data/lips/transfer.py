"""Transfer of measured lips to other speech: corrected curves of an acted corpus.

The faces of a corpus follow tables (`deitalk.corpus`). Its lips are moved towards the prediction
of a regression on measured lips (`deitalk.data.lips.regression`) for the same speech, and towards
the amplitude of measured lips; contacts, emotional poses and all that is not lips stay.

Letters: T frames at 30 per second, C controls, D features, M measures.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deitalk.data.lips.fit import fit_curves, neutral_reading
from deitalk.data.lips.head import MEASURES, HeadLips
from deitalk.data.lips.regression import LipRidge
from deitalk.models.curve_model import DEITalk
from rig import ControlSet
from rig.arrays import Bool, Float32

MIX = 0.5
"""Share of the regression; the rest is the model's own lips at the measured amplitude."""
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
    """

    ridge: LipRidge
    gain: Float32
    offset: Float32

    @classmethod
    def fit(cls, recordings: Sequence[tuple[str, Float32, Float32, Float32]]) -> "LipTransfer":
        """Fit to measured recordings.

        Parameters
        ----------
        recordings : sequence of (str, (T, D), (T, M), (T, M))
            Speaker, features, the model's own lips, measured lips (NaN where missing), both
            displacements from rest in cm.
        """
        ridge = LipRidge.fit([(who, f, measured) for who, f, _, measured in recordings])
        known = [np.isfinite(m).all(axis=1) for _, _, _, m in recordings]
        own = np.concatenate([o[k] for (_, _, o, _), k in zip(recordings, known, strict=True)])
        real = np.concatenate([m[k] for (_, _, _, m), k in zip(recordings, known, strict=True)])
        gain = real.std(axis=0) / np.maximum(own.std(axis=0), 1e-6)
        return cls(ridge, gain, real.mean(axis=0) - gain * own.mean(axis=0))

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
        return np.asarray(MIX * self.ridge(features) + (1 - MIX) * amplified - own, np.float32)

    def correct(
        self,
        model: DEITalk,
        lips: HeadLips,
        sound: Tensor,
        curves: Float32,
        speaking: Bool,
    ) -> Float32:
        """Curves whose lips are corrected.

        Parameters
        ----------
        model : DEITalk
            Gives features and neutral curves.
        lips : HeadLips
            The head.
        sound : Tensor [shape=(S,)]
            16 kHz, level-normalised.
        curves : ndarray [shape=(T, C)]
            Of any emotion.
        speaking : ndarray [shape=(T,)]
            Frames with speech.

        Returns
        -------
        ndarray [shape=(T, C)]
        """
        controls = model.controls
        features, neutral = neutral_reading(model, sound, len(curves))
        own, start = lips.displacements(neutral).numpy(), torch.tensor(curves)
        given = lips.displacements(start).numpy()
        shut = np.clip(_together(curves, controls), 0, 1)[:, None]
        fade = np.convolve(speaking, np.ones(EDGE_FRAMES) / EDGE_FRAMES, "same")[:, None]
        wanted = given + fade * self.change(features.numpy(), own)
        opening = MEASURES.index("opening")
        wanted[:, opening] = np.maximum(wanted[:, opening], 0) * (1 - shut[:, 0])
        target = torch.from_numpy(wanted).float()
        fitted = fit_curves(start, target, lips, controls, kept=(CONTACT,)).numpy()
        kept = np.where(fade > 0, fitted, curves)
        return np.asarray(kept, np.float32)


def _together(curves: Float32, controls: ControlSet) -> Float32:
    places = [i for i, name in enumerate(controls.names) if CONTACT in name]
    return np.asarray(curves[:, places].mean(axis=1))
