"""Emotion suggested from a voice: neutral, angry, happy or sad, with its probability.

A linear map of the speech features of `default`, mean and spread over the speech, and of the manner
of the voice (`manner`), at any gain; fitted to what raters of acted speech named
from the voice alone, and to readers as neutral.
Probabilities are those of four equally frequent emotions. It suggests and never imposes: where no
emotion is probable enough, the suggestion is neutral. Surprise was not among the raters' answers
and is never suggested. Not in the paper, where the emotion is given. Letters: T frames, D features,
M numbers of the manner.
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
from deitalk.audio.vocal_strength import (
    BANDS,
    Prosody,
    strength_frames,
    vocal_strength,
    without_level,
)
from deitalk.emotions import LABELS, EmotionTrack
from deitalk.errors import AudioError
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.speech import Speech
from rig.arrays import Bool, Float32, Float64

MODEL = "default"
"""Whose features the map was fitted to."""
WEIGHTS = "suggestion.safetensors"
NAMED = ("neutral", "angry", "happy", "sad")
SURE = 0.75
"""Least probability of an emotion other than neutral that is suggested."""
WINDOW_SECONDS, HOP_SECONDS = 3.0, 1.0
"""Of the track; a window has at least `FEWEST_FRAMES` of speech."""
FEWEST_FRAMES = 15
FURTHEST = 5.0
"""Standard deviations from the mean; what lies further counts as this."""


@dataclass(frozen=True)
class Suggestion:
    """What a voice suggests.

    Attributes
    ----------
    label : str
        The most probable emotion, or ``neutral`` where none is probable enough.
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
        """The label with its probability, or the two most probable ones where none is suggested."""
        best, second = sorted(NAMED, key=lambda name: -self.probabilities[name])[:2]
        if best == self.label:
            return f"{self.label} ({self.probability:.2f})"
        both = ", ".join(f"{name} {self.probabilities[name]:.2f}" for name in (best, second))
        return f"unsure: {both}; taken as {self.label}"


class EmotionMap:
    """Numbers of a voice to probabilities: multinomial logistic regression.

    Parameters
    ----------
    weights : mapping of str to array
        ``mean``, ``spread`` [shape=(2 D + M,)], ``weight`` [shape=(4, 2 D + M)], ``bias``
        [shape=(4,)].
    """

    def __init__(self, weights: Mapping[str, Float32]) -> None:
        self.weights = weights

    def probabilities(self, numbers: Float32) -> Float64:
        """Probability of each of `NAMED` [shape=(4,)].

        Parameters
        ----------
        numbers : array [shape=(2 D + M,)]
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
    """What the map is given of a recording, or of a window of it, before it is pooled."""

    features: Float32
    """Speech features of the network [shape=(T, D)]."""
    prosody: Prosody
    activity: Float32
    """1 in speech, else 0 [shape=(T,)]."""

    @classmethod
    def of(cls, network: DEITalk, speech: Speech) -> "VoiceFrames":
        """Measure a recording."""
        analysis = network.analyse(torch.tensor(speech.sound), speech.n_frames)
        return cls(analysis.speech.cpu().numpy(), speech.prosody, speech.activity)

    def window(self, frames: slice) -> "VoiceFrames":
        """Some of the frames."""
        prosody = Prosody._make(track[frames] for track in self.prosody)
        return VoiceFrames(self.features[frames], prosody, self.activity[frames])

    @property
    def is_enough(self) -> bool:
        """Whether there is speech enough to suggest an emotion."""
        return int((self.activity > 0).sum()) >= FEWEST_FRAMES

    def numbers(self) -> Float32:
        """Mean and spread of the features over the speech, and its manner [shape=(2 D + M,)]."""
        spoken = self.features[self.activity > 0]
        pooled = (spoken.mean(axis=0), spoken.std(axis=0), manner(self.prosody, self.activity))
        return np.concatenate(pooled)


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
        NAMED[_chosen(whole)],
        {name: float(p) for name, p in zip(NAMED, whole, strict=True)},
        _track(found, frames),
    )


def _chosen(probabilities: Float64) -> int:
    """Place of the suggested emotion in `NAMED`."""
    best = int(probabilities.argmax())
    return best if probabilities[best] >= SURE else 0


def _track(found: EmotionMap, frames: VoiceFrames) -> EmotionTrack:
    """Keys at the centres of windows; windows without speech have none."""
    length, hop = (round(s * FRAME_RATE) for s in (WINDOW_SECONDS, HOP_SECONDS))
    n_frames = len(frames.activity)
    times, rows = [], []
    for start in range(0, max(n_frames - length, 0) + hop, hop):
        window = frames.window(slice(start, start + length))
        if not window.is_enough:
            continue
        probabilities = found.probabilities(window.numbers())
        row = np.zeros(len(LABELS))
        best = _chosen(probabilities)
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


# Manner of a voice: how level, pitch, periodicity and spectrum move in a recording.
#
# Numbers of a whole recording or of a window: spreads, steps and percentiles about the mean, of
# what emotions of a voice are known by (Banse and Scherer 1996; Eyben et al. 2016). Gain changes
# none of them, and a microphone's colour only the strength (`deitalk.audio.vocal_strength`).
#
# Letters: T frames at 30 per second, M numbers.


SIZE = 3 * BANDS + 32
"""M."""
FEWEST_VOICED = 4
"""With fewer voiced frames of speech, those without speech count too."""
LARGEST_STEP = 5.0
"""Semitones from frame to frame; more is a wrong octave."""
DEEPEST_DB = 45.0
"""Level below the loudest speech; what is lower, such as digital silence, counts as this."""
EDGE_FRAMES = 6
"""At the start and the end, whose pitch is compared with the mean."""


def manner(prosody: Prosody, activity: Float32) -> Float32:
    """Measure the manner of a voice [shape=(M,)].

    Parameters
    ----------
    prosody : Prosody
        Of the frames.
    activity : array [shape=(T,)]
        1 in speech, else 0; 1 in at least one frame.
    """
    speech = activity > 0
    voiced = prosody.voiced & speech
    if voiced.sum() < FEWEST_VOICED:
        voiced = prosody.voiced | speech
    frames = strength_frames(prosody, activity)
    # Spread, height of the 90th percentile, and mean step of each band.
    bands = without_level(frames)[0][:, :BANDS].astype(np.float64)
    spoken = bands[speech]
    steps = np.abs(np.diff(bands, axis=0))[speech[1:] & speech[:-1]]
    mean_step = steps.mean(axis=0) if len(steps) else np.zeros(BANDS)
    high = np.percentile(spoken, 90, axis=0) - spoken.mean(axis=0)
    numbers = (
        np.concatenate((spoken.std(axis=0), high, mean_step)),
        _pitch(prosody.pitch, voiced),
        _level(prosody.level, speech),
        _periodicity(prosody.periodicity, speech, voiced),
        _rate(prosody.sonority, speech),
        [voiced.sum() / speech.sum(), vocal_strength().measure(frames)],
        [_correlation(prosody.level, track, voiced) for track in (prosody.pitch, prosody.tilt)],
    )
    return np.concatenate(numbers).astype(np.float32)


def _pitch(pitch: Float64, voiced: Bool) -> Float64:
    """Percentiles, ranges, slope, ends and steps, in semitones."""
    found = pitch[voiced]
    places = np.percentile(found, (5, 25, 50, 75, 95))
    time = np.flatnonzero(voiced) / FRAME_RATE
    time = time - time.mean()
    slope = (found * time).sum() / (np.square(time).sum() + 0.05)
    ends = (found[-EDGE_FRAMES:].mean(), found[:EDGE_FRAMES].mean()) - found.mean()
    steps = np.diff(pitch)[voiced[1:] & voiced[:-1]]
    steps = steps[np.abs(steps) < LARGEST_STEP]
    moved = (np.abs(steps).mean(), steps.std()) if len(steps) else (0.0, 0.0)
    ranges = (places[4] - places[0], places[3] - places[1], found.std(), found.mean())
    return np.concatenate((places, ranges, [slope], ends, moved))


def _level(level: Float64, speech: Bool) -> Float64:
    """Percentiles about the mean, spread and mean step, dB."""
    spoken = np.maximum(level[speech], level[speech].max() - DEEPEST_DB)
    places = np.percentile(spoken, (5, 25, 50, 75, 95)) - spoken.mean()
    step = np.abs(np.diff(spoken)).mean() if len(spoken) > 1 else 0.0
    return np.concatenate((places, [spoken.std(), step]))


def _periodicity(periodicity: Float64, speech: Bool, voiced: Bool) -> Float64:
    """Harmonics over noise in dB: mean and spread of speech and of vowels, and percentiles."""
    share = np.clip(periodicity, 0.01, 0.99)
    harmonic = 10 * np.log10(share / (1 - share))
    both = (harmonic[speech], harmonic[voiced])
    moments = [value for part in both for value in (part.mean(), part.std())]
    return np.concatenate((moments, np.percentile(both[1], (10, 90))))


def _rate(sonority: Float64, speech: Bool) -> list[float]:
    """Peaks of the sonority per second of speech."""
    inner = sonority[1:-1]
    peaks = (inner > sonority[:-2]) & (inner >= sonority[2:]) & speech[1:-1]
    return [float(peaks.sum() / speech.sum() * FRAME_RATE)]


def _correlation(a: Float64, b: Float64, frames: Bool) -> float:
    a, b = a[frames], b[frames]
    if len(a) <= FEWEST_VOICED or not a.std() or not b.std():
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])
