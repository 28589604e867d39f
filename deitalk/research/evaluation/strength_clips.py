"""Recordings with known strength: readers at a fixed gain, and actors at three strengths.

Two tables, whose paths are relative to their folder:

::

    readers   path, speaker[, chapter]         one gain in a chapter; LibriSpeech's file names
                                               (speaker-chapter-number) give it otherwise
    actors    clip, actor, emotion, level      original gain; level LO, MD, HI or another word,
              [, sentence]                     emotion NEU or another word (CREMA-D); or path, and
                                               level normal or strong and emotions in full
                                               (RAVDESS)

Speakers are divided by a hash of their name: 28 % of the actors and 22 % of the readers are for
tests, a further 18 % and 20 % for validation.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from deitalk.errors import DataError
from rig import limits
from rig.errors import quoted
from rig.files.reading import check_file

READERS, ACTORS = "libri", "crema"
LEVELS = ("LO", "MD", "HI")
NEUTRAL = "NEU"
TEST_SHARE = {READERS: 0.22, ACTORS: 0.28}
VALIDATION_SHARE = {READERS: 0.42, ACTORS: 0.46}
_COLUMNS = {READERS: ("path", "speaker"), ACTORS: ("actor", "emotion", "level")}
_WORDS = {
    "normal": "LO", "strong": "HI", "neutral": "NEU", "angry": "ANG", "happy": "HAP", "sad": "SAD",
    "fear": "FEA", "fearful": "FEA", "disgust": "DIS", "surprised": "SUR",
}  # fmt: skip
"""Levels and emotions of other tables, in CREMA-D's."""


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
    sentence : str
        What an actor says; empty if all say the same.
    """

    kind: str
    path: Path
    speaker: str
    group: str
    emotion: str = ""
    level: str = ""
    sentence: str = ""

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
    missing += [] if {"clip", "path"} & {*frame.columns} else ["clip"]
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
        emotion, level = (_WORDS.get(row[name], row[name]) for name in ("emotion", "level"))
        path = table.parent / (row.get("clip") or row["path"])
        said = row.get("sentence", "")
        return StrengthClip(kind, path, row["actor"], row["actor"], emotion, level, said)
    path = table.parent / row["path"]
    chapter = row.get("chapter") or path.stem.rpartition("-")[0] or row["speaker"]
    return StrengthClip(kind, path, row["speaker"], chapter)
