"""Order of acted strengths in the face: ``deitalk evaluate MODEL --acted TABLE``.

Every recording of an actor in anger, joy or sadness at three strengths is animated in that emotion,
with its gain removed as always; the mean intensity over speech and the mean distance of the curves
from rest, of the whole face and of its parts, should be ordered as the strengths.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import spearmanr

from deitalk.audio.voice_activity import speech_activity
from deitalk.errors import DataError
from deitalk.evaluation.lip_closures import mouth_opening
from deitalk.evaluation.report import table
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.curves import animate
from rig import limits
from rig.arrays import Float32
from rig.errors import quoted
from rig.files.reading import check_file

# Recordings with known strength: readers at a fixed gain, and actors at three strengths.
#
# Two tables, whose paths are relative to their folder:
#
# ::
#
#     readers   path, speaker[, chapter]         one gain in a chapter; LibriSpeech's file names
#                                                (speaker-chapter-number) give it otherwise
#     actors    clip, actor, emotion, level      original gain; level LO, MD, HI or another word,
#                                                emotion NEU or another word (CREMA-D)
#
# Speakers are divided by a hash of their name: 28 % of the actors and 22 % of the readers are for
# tests, a further 18 % and 20 % for validation.

READERS, ACTORS = "libri", "crema"
LEVELS = ("LO", "MD", "HI")
NEUTRAL = "NEU"
TEST_SHARE = {READERS: 0.22, ACTORS: 0.28}
VALIDATION_SHARE = {READERS: 0.42, ACTORS: 0.46}
_COLUMNS = {READERS: ("path", "speaker"), ACTORS: ("clip", "actor", "emotion", "level")}


@dataclass(frozen=True)
class StrengthClip:
    """One recording.

    Attributes
    ----------
    kind : str
        `READERS` or `ACTORS`.
    path : Path
        Sound.
    speaker, group : str
        Within a group the gain is fixed: a reader's chapter, or an actor.
    emotion, level : str
        As asked of an actor; empty for readers.
    """

    kind: str
    path: Path
    speaker: str
    group: str
    emotion: str = ""
    level: str = ""

    @property
    def split(self) -> str:
        """``test``, ``validation`` or ``train``."""
        digest = hashlib.sha256(f"{self.kind}{self.speaker}".encode()).hexdigest()
        share = int(digest, 16) % 1000 / 1000
        if share < TEST_SHARE[self.kind]:
            return "test"
        return "validation" if share < VALIDATION_SHARE[self.kind] else "train"


def read_strength_clips(table: Path, kind: str) -> list[StrengthClip]:
    """Rows of a table of readers or of actors.

    Raises
    ------
    DataError
        If the table is absent, too large, none, or lacks a column or a sound.
    """
    check_file(table, limits.TRACK_BYTES, error=DataError)
    separator = "\t" if table.suffix == ".tsv" else ","
    try:
        frame = pd.read_csv(table, sep=separator, dtype=str, keep_default_na=False)
    except (ValueError, UnicodeDecodeError) as error:
        raise DataError(f"{table}: no table ({quoted(error, 120)})") from None
    missing = [name for name in _COLUMNS[kind] if name not in frame.columns]
    if missing or frame.empty:
        need = ", ".join(_COLUMNS[kind])
        raise DataError(f"{table}: needs rows with the columns {need}")
    rows: list[dict[str, str]] = frame.to_dict("records")  # type: ignore[assignment]
    clips = [_clip(table, kind, row) for row in rows]
    absent = next((clip.path for clip in clips if not clip.path.is_file()), None)
    if absent is not None:
        raise DataError(f"{table}: no sound {quoted(absent)}")
    return clips


def _clip(table: Path, kind: str, row: dict[str, str]) -> StrengthClip:
    if kind == ACTORS:
        path = table.parent / row["clip"]
        return StrengthClip(kind, path, row["actor"], row["actor"], row["emotion"], row["level"])
    path = table.parent / row["path"]
    chapter = row.get("chapter") or path.stem.rpartition("-")[0] or row["speaker"]
    return StrengthClip(kind, path, row["speaker"], chapter)


EMOTIONS = {"ANG": "angry", "HAP": "happy", "SAD": "sad"}
"""Emotions of the table (CREMA-D's names) that have a style."""
GROUPS = {"anger and joy": ("ANG", "HAP"), "sadness": ("SAD",)}
PARTS = {"brows": ("brow",), "nose": ("nose",), "lips": ("mouth",), "jaw": ("jaw",)}
"""Parts of the face, by parts of the names of their controls."""
Scores = dict[str, dict[str, float]]


def evaluate_acted(
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
        Actors to score: ``test``, ``validation`` or ``train``.
    progress : callable
        Called with the share done, 0 to 1.

    Returns
    -------
    dict
        By group of emotions: share of pairs in which high is above low, and mean rank correlation
        of low, middle and high, of every measure.

    Raises
    ------
    DataError
        If the table is not as described, or holds no actor of the split at three strengths.
    """
    clips = [
        clip
        for clip in read_strength_clips(path, ACTORS)
        if clip.split == split and clip.level in LEVELS and clip.emotion in EMOTIONS
    ]
    if not clips:
        raise DataError(f"{path}: no actor of the {split} split at the strengths {LEVELS}")
    rows = {}
    for number, clip in enumerate(clips, 1):
        rows[clip.speaker, clip.emotion, clip.level] = _measures(model, clip)
        progress(number / len(clips))
    return {group: _orders(rows, emotions) for group, emotions in GROUPS.items()}


def _measures(model: DEITalk, clip: StrengthClip) -> dict[str, float]:
    """Mean intensity, distance of the curves from rest, and opening of the mouth over speech."""
    performance = animate(clip.path, EMOTIONS[clip.emotion], model=model, life="off")
    speaking = speech_activity(performance.recording.waveform) > 0
    if not speaking.any():
        return dict.fromkeys(("intensity", "whole face", "opening", *PARTS), 0.0)
    controls = performance.curves.names
    moved: Float32 = np.abs(performance.curves.values - model.controls.rest)[speaking]
    measures = {
        "intensity": float(performance.predicted[speaking].mean()),
        "whole face": float(moved.sum(axis=1).mean()),
        "opening": float(mouth_opening(performance.curves.values, model.controls)[speaking].mean()),
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


def as_markdown(report: Scores) -> str:
    """A Markdown table; columns are groups of emotions."""
    return "\n".join(["Acted strengths:", "", *table("", report)])
