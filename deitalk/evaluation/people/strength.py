"""Scores of a strength of voice against labels that no rule of this project made.

Readers: correlation with the level at a fixed gain within a chapter. Actors: the share of pairs of
one actor and emotion in which the high strength is above the low one, and the rank correlation of
low, middle and high (1 if all three are in order).
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import spearmanr

from deitalk.audio.vocal_strength import PITCH, VOICED, VocalStrength
from deitalk.data.strength_clips import ACTORS, LEVELS, NEUTRAL, READERS, MeasuredClip
from deitalk.metrics import correlation
from rig.arrays import Float64

GROUPS = {"anger and joy": ("ANG", "HAP"), "fear, disgust": ("FEA", "DIS"), "sadness": ("SAD",)}
"""Emotions by CREMA-D's names that are scored together."""
Scores = dict[str, dict[str, float]]


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
    voiced = clip.frames[:, VOICED] > 0
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


def acted_order(
    values: Mapping[tuple[str, str, str], float], emotions: Sequence[str]
) -> dict[str, float]:
    """How well values are ordered as the strengths of the same actor and emotion.

    Parameters
    ----------
    values : mapping
        By actor, emotion and level.
    emotions : sequence of str
        Names of the table.

    Returns
    -------
    dict
        ``high above low``, ``rank correlation``, ``actors and emotions``; NaN and 0 without any.
    """
    triples = [
        tuple(values[actor, emotion, level] for level in LEVELS)
        for actor in sorted({key[0] for key in values})
        for emotion in emotions
        if all((actor, emotion, level) in values for level in LEVELS)
    ]
    ranks = [spearmanr(triple, range(3)).statistic for triple in triples if np.ptp(triple) > 0]
    return {
        "high above low": float(np.mean([t[2] > t[0] for t in triples])) if triples else np.nan,
        "rank correlation": float(np.sum(ranks) / len(triples)) if triples else np.nan,
        "actors and emotions": len(triples),
    }


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
