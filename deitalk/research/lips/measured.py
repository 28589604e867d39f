"""Folders of lips that were measured on video.

A folder of measured lips::

    clips.csv         clip, speaker[, words]; words as "bin:0.50-0.74 blue:0.74-0.94" (seconds)
    columns.json      {"columns": [...]}: names of the measures, `COLUMNS` among them
    **/<clip>.npz     meas [shape=(n, columns)], int16 in 1e-4 of the distance between the outer
                      corners of the eyes, -32768 where missing; y points down
    **/<clip>.opus    the sound, or another audio file of that name; measure i is taken at
                      (i + .5) / 25 s

An npz may also hold ``pose`` [shape=(n, 3 or more)]: yaw, pitch and roll of the head in degrees.

People differ in size and in how their lips rest, so measures become displacements from the rest
of their speaker, in cm of a head (`speaker_rest`).

Letters: T frames at 30 per second, M measures (`deitalk.research.lips.head_lips.MEASURES`).
"""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.errors import DataError
from rig import limits
from rig.arrays import Bool, Float32, Float64
from rig.errors import quoted
from rig.files.reading import check_file, read_json, read_npz

COLUMNS = ("open_in", "jaw", "width_out", "upper_lip_y", "lower_lip_y", "corner_y")
"""Columns of a measurement, in the order of `deitalk.research.lips.head_lips.MEASURES`."""
RATE, MISSING, UNIT = 25.0, -32768, 1e-4
SOUNDS = (".opus", ".wav", ".flac", ".mp3", ".ogg", ".m4a")
CLOSED_PERCENTILE = 5
"""Percentile of a speaker's opening at which lips touch."""


@dataclass(frozen=True)
class LipClip:
    """One measured recording."""

    name: str
    speaker: str
    sound: Path
    measures: Float32
    """Displacements from the speaker's rest [shape=(T, M)], cm of a head; NaN where missing."""
    speaking: Bool
    """From the first word to the last [shape=(T,)]."""


@dataclass(frozen=True)
class PoseClip:
    """One recording with the turn of its speaker's head."""

    name: str
    speaker: str
    sound: Path
    degrees: Float64
    """Yaw, pitch and roll as measured, 25 a second [shape=(n, 3)]."""
    words: tuple[tuple[float, float, str], ...] = ()
    """Start and end in seconds, and the word; empty if they are not stated."""


def read_poses(folder: Path | str, most: int | None = None) -> dict[str, list[PoseClip]]:
    """Read the heads of a folder of measured lips, by speaker; clips with gaps are left out.

    Parameters
    ----------
    folder : Path
        As described above.
    most : int or None
        Most recordings of a speaker, evenly spread.

    Raises
    ------
    DataError
        If a table or a file is missing or damaged, or no recording has a pose.
    """
    folder = Path(folder)
    files = {path.name: path for path in sorted(folder.rglob("*")) if path.is_file()}
    names: dict[str, list[str]] = {}
    words = {}
    for name, speaker, spoken in read_rows(folder / "clips.csv"):
        names.setdefault(speaker, []).append(name)
        words[name] = spoken
    poses: dict[str, list[PoseClip]] = {}
    for speaker, clips in sorted(names.items()):
        count = len(clips) if most is None else min(most, len(clips))
        chosen = [clips[i] for i in np.linspace(0, len(clips) - 1, count).round().astype(int)]
        for name in chosen:
            degrees = _pose(files, name)
            if degrees is not None:
                sound = _sound(folder, files, name)
                clip = PoseClip(name, speaker, sound, degrees, words[name])
                poses.setdefault(speaker, []).append(clip)
    if not poses:
        raise DataError(f"{folder}: no recording with a pose of shape (frames, 3 or more)")
    return poses


def _pose(files: dict[str, Path], name: str) -> Float64 | None:
    """Degrees (n, 3), or None where the file is missing or has gaps."""
    path = files.get(f"{name}.npz")
    pose = None if path is None else read_npz(path, limit=limits.MESH_BYTES, error=DataError)
    turns = None if pose is None else pose.get("pose")
    if turns is None or turns.dtype.kind != "f" or turns.ndim != 2 or turns.shape[1] < 3:
        return None
    degrees: Float64 = turns[:, :3].astype(np.float64)
    return degrees if len(degrees) and np.isfinite(degrees).all() else None


def read_lips(folder: Path | str, eye_distance: float) -> list[LipClip]:
    """Read a folder of measured lips.

    Parameters
    ----------
    folder : Path
        As described above.
    eye_distance : float
        Between the outer corners of the head's eyes, cm.

    Raises
    ------
    DataError
        If a table or a file is missing or damaged, or a column of `COLUMNS` is not measured.
    """
    folder = Path(folder)
    columns = _columns(folder / "columns.json")
    files = {path.name: path for path in sorted(folder.rglob("*")) if path.is_file()}
    by_speaker: dict[str, list[LipClip]] = {}
    for name, speaker, words in read_rows(folder / "clips.csv"):
        first, last = (words[0][0], words[-1][1]) if words else (0.0, np.inf)
        track = _track(folder, files, name, columns)
        times = np.arange(int(len(track) / RATE * FRAME_RATE)) / FRAME_RATE
        clip = LipClip(
            name,
            speaker,
            _sound(folder, files, name),
            _at(track, times),
            (times >= first) & (times <= last),
        )
        by_speaker.setdefault(speaker, []).append(clip)
    if not by_speaker:
        raise DataError(f"{folder / 'clips.csv'}: holds no clip")
    return [
        replace(clip, measures=eye_distance * (clip.measures - rest))
        for clips in by_speaker.values()
        for rest in [speaker_rest(clips)]
        for clip in clips
    ]


def read_rows(path: Path) -> Iterator[tuple[str, str, tuple[tuple[float, float, str], ...]]]:
    """Clip, speaker, and start, end and text of each word; DataError as `read_lips`."""
    check_file(path, limits.TRACK_BYTES, error=DataError)
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        for row in rows:
            if not row["clip"] or not row["speaker"]:
                raise ValueError("an empty name")
            yield row["clip"], row["speaker"], tuple(map(_word, (row.get("words") or "").split()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path}: cannot be read ({type(error).__name__})") from None
    except (KeyError, IndexError, ValueError, TypeError):
        raise DataError(
            f"{path}: needs the columns clip and speaker, and words as bin:0.50-0.74"
        ) from None


def _word(text: str) -> tuple[float, float, str]:
    """Start, end and text of ``bin:0.50-0.74``."""
    name, _, times = text.rpartition(":")
    start, end = times.split("-")
    return float(start), float(end), name


def _columns(path: Path) -> list[int]:
    """Places of `COLUMNS` among the measures."""
    tree = read_json(path, limit=limits.MODEL_JSON_BYTES, error=DataError)
    names = tree.get("columns") if isinstance(tree, dict) else None
    if not isinstance(names, list):
        raise DataError(f"{path}: needs a list of names under columns")
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise DataError(f"{path}: lacks the measures {', '.join(missing)}")
    return [names.index(name) for name in COLUMNS]


def _track(folder: Path, files: dict[str, Path], name: str, columns: Sequence[int]) -> Float32:
    """Measures (n, M) in distances of the eyes, NaN where missing."""
    path = files.get(f"{name}.npz")
    if path is None:
        raise DataError(f"{folder}: no {quoted(name)}.npz below it")
    track = read_npz(path, limit=limits.MESH_BYTES, error=DataError).get("meas")
    if track is None or track.dtype != np.int16 or track.ndim != 2 or not len(track):
        raise DataError(f"{path}: needs meas, int16 of shape (frames, measures)")
    if track.shape[1] <= max(columns):
        raise DataError(f"{path}: meas has {track.shape[1]} columns; columns.json names more")
    chosen = track[:, list(columns)]
    return np.where(chosen == MISSING, np.nan, chosen * UNIT).astype(np.float32)


def _sound(folder: Path, files: dict[str, Path], name: str) -> Path:
    for suffix in SOUNDS:
        if name + suffix in files:
            return files[name + suffix]
    raise DataError(f"{folder}: no sound of {quoted(name)} below it ({', '.join(SOUNDS)})")


def _at(track: Float32, times: Float64) -> Float32:
    """Measures at seconds; NaN beside missing ones and beyond the ends."""
    taken = (np.arange(len(track)) + 0.5) / RATE
    out = np.stack([np.interp(times, taken, column) for column in track.T], axis=1)
    out[(times < taken[0] - 0.5 / RATE) | (times > taken[-1] + 0.5 / RATE)] = np.nan
    return out.astype(np.float32)


def speaker_rest(clips: Sequence[LipClip]) -> Float32:
    """Measures of a speaker's lips at rest, closed [shape=(M,)].

    The median of the silent frames whose lips are nearest each other; of the opening, the
    `CLOSED_PERCENTILE` of all frames.

    Parameters
    ----------
    clips : sequence of LipClip
        All of one speaker, as measured.

    Raises
    ------
    DataError
        If no frame has all measures.
    """
    values = np.concatenate([clip.measures for clip in clips])
    known = np.isfinite(values).all(axis=1)
    if not known.any():
        raise DataError(f"speaker {quoted(clips[0].speaker)}: no frame has all lip measures")
    silent = known & ~np.concatenate([clip.speaking for clip in clips])
    silent = silent if silent.any() else known
    closed = silent & (values[:, 0] <= np.median(values[silent, 0]))
    rest = np.median(values[closed], axis=0)
    rest[0] = np.percentile(values[known, 0], CLOSED_PERCENTILE)
    return np.asarray(rest, np.float32)
