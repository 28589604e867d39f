"""Evidence for phones in a recording: how probable each is at each moment.

A linear map of the speech features of `default`, fitted to phone times of the training corpus.
Features are computed twice, the second time half a frame later, so that there are 60 rows per
second: a phone may last 30 ms. The phones are classes of articulation
(`deitalk.pipeline.words.transcript`), which all languages share.

Letters: T frames at 30 per second, D features, P phones.
"""

from collections.abc import Mapping
from functools import lru_cache
from importlib import resources
from typing import Any

import numpy as np
import torch

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.speech import Speech
from deitalk.postprocess.phones import PHONES
from rig.arrays import Float32, Int64

MODEL = "default"
"""Model to whose features the map was fitted."""
WEIGHTS = "phone_evidence.safetensors"
RATE = 2 * FRAME_RATE
"""Rows per second."""
CONTEXT = (-3, 0, 3)
"""Rows beside each that the map reads too; the ends repeat."""
PIECE = 4096
"""Rows that are mapped at once: an hour has 216,000."""


class PhoneEvidence:
    """Speech features to probabilities of phones: multinomial logistic regression.

    Parameters
    ----------
    weights : mapping of str to array
        ``mean``, ``spread`` [shape=(D,)], ``weight`` [shape=(P, 3 D)], ``bias`` and ``prior``
        [shape=(P,)].
    """

    def __init__(self, weights: Mapping[str, Any]) -> None:
        self.weights = {name: np.asarray(w, np.float32) for name, w in weights.items()}

    def log_probabilities(self, features: Float32) -> Float32:
        """Logarithm of the probability of each phone [shape=(2 T, P)].

        Parameters
        ----------
        features : array [shape=(2 T, D)]
            From `phone_features`.
        """
        count = len(features)
        pieces = [np.arange(i, min(i + PIECE, count)) for i in range(0, count, PIECE)]
        parts = [self._piece(features, rows) for rows in pieces]
        return np.concatenate(parts) if parts else np.zeros((0, len(PHONES)), np.float32)

    def _piece(self, features: Float32, rows: Int64) -> Float32:
        """Logarithms of the probabilities for some rows."""
        w, last = self.weights, len(features) - 1
        beside = [features[np.clip(rows + offset, 0, last)] for offset in CONTEXT]
        scaled = [(part - w["mean"]) / w["spread"] for part in beside]
        score = np.concatenate(scaled, axis=1) @ w["weight"].T + w["bias"]
        score -= score.max(axis=1, keepdims=True)
        score -= np.log(np.exp(score).sum(axis=1, keepdims=True))
        return np.asarray(score, np.float32)


def phone_features(network: DEITalk, speech: Speech) -> Float32:
    """Speech features of a recording at `RATE` [shape=(2 T, D)]."""
    sound, count = torch.tensor(speech.sound), speech.n_frames
    step = round(SAMPLE_RATE / RATE)
    later = sound[step:] if len(sound) > step else sound
    with torch.no_grad():
        both = [network.frontend.encode(part, count) for part in (sound, later)]
    return np.asarray(torch.stack(both, dim=1).flatten(0, 1).cpu().numpy(), np.float32)


def measure_phones(speech: Speech) -> Float32:
    """Logarithm of the probability of each phone, `RATE` rows a second [shape=(2 T, P)]."""
    features = phone_features(require_model(MODEL, DEITalk), speech)
    return phone_evidence().log_probabilities(features)


@lru_cache(maxsize=1)
def phone_evidence() -> PhoneEvidence:
    """The embedded map."""
    from safetensors.numpy import load

    data: Any = resources.files("deitalk.pipeline.words").joinpath(WEIGHTS).read_bytes()
    return PhoneEvidence(load(data))
