"""Order of acted strengths in the face: ``evaluate MODEL --acted TABLE``.

Every recording of an actor in an emotion at two or three strengths is animated in that emotion as
users see it, with life, and with its gain removed as always; the mean intensity over speech, the
mean distance of the curves from rest, of the whole face and of its parts, and the range of the
opening should be ordered as the strengths. The range of a strong take is also divided by that of
the actor's neutral takes of the same sentence, which says more of it than any strength.

The takes of an actor and emotion are also joined to one recording, with 0.4 s of silence
between, at their own gain and each at one level; the mean level of the speech is the baseline.
Within the middle and high takes, the range of the intensity and its correlation with the smoothed
level are those over speech.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.load import load_audio
from deitalk.audio.prosody import measure_prosody
from deitalk.audio.voice_activity import normalise_level, speech_activity
from deitalk.errors import DataError
from deitalk.evaluation.report import table
from deitalk.evaluation.scores import correlation
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.curves import animate
from deitalk.pipeline.performance import Performance
from deitalk.research.evaluation.clip_scores import mouth_opening
from deitalk.research.evaluation.strength_clips import (
    ACTORS,
    LEVELS,
    NEUTRAL,
    StrengthClip,
    read_strength_clips,
)
from rig.arrays import Bool, Float32
from rig.curves.filters import gaussian_smooth

EMOTIONS = {
    "ANG": "angry", "HAP": "happy", "SAD": "sad", "SUR": "surprised", "FEA": "fear",
    "DIS": "disgust",
}  # fmt: skip
"""Emotions of the table (CREMA-D's names); the last two are procedural."""
GROUPS = {
    "anger and joy": ("ANG", "HAP"), "sadness": ("SAD",), "surprise": ("SUR",), "fear": ("FEA",),
    "disgust": ("DIS",),
}  # fmt: skip
PARTS = {
    "upper face": ("brow", "cheekRaise", "squint", "eyelid", "nose"), "brows": ("brow",),
    "nose": ("nose",), "lips": ("mouth",), "jaw": ("jaw",),
}  # fmt: skip
"""Parts of the face, by parts of the names of their controls."""
JOINED = {"joined": False, "joined at one level": True}
"""Recordings of three takes, and whether each take is brought to one level."""
GAP_SECONDS = 0.4
LEVEL_SIGMA = 4.0
"""Frames over which the level is smoothed, a syllable."""
Scores = dict[str, dict[str, float]]


def evaluate(
    model: DEITalk,
    path: Path,
    *,
    split: str = "test",
    progress: Callable[[float], None] = lambda share: None,
) -> Scores:
    """Score a model on acted strengths.

    Parameters
    ----------
    model : DEITalk
        In evaluation mode.
    path : Path
        Table of actors (see the top).
    split : str
        Actors to score: ``test``, ``validation`` or ``train``; ``all`` of a table that nothing was
        trained on.
    progress : callable
        Called with the share done, 0 to 1.

    Returns
    -------
    dict
        By group of emotions: share of pairs in which high is above low, and mean rank correlation
        of the strengths, of every measure; mean difference of high and low, of joined takes; range
        (5th to 95th percentile) and r with the level inside takes; median range of the opening in
        high takes over that of the actor's neutral ones.

    Raises
    ------
    DataError
        If the table is not as described, or holds no actor of the split at two strengths.
    """
    every = [c for c in read_strength_clips(path, ACTORS) if split in (c.split, "all")]
    clips = [c for c in every if c.level in LEVELS and c.emotion in EMOTIONS]
    if not clips:
        raise DataError(f"{path}: no actor of the {split} split at the strengths {LEVELS}")
    rows, inside = {}, []
    said = {(clip.speaker, clip.sentence) for clip in clips}
    calm = [c for c in every if c.emotion == NEUTRAL and (c.speaker, c.sentence) in said]
    neutral = _neutral_openings(model, calm)
    for number, clip in enumerate(clips, 1):
        performance = animate(clip.path, EMOTIONS[clip.emotion], model=model)
        speaking = speech_activity(performance.recording.waveform) > 0
        rows[clip.speaker, clip.emotion, clip.level] = _measures(model, performance, speaking)
        if clip.level != LEVELS[0]:
            inside.append((clip.emotion, _inside(performance, speaking)))
        progress(0.5 * number / len(clips))
    joined: dict[str, dict[tuple[str, str, str], dict[str, float]]] = {name: {} for name in JOINED}
    takes: dict[tuple[str, str], dict[str, StrengthClip]] = {}
    for clip in clips:
        takes.setdefault((clip.speaker, clip.emotion), {})[clip.level] = clip
    for number, own in enumerate(takes.values(), 1):
        for name, is_levelled in JOINED.items():
            joined[name] |= _joined(model, own, is_levelled)
        progress(0.5 + 0.5 * number / len(takes))
    report = {}
    groups = {k: v for k, v in GROUPS.items() if any(clip.emotion in v for clip in clips)}
    for group, emotions in groups.items():
        report[group] = _orders(rows, emotions)
        for emotion in emotions:
            name = f"opening range: high over neutral, {EMOTIONS[emotion]}"
            report[group][name] = _over_neutral(rows, emotion, neutral)
        for name, own_rows in joined.items():
            orders = _orders(own_rows, emotions)
            report[group] |= {f"{name}, {k}": v for k, v in orders.items() if ": " in k}
            report[group][f"{name}, intensity: step"] = _step(own_rows, emotions)
        found = [numbers for emotion, numbers in inside if emotion in emotions]
        means = np.nanmean(found, axis=0) if found else (np.nan, np.nan)
        names = ("intensity: range inside takes", "intensity: r with level inside takes")
        report[group] |= dict(zip(names, map(float, means), strict=True))
    return report


def _neutral_openings(model: DEITalk, clips: Sequence[StrengthClip]) -> dict[str, float]:
    """Mean range of the opening in neutral takes, by actor."""
    found: dict[str, list[float]] = {}
    for clip in clips:
        performance = animate(clip.path, model=model)
        speaking = speech_activity(performance.recording.waveform) > 0
        opening = _measures(model, performance, speaking)["opening range"]
        found.setdefault(clip.speaker, []).append(opening)
    return {actor: float(np.mean(ranges)) for actor, ranges in found.items()}


def _over_neutral(
    rows: Mapping[tuple[str, str, str], Mapping[str, float]],
    emotion: str,
    neutral: Mapping[str, float],
) -> float:
    """Median range of the opening in high takes over that of the actor's neutral ones."""
    ratios = [
        row["opening range"] / neutral[actor]
        for (actor, of, level), row in rows.items()
        if of == emotion and level == LEVELS[-1] and neutral.get(actor)
    ]
    return float(np.median(ratios)) if ratios else float("nan")


def joined_takes(
    takes: Mapping[str, StrengthClip], is_levelled: bool
) -> tuple[Float32, dict[str, tuple[int, int]]]:
    """Takes of one actor and emotion in one recording, in any fixed order, and their samples.

    Each is at its own gain, or brought to one level.
    """
    one = next(iter(takes.values()))
    seed = hashlib.sha256(f"{one.speaker}{one.emotion}".encode()).digest()
    gap = np.zeros(round(GAP_SECONDS * SAMPLE_RATE), np.float32)
    parts, spans, length = [], {}, 0
    for level in sorted(takes, key=lambda name: seed[LEVELS.index(name)]):
        sound = load_audio(takes[level].path).waveform
        sound = normalise_level(sound) if is_levelled else sound
        spans[level] = (length, length + len(sound))
        parts += [sound, gap]
        length += len(sound) + len(gap)
    joined = np.concatenate(parts)
    return np.asarray(joined / max(1.0, float(np.abs(joined).max())), np.float32), spans


def _joined(
    model: DEITalk, takes: Mapping[str, StrengthClip], is_levelled: bool
) -> dict[tuple[str, str, str], dict[str, float]]:
    """Measures of the takes of one actor and emotion within one recording."""
    one = next(iter(takes.values()))
    sound, spans = joined_takes(takes, is_levelled)
    performance = animate(sound, EMOTIONS[one.emotion], model=model, sample_rate=SAMPLE_RATE)
    speaking, times = speech_activity(sound) > 0, np.arange(len(performance.curves)) / FRAME_RATE
    found = {}
    for level, (first, last) in spans.items():
        of_take = (times >= first / SAMPLE_RATE) & (times < last / SAMPLE_RATE)
        measures = _measures(model, performance, speaking & of_take)
        found[one.speaker, one.emotion, level] = {
            k: measures[k] for k in ("intensity", "level", "whole face", "upper face", "brows")
        }
    return found


def _step(
    rows: Mapping[tuple[str, str, str], Mapping[str, float]], emotions: Sequence[str]
) -> float:
    """Mean difference of the intensity of high and low."""
    steps = [
        measures["intensity"] - rows[actor, emotion, LEVELS[0]]["intensity"]
        for (actor, emotion, level), measures in rows.items()
        if level == LEVELS[-1] and emotion in emotions and (actor, emotion, LEVELS[0]) in rows
    ]
    return float(np.mean(steps)) if steps else float("nan")


def _inside(performance: Performance, speaking: Bool) -> tuple[float, float]:
    """Range of the intensity over speech, and its r with the smoothed level."""
    if speaking.sum() < FRAME_RATE // 3:
        return float("nan"), float("nan")
    prosody = measure_prosody(performance.recording.waveform, len(speaking))
    weight = gaussian_smooth(speaking.astype(float), LEVEL_SIGMA)
    level = gaussian_smooth(np.where(speaking, prosody.level, 0), LEVEL_SIGMA)
    level = (level / np.maximum(weight, 1e-6))[speaking]
    intensity = performance.predicted[speaking]
    low, high = np.percentile(intensity, (5, 95))
    return float(high - low), float(correlation(intensity, level))


def _measures(model: DEITalk, performance: Performance, speaking: Bool) -> dict[str, float]:
    """Mean intensity, distance of the curves from rest, and opening of the mouth over speech."""
    if not speaking.any():
        whole = ("intensity", "level", "whole face", "opening", "opening range")
        return dict.fromkeys((*whole, *PARTS), 0.0)
    controls = performance.curves.names
    opening = mouth_opening(performance.curves.values, model.controls)[speaking]
    moved: Float32 = np.abs(performance.curves.values - model.controls.rest)[speaking]
    measures = {
        "intensity": float(performance.predicted[speaking].mean()),
        "level": float(
            measure_prosody(performance.recording.waveform, len(speaking)).level[speaking].mean()
        ),
        "whole face": float(moved.sum(axis=1).mean()),
        "opening": float(opening.mean()),
        "opening range": float(np.subtract(*np.percentile(opening, (95, 5)))),
    }
    for part, names in PARTS.items():
        inside = [any(name in control for name in names) for control in controls]
        measures[part] = float(moved[:, inside].sum(axis=1).mean())
    return measures


def _orders(
    rows: dict[tuple[str, str, str], dict[str, float]], emotions: Sequence[str]
) -> dict[str, float]:
    scores: dict[str, float] = {}
    for measure in next(iter(rows.values())):
        order = acted_order({key: row[measure] for key, row in rows.items()}, emotions)
        scores[f"{measure}: high above low"] = order["high above low"]
        scores[f"{measure}: rank correlation"] = order["rank correlation"]
        scores["actors and emotions"] = order["actors and emotions"]
    return scores


def acted_order(
    values: Mapping[tuple[str, str, str], float], emotions: Sequence[str]
) -> dict[str, float]:
    """How well values are ordered as the two or three strengths of the same actor and emotion.

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
    ordered = [
        [values[key] for level in LEVELS if (key := (actor, emotion, level)) in values]
        for actor in sorted({key[0] for key in values})
        for emotion in emotions
        if all((actor, emotion, level) in values for level in (LEVELS[0], LEVELS[-1]))
    ]
    ranks = [spearmanr(row, range(len(row))).statistic for row in ordered if np.ptp(row) > 0]
    return {
        "high above low": float(np.mean([t[-1] > t[0] for t in ordered])) if ordered else np.nan,
        "rank correlation": float(np.sum(ranks) / len(ordered)) if ordered else np.nan,
        "actors and emotions": len(ordered),
    }


def as_markdown(report: Scores) -> str:
    """A Markdown table; columns are groups of emotions."""
    return "\n".join(["Acted strengths:", "", *table("", report)])
