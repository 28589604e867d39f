"""Emotion suggested from a voice: neutral, angry, happy or sad, with its probability.

A linear map of the speech features of `default`, mean and spread over the speech, at any gain;
fitted to acted speech and its altered copies, and to readers as neutral. The suggestion is the
most probable emotion, neutral only where neutral is. Probabilities are those of four equally
frequent emotions. Surprise and the moods were not among the recordings and are never suggested.
Not in the paper, where the emotion is given. Letters: T frames, D features.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any, NamedTuple

import numpy as np
import torch

from deitalk.audio.arrays import Audio, recording_of
from deitalk.audio.choice import AudioChoice
from deitalk.audio.frames import FRAME_RATE
from deitalk.emotions import LABELS, EmotionTrack
from deitalk.errors import AudioError
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.speech import Speech
from rig.arrays import Float32, Float64

MODEL = "default"
"""Model to whose features the map was fitted."""
WEIGHTS = "suggestion.safetensors"
NAMED = ("neutral", "angry", "happy", "sad")
WINDOW_SECONDS, HOP_SECONDS = 3.0, 1.0
"""Windows of the track, each with at least `FEWEST_FRAMES` of speech, and their distance."""
FEWEST_FRAMES = 15
FURTHEST = 5.0
"""Standard deviations from the mean; what lies further counts as this."""


@dataclass(frozen=True)
class Suggestion:
    """Emotion that a voice suggests.

    Attributes
    ----------
    label : str
        The most probable emotion.
    probabilities : mapping of str to float
        Of each of `NAMED`, for the whole recording; they sum to 1.
    track : EmotionTrack
        The same by windows: neutral, or an emotion with its probability as weight.
    """

    label: str
    probabilities: Mapping[str, float]
    track: EmotionTrack

    @property
    def probability(self) -> float:
        """Probability of the label."""
        return self.probabilities[self.label]

    @property
    def line(self) -> str:
        """The label with its probability."""
        return f"{self.label} ({self.probability:.2f})"


class EmotionMap:
    """Numbers of a voice to probabilities: multinomial logistic regression.

    Parameters
    ----------
    weights : mapping of str to array
        ``mean``, ``spread`` [shape=(2 D,)], ``weight`` [shape=(4, 2 D)], ``bias``
        [shape=(4,)].
    """

    def __init__(self, weights: Mapping[str, Float32]) -> None:
        self.weights = weights

    def probabilities(self, numbers: Float32) -> Float64:
        """Probability of each of `NAMED` [shape=(4,)].

        Parameters
        ----------
        numbers : array [shape=(2 D,)]
            From `VoiceFrames.numbers`.
        """
        w = self.weights
        score = w["weight"] @ standardised(numbers, w["mean"], w["spread"]) + w["bias"]
        odds = np.exp(np.asarray(score, np.float64) - score.max())
        return np.asarray(odds / odds.sum(), np.float64)


def standardised(numbers: Float32, mean: Float32, spread: Float32) -> Float32:
    """Standard deviations from the mean, limited to `FURTHEST`."""
    limited: Float32 = np.clip((numbers - mean) / spread, -FURTHEST, FURTHEST)
    return limited


class VoiceFrames(NamedTuple):
    """Inputs of the map: frames of a recording, or of a window of it, before they are pooled."""

    features: Float32
    """Speech features of the network [shape=(T, D)]."""
    activity: Float32
    """1 in speech, else 0 [shape=(T,)]."""

    @classmethod
    def of(cls, network: DEITalk, speech: Speech) -> "VoiceFrames":
        """Measure a recording."""
        sound = torch.from_numpy(speech.waveform)
        features = network.frontend.encode(sound, speech.n_frames, gain=speech.gain)
        return cls(features.cpu().numpy(), speech.activity)

    @property
    def is_enough(self) -> bool:
        """Whether there is speech enough to suggest an emotion."""
        return int((self.activity > 0).sum()) >= FEWEST_FRAMES

    def numbers(self) -> Float32:
        """Mean and spread of the features over the speech [shape=(2 D,)]."""
        spoken = self.features[self.activity > 0]
        return np.concatenate((spoken.mean(axis=0), spoken.std(axis=0)))


def suggest_emotion(
    audio: Audio,
    *,
    sample_rate: float | None = None,
    track: int | None = None,
    channel: str | int | None = None,
    raw: str | None = None,
) -> Suggestion:
    """Suggest an emotion for `deitalk.animate`.

    Parameters
    ----------
    audio, sample_rate, track, channel, raw
        As for `deitalk.animate`.

    Returns
    -------
    Suggestion

    Raises
    ------
    AudioError
        If the recording cannot be read, or has less than half a second of speech.
    """
    recording = recording_of(audio, sample_rate, AudioChoice.of(track, channel, raw))
    speech = Speech.of_recording(recording)
    if int((speech.activity > 0).sum()) < FEWEST_FRAMES:
        raise AudioError(
            "the recording has less than half a second of speech; no emotion can be suggested"
        )
    frames = VoiceFrames.of(require_model(MODEL, DEITalk), speech)
    found = emotion_map()
    whole = found.probabilities(frames.numbers())
    return Suggestion(
        NAMED[int(whole.argmax())],
        {name: float(p) for name, p in zip(NAMED, whole, strict=True)},
        _track(found, frames),
    )


def _track(found: EmotionMap, frames: VoiceFrames) -> EmotionTrack:
    """Keys at the centres of windows; windows without speech have none."""
    length, hop = (round(s * FRAME_RATE) for s in (WINDOW_SECONDS, HOP_SECONDS))
    n_frames = len(frames.activity)
    times, rows = [], []
    for start in range(0, max(n_frames - length, 0) + hop, hop):
        window = VoiceFrames(*(part[start : start + length] for part in frames))
        if not window.is_enough:
            continue
        probabilities = found.probabilities(window.numbers())
        row = np.zeros(len(LABELS))
        best = int(probabilities.argmax())
        row[LABELS.index(NAMED[best])] = probabilities[best] if best else 1.0
        row[LABELS.index("neutral")] += 1 - row.sum()
        times.append((start + min(start + length, n_frames)) / 2 / FRAME_RATE)
        rows.append(row)
    if not times:
        times, rows = [0.0], [np.eye(len(LABELS))[LABELS.index("neutral")]]
    return EmotionTrack(np.array(times), np.array(rows))


@lru_cache(maxsize=1)
def emotion_map() -> EmotionMap:
    """The embedded map."""
    from safetensors.numpy import load

    data: Any = resources.files("deitalk.pipeline").joinpath(WEIGHTS).read_bytes()
    return EmotionMap(load(data))
