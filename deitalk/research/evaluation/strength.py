"""Scores of a strength of voice against labels that no rule of this project made.

Readers: correlation with the level at a fixed gain within a chapter. Actors: the share of pairs of
one actor and emotion in which the high strength is above the low one, and the rank correlation of
low, middle and high (1 if all three are in order).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deitalk.audio.load import load_audio
from deitalk.audio.prosody import measure_prosody
from deitalk.audio.vocal_strength import (
    IS_VOICED,
    PITCH,
    VocalStrength,
    strength_frames,
    without_level,
)
from deitalk.audio.voice_activity import speech_activity
from deitalk.evaluation.scores import correlation
from deitalk.research.evaluation.acted import Scores, acted_order
from deitalk.research.evaluation.strength_clips import (
    ACTORS,
    LEVELS,
    NEUTRAL,
    READERS,
    StrengthClip,
)
from rig.arrays import Float32, Float64

GROUPS = {"anger and joy": ("ANG", "HAP"), "fear, disgust": ("FEA", "DIS"), "sadness": ("SAD",)}
"""Emotions by CREMA-D's names that are scored together."""


@dataclass(frozen=True)
class MeasuredClip:
    """A recording's features for `deitalk.audio.vocal_strength`."""

    clip: StrengthClip
    frames: Float32
    """From `strength_frames` [shape=(T, F)]."""
    level_db: float
    """Power of its speech, at the recording's gain."""


def measure_clips(clips: list[StrengthClip]) -> list[MeasuredClip]:
    """Features of recordings; those without voice are left out."""
    measured = []
    for clip in clips:
        recording = load_audio(clip.path)
        prosody = measure_prosody(recording.waveform, recording.n_frames)
        if prosody.voiced.any():
            frames = strength_frames(prosody, speech_activity(recording.waveform))
            measured.append(MeasuredClip(clip, frames, without_level(frames)[1]))
    return measured


def score_strength(network: VocalStrength, clips: Sequence[MeasuredClip]) -> Scores:
    """Scores of the network, of the level and of the median pitch.

    Parameters
    ----------
    network : VocalStrength
        In evaluation mode.
    clips : sequence of MeasuredClip
        Of speakers that it was not trained on.
    """
    return {
        "strength": _scores(clips, np.array([network.measure(clip.frames) for clip in clips])),
        "level at a fixed gain": _scores(clips, np.array([clip.level_db for clip in clips])),
        "median pitch": _scores(clips, np.array([_pitch(clip) for clip in clips])),
    }


def _pitch(clip: MeasuredClip) -> float:
    voiced = clip.frames[:, IS_VOICED] > 0
    return float(np.median(clip.frames[voiced, PITCH]))


def _scores(clips: Sequence[MeasuredClip], values: Float64) -> dict[str, float]:
    scores = {"level within a chapter, r": _within_chapters(clips, values)}
    acted = {
        (clip.clip.speaker, clip.clip.emotion, clip.clip.level): float(value)
        for clip, value in zip(clips, values, strict=True)
        if clip.clip.kind == ACTORS and (clip.clip.level in LEVELS or clip.clip.emotion == NEUTRAL)
    }
    for name, emotions in GROUPS.items():
        scores |= {f"{name}: {k}": v for k, v in acted_order(acted, emotions).items()}
    return scores


def _within_chapters(clips: Sequence[MeasuredClip], values: Float64) -> float:
    """Correlation with the level, both without the mean of their chapter."""
    rows = [i for i, clip in enumerate(clips) if clip.clip.kind == READERS]
    groups = np.array([clips[i].clip.group for i in rows])
    given, level = values[rows].copy(), np.array([clips[i].level_db for i in rows])
    for group in set(groups):
        inside = groups == group
        given[inside] -= given[inside].mean()
        level[inside] -= level[inside].mean()
    return float(correlation(given, level)) if rows else float("nan")


def as_markdown(scores: Scores) -> str:
    """A table whose rows are scores and whose columns are predictions."""
    names = list(scores)
    lines = ["| | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for row in scores[names[0]]:
        cells = [f"{scores[name][row]:.3g}" for name in names]
        lines.append(f"| {row} | " + " | ".join(cells) + " |")
    return "\n".join(lines)
