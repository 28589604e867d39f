"""The dataset folder: ``clips.csv`` and the files it names.

::

    clips.csv             clip, audio, curves, emotion, speaker, split[, voice, source, offset_s,
                          phones, intensity, transcript]
    audio/<name>.flac     any file `deitalk.audio.load_audio` reads
    curves/<clip>.npz     any file `rig.read_curves` reads, at any rate
    phones/<name>.csv     start, end, phone (seconds)             optional
    intensity/<clip>.csv  time, intensity                         optional

Several clips may share one recording: the same words acted in several emotions. ``voice`` is the
emotion the *voice* acts where that differs from the curves'.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from deitalk.emotions import EMOTIONS
from deitalk.errors import DataError

SPLITS = ("train", "validation", "test")
REQUIRED = ("clip", "audio", "curves", "emotion", "speaker", "split")


@dataclass(frozen=True)
class Clip:
    """One row of ``clips.csv``, its paths made absolute."""

    name: str
    audio: Path
    curves: Path
    emotion: str
    speaker: str
    split: str
    voice: str
    source: str
    """Where the speech is from: an engine's name, or ``recording``."""
    offset_seconds: float
    """Curves start this long after the audio."""
    phones: Path | None
    intensity: Path | None


def read_clips(folder: Path | str, split: str | None = None) -> list[Clip]:
    """Rows of a dataset folder.

    Raises
    ------
    DataError
        If ``clips.csv`` is missing or lacks a column, or holds an unknown emotion or split, a
        doubled clip, or a path that leaves the folder or does not exist.
    """
    folder = Path(folder)
    table = folder / "clips.csv"
    if not table.is_file():
        raise DataError(f"{folder}: holds no clips.csv; see `deitalk corpus build --help`")
    frame = pd.read_csv(table, dtype=str, keep_default_na=False)
    missing = [name for name in REQUIRED if name not in frame.columns]
    if missing:
        raise DataError(f"{table}: lacks the column {', '.join(missing)}; needs {REQUIRED}")
    doubled = frame["clip"][frame["clip"].duplicated()]
    if len(doubled):
        raise DataError(f"{table}: clip {doubled.iloc[0]!r} appears twice; names must differ")
    for column, known in (("emotion", EMOTIONS), ("split", SPLITS)):
        unknown = frame[~frame[column].isin(known)]
        if len(unknown):
            value = unknown[column].iloc[0]
            raise DataError(f"{table}: {column} {value!r} is unknown; known are {', '.join(known)}")
    clips = [_clip(folder, row) for row in frame.to_dict("records")]
    return [clip for clip in clips if split is None or clip.split == split]


def _clip(folder: Path, row: dict[str, str]) -> Clip:
    return Clip(
        name=row["clip"],
        audio=_inside(folder, row["audio"]),
        curves=_inside(folder, row["curves"]),
        emotion=row["emotion"],
        speaker=row["speaker"],
        split=row["split"],
        voice=row.get("voice") or row["emotion"],
        source=row.get("source") or "recording",
        offset_seconds=float(row.get("offset_s") or 0),
        phones=_inside(folder, row["phones"]) if row.get("phones") else None,
        intensity=_inside(folder, row["intensity"]) if row.get("intensity") else None,
    )


def _inside(folder: Path, name: str) -> Path:
    path = folder / name
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise DataError(f"{folder}/clips.csv: {name!r} leaves the folder; use a path inside it")
    if not path.is_file():
        raise DataError(f"{folder}/clips.csv: {name!r} does not exist")
    return path


def read_intensity(path: Path, times: NDArray[np.float64]) -> NDArray[np.float32]:
    """Labelled intensity at given seconds [shape=(T,)]; linear between rows."""
    frame = pd.read_csv(path)
    return np.interp(times, frame["time"], frame["intensity"]).astype(np.float32)


def read_phones(path: Path) -> list[tuple[float, float, str]]:
    """Rows (start, end, phone) of a phone file, seconds."""
    frame = pd.read_csv(path)
    return list(zip(frame["start"], frame["end"], frame["phone"], strict=True))
