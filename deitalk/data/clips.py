"""The dataset folder: ``clips.csv`` and the files it names.

::

    clips.csv             clip, audio, curves, emotion, speaker, split[, voice, source, offset_s,
                          phones, intensity, known, take, start_s, stop_s, style, transcript,
                          language, age]
    audio/<name>.flac     any file `deitalk.audio.load.load_audio` reads
    curves/<clip>.npz     any file `rig.read_curves` reads, at any rate
    phones/<name>.csv     start, end, phone (seconds)             optional
    intensity/<clip>.csv  time, intensity                         optional
    known/<source>.txt    controls that the curves hold           optional

Several clips may share one recording: the same words acted in several emotions. ``voice`` is the
emotion the *voice* acts where that differs from the curves'.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deitalk.emotions import EMOTIONS
from deitalk.errors import DataError
from rig import ControlSet
from rig.arrays import Bool, Float32, Float64
from rig.errors import ControlError
from rig.files.reading import read_text
from rig.files.text_rows import Row, read_rows
from rig.limits import CONTROL_SET_BYTES

SPLITS = ("train", "validation", "test")
MAX_BYTES = 512 * 1024**2
MAX_OFFSET_SECONDS = 3600.0
MEASURED = "measured"
"""Source of clips whose lips were measured on people."""
REHEARSED = "rehearsed"
"""Source of clips whose speech alone is used: all their controls count as unknown."""
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
    """Where the speech is from: an engine's name, ``recording``, or ``measured``."""
    offset_seconds: float
    """Curves start this long after the audio."""
    phones: Path | None
    intensity: Path | None
    known: Path | None = None
    """Names of the controls that the curves hold; None: all of them."""
    take: str = ""
    """Take that the clip was cut from; empty: not stated."""
    span: tuple[float, float] = (0.0, 0.0)
    """Start and stop in the take, seconds."""

    @property
    def take_name(self) -> str:
        """Name of its take; a clip without one is its own."""
        return self.take or self.name

    @property
    def group(self) -> tuple[str, str]:
        """Its actor, and their emotion."""
        return self.speaker, self.emotion


def spread_clips(clips: Sequence[Clip], most: int | None) -> list[Clip]:
    """Select at most so many clips, evenly spread over the list; None: all."""
    if most is None or len(clips) <= most:
        return list(clips)
    places = np.linspace(0, len(clips) - 1, most).round().astype(int)
    return [clips[i] for i in places]


def read_clips(folder: Path | str, split: str | None = None) -> list[Clip]:
    """Rows of a dataset folder.

    Raises
    ------
    DataError
        If ``clips.csv`` is missing, is no table or lacks a column, or holds an unknown emotion
        or split, a doubled or nameless clip, an offset that is no number, or a path that leaves
        the folder or does not exist.
    """
    folder = Path(folder)
    table = folder / "clips.csv"
    if not table.is_file():
        what = "holds no clips.csv" if folder.is_dir() else "is no folder"
        raise DataError(
            f"{folder} {what}; `deitalk data import takes/ -o DATA` writes a dataset folder"
        )
    header, rows = read_rows(table, MAX_BYTES, error=DataError, needed=REQUIRED)
    # Names differ, emotions and splits are known.
    names: set[str] = set()
    for row in rows:
        if not row["clip"]:
            raise DataError(f"{table}: a clip has no name; name every row")
        if row["clip"] in names:
            raise DataError(f"{table}: clip {row['clip']!r} appears twice; names must differ")
        names.add(row["clip"])
    known = {"emotion": EMOTIONS, "split": SPLITS, "voice": ("", *EMOTIONS)}
    for column in known.keys() & set(header):
        for row in rows:
            if row[column] not in known[column]:
                among = ", ".join(filter(None, known[column]))
                raise DataError(f"{table}: {column} {row[column]!r} is unknown; known are {among}")
    return [_clip(folder, row) for row in rows if split is None or row["split"] == split]


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
        offset_seconds=_seconds(folder, row, "offset_s"),
        phones=_inside(folder, row["phones"]) if row.get("phones") else None,
        intensity=_inside(folder, row["intensity"]) if row.get("intensity") else None,
        known=_inside(folder, row["known"]) if row.get("known") else None,
        take=row.get("take") or "",
        span=(_seconds(folder, row, "start_s"), _seconds(folder, row, "stop_s")),
    )


def _seconds(folder: Path, row: dict[str, str], column: str) -> float:
    text = row.get(column) or "0"
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) <= MAX_OFFSET_SECONDS:
        raise DataError(
            f"{folder}/clips.csv: {column} {text!r} of clip {row['clip']!r} must be a number of "
            f"seconds within ±{MAX_OFFSET_SECONDS:g}"
        )
    return value


def _inside(folder: Path, name: str) -> Path:
    path = folder / name
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise DataError(f"{folder}/clips.csv: {name!r} leaves the folder; use a path inside it")
    if not path.is_file():
        raise DataError(f"{folder}/clips.csv: {name!r} does not exist; mend the path")
    return path


def read_intensity(path: Path, times: Float64) -> Float32:
    """Labelled intensity at given seconds [shape=(T,)]; linear between rows, held beyond.

    Raises
    ------
    DataError
        If the file has no rows, its times do not rise, or an intensity is not within 0 to 1.
    """
    _, (known, values) = _numbers(path, ("time", "intensity"))
    if not len(known) or not (np.diff(known) > 0).all() or values.min() < 0 or values.max() > 1:
        raise DataError(
            f"{path}: needs rows of rising time (seconds) and intensity from 0 to 1; "
            "mend it or leave the column empty"
        )
    held: Float32 = np.interp(times, known, values).astype(np.float32)
    return held


def read_known(path: Path | None, controls: ControlSet) -> Bool:
    """Controls that the curves of a clip hold [shape=(C,)]; all of them without a file.

    A source of curves cannot see everything: a face camera moves neither the tongue nor the lower
    lip's bite. What it does not see is no zero, but unknown, and left out of losses and scores.

    Parameters
    ----------
    path : Path or None
        Text with the name of one control a line, by any of its spellings; ``#`` begins a comment.
    controls : ControlSet
        Order of the result.

    Raises
    ------
    DataError
        If the file is too large or no UTF-8 text, or names no control, or an unknown one.
    """
    if path is None:
        return np.ones(len(controls), bool)
    lines = read_text(path, CONTROL_SET_BYTES, error=DataError).splitlines()
    names = [name for line in lines if (name := line.partition("#")[0].strip())]
    if not names:
        raise DataError(f"{path}: names no control; write one a line, or leave `known` empty")
    known = np.zeros(len(controls), bool)
    try:
        known[controls.indices(names)] = True
    except ControlError as error:
        raise DataError(f"{path}: {error}") from None
    return known


def _numbers(path: Path, columns: Sequence[str], *text: str) -> tuple[list[Row], list[Float64]]:
    """Rows of a table, and its columns of finite numbers."""
    _, rows = read_rows(path, MAX_BYTES, error=DataError, needed=(*columns, *text))
    found = []
    for name in columns:
        try:
            found.append(np.array([float(row[name]) for row in rows]))
        except ValueError:
            found.append(np.array([np.nan]))
        if not np.isfinite(found[-1]).all():
            raise DataError(f"{path}: {name} holds something that is no number; mend the row")
    return rows, found


def read_phones(path: Path) -> list[tuple[float, float, str]]:
    """Rows (start, end, phone) of a phone file, seconds.

    Raises
    ------
    DataError
        If a time is no number, or a phone ends before it starts.
    """
    rows, (starts, ends) = _numbers(path, ("start", "end"), "phone")
    if (ends < starts).any():
        raise DataError(f"{path}: a phone ends before it starts; start and end are seconds")
    names = [row["phone"] for row in rows]
    return list(zip(starts.tolist(), ends.tolist(), names, strict=True))
