"""Tables of named curves of any rig: CSV, JSON and NPZ as other programs write them.

::

    CSV     a header of names; a column of times (`time`, `timestamp_ms`, `timeCode` …) or a rate
            given; commas, semicolons or tabs, decimal commas, UTF-8 or UTF-16
    TXT     lines `info`, `bs` (names) and `k` (milliseconds, head, eyes, shapes)       Face Cap
    NPZ     names, values (frames, names), fps
    JSON    {"facsNames": […], "weightMat": [[…]], "exportFps": 60}          NVIDIA Audio2Face
            {"names": […], "values": [[…]], "fps": 60}
            [{"time": 0.0, "blendShapes": {"jawOpen": 0.1, …}}, …], or "frames" of an object
            {"names": […], "frames": [{"time": 0.0, "weights": […]}, …]}
            [{"timestamp": 0, "blendshapes": [{"categoryName": "jawOpen", "score": 0.1}, …]}, …],
            results of a face landmarker, or lists of such categories               MediaPipe

A row or a frame without any curve is a time without a face.
"""

import re
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rig.arrays import Bool, Float64
from rig.controls import check_unique
from rig.curves import RigCurves, check_clip, snap_fps
from rig.curves.timecode import TICKS_PER_SECOND, TIMECODE, read_timecodes
from rig.errors import FormatError, quoted
from rig.files.reading import check_file, open_file, read_json, read_npz
from rig.formats.even_grid import even, rate_of
from rig.formats.units import check_rate, seconds_of
from rig.formats.wide_csv import LARGEST, Layout, read_layout, read_numbers
from rig.limits import CONTROLS, CURVES_BYTES, FRAMES, JSON_CURVES_BYTES

TIMES = frozenset(
    "time times timecode timecodes timestamp timestamps t ts seconds secs sec timeseconds times "
    "timesec timems timestampms milliseconds millis ms timeus timestampus microseconds us timens "
    "timestampns nanoseconds ns elapsed elapsedtime elapsedms currenttime pts".split()
)
"""Names of times: lower case, letters and digits alone."""
FRAME_NUMBERS = ("frame", "frames", "framenumber", "frameindex", "frameid", "index")
COUNTS = frozenset(["", *FRAME_NUMBERS, "blendshapecount"])
NO_SHAPES = ("_neutral",)
"""Columns that are no curves: MediaPipe's share of a neutral face."""
A2F_PREFIX = "blendShapes."
NAME_KEYS = ("facsNames", "names", "blendShapeNames", "blendshape_names", "blendshapes")
VALUE_KEYS = (
    "weightMat", "values", "weights", "frames", "data", "results", "faceBlendshapes",
    "face_blendshapes", "blendshapes", "blendShapes",
)  # fmt: skip
RATE_KEYS = ("exportFps", "fps", "frame_rate", "frameRate", "rate")
WEIGHT_KEYS = (
    "blendShapes", "blendshapes", "faceBlendshapes", "face_blendshapes", "categories", "weights",
    "values", "shapes",
)  # fmt: skip
LABEL_KEYS = ("categoryName", "category_name", "displayName", "name")
SCORE_KEYS = ("score", "value", "weight")
FACE_CAP_MARK = b"info,"
FACE_CAP_LEADING = 11
"""Cells of Face Cap's rows between ``k`` and shapes: time, place and turn of the head, eyes."""


@dataclass(frozen=True)
class NamedCurves:
    """Curves of any rig on an even grid, and what was done to get there."""

    names: tuple[str, ...]
    values: Float64
    """[shape=(T, N)]."""
    fps: float
    notes: tuple[str, ...] = ()
    seen: Bool | None = None
    """Frames that were captured [shape=(T,)]; None: all."""
    start: float | None = None
    """Time of day of the first frame, seconds; None if the file holds no time codes."""
    first: float = 0.0
    """Time of the first frame by the file's times or numbers of frames, seconds."""

    def __getitem__(self, name: str) -> Float64:
        values: Float64 = self.values[:, self.names.index(name)]
        return values

    def to_curves(self, names: Mapping[str, str], control_set: str) -> RigCurves:
        """Return the columns that `names` gives another name, of a control set."""
        places = [self.names.index(name) for name in names]
        values = self.values[:, places].astype(np.float32)
        return RigCurves(
            values, tuple(names.values()), self.fps, control_set=control_set, notes=self.notes
        )

    @property
    def all_notes(self) -> tuple[str, ...]:
        """The notes, and one on the time that was not captured, where values are straight lines."""
        if self.seen is None:
            return self.notes
        seconds = float((~self.seen).sum()) / self.fps
        return (*self.notes, f"{seconds:.1f} s without a frame: straight lines")


@dataclass(frozen=True)
class Table:
    """Rows of a file before they are put on an even grid."""

    names: tuple[str, ...]
    values: Float64
    """[shape=(T, N)]; NaN in a row without a face."""
    times: Float64 | None = None
    """As in the file [shape=(T,)]."""
    rate: float | None = None
    notes: tuple[str, ...] = ()
    start: float | None = None
    """Time of day of the first row; `times` are then seconds."""
    frames: Float64 | None = None
    """Numbers of frames, of a file without times [shape=(T,)]; rising."""


def read_named(
    path: Path,
    fps: float | None = None,
    *,
    otherwise: float | None = None,
    curves: Container[str] = (),
) -> NamedCurves:
    """Read a table of named curves.

    Parameters
    ----------
    path : Path
        .csv, .tsv, .txt, .json or .npz.
    fps : float or None
        Frames per second, instead of the file's.
    otherwise : float or None
        Frames per second if the file holds neither times nor a rate.
    curves : container of str
        Columns that are curves even if their name is that of a time or a number of frames.

    Raises
    ------
    FormatError
        If it is no such table, holds no rate and none is given, its times do not rise or are those
        of no capture, a cell is no finite number (naming row and column), or the file cannot be
        read.
    """
    suffix = path.suffix.lower()
    readers: dict[str, Callable[[Path], Table]] = {
        ".csv": partial(_read_csv, curves=curves), ".json": _read_json, ".npz": _read_npz,
        ".tsv": partial(_read_csv, curves=curves),
        ".txt": _read_face_cap if suffix == ".txt" and is_face_cap(path) else _read_csv,
    }  # fmt: skip
    if suffix not in readers:
        check_file(path, CURVES_BYTES)  # no suffix helps what is not there
        raise FormatError(f"{path}: {suffix!r} is no table of curves; use .csv, .json or .npz")
    table = readers[suffix](path)
    kept = [i for i, name in enumerate(table.names) if name not in NO_SHAPES]
    if len(kept) < len(table.names):
        names = tuple(table.names[i] for i in kept)
        table = replace(table, names=names, values=table.values[:, kept])
    check_unique(table.names, where=str(path))
    check_clip(len(table.values), len(table.names))
    given = None if fps is None else snap_fps(fps)
    return _on_even_grid(path, table, given, None if otherwise is None else snap_fps(otherwise))


def is_time(name: str) -> bool:
    """Whether a column holds times, by its name."""
    return _plain(name) in TIMES


def is_count(name: str) -> bool:
    """Whether a column holds numbers of frames or of shapes, by its name."""
    return name == "" or _plain(name) in COUNTS - {""}


def is_face_cap(path: Path) -> bool:
    """Whether a text begins as those of Face Cap."""
    with open_file(path, CURVES_BYTES) as stream:
        return stream.read(len(FACE_CAP_MARK)).lower() == FACE_CAP_MARK


def _plain(name: str) -> str:
    return re.sub(r"[\W_]", "", name.lower())


def _read_csv(path: Path, curves: Container[str] = ()) -> Table:
    layout = read_layout(path)
    header = layout.header
    others = [i for i, name in enumerate(header) if name not in curves]
    time = next((i for i in others if is_time(header[i])), None)
    count = next((i for i in others if _plain(header[i]) in FRAME_NUMBERS), None)
    left = {i for i in others if is_time(header[i]) or is_count(header[i])}
    columns = [i for i in range(len(header)) if i not in left]
    names = tuple(header[i].removeprefix(A2F_PREFIX) for i in columns)
    if time is not None and time < len(layout.first) and ":" in layout.first[time]:
        return _with_clock(path, layout, time, columns, names)
    numbers, _ = read_numbers(path, layout, face=columns if time is not None else ())
    if time is not None:
        return Table(names, numbers[:, columns], numbers[:, time])
    frames = None if count is None else numbers[:, count]
    is_counted = frames is not None and len(frames) > 1 and (np.diff(frames) > 0).all()
    return Table(names, numbers[:, columns], frames=frames if is_counted else None)


def _with_clock(
    path: Path, layout: Layout, time: int, columns: Sequence[int], names: tuple[str, ...]
) -> Table:
    """A table whose times are text: time codes, hours with seconds, or dates."""
    numbers, (texts,) = read_numbers(path, layout, text_columns=(time,), face=columns)
    values = numbers[:, [i - (i > time) for i in columns]]
    if TIMECODE.fullmatch(texts[0].strip()):
        clock = read_timecodes(texts, path)
        seconds = clock.ticks / TICKS_PER_SECOND
        notes = (f"time codes count {clock.count} frames a second",)
        return Table(names, values, seconds - seconds[0], notes=notes, start=float(seconds[0]))
    import pandas as pd

    is_date = "-" in texts[0] or "/" in texts[0]
    try:
        moments = (
            pd.DatetimeIndex(pd.to_datetime(texts, utc=True))
            if is_date
            else pd.TimedeltaIndex(pd.to_timedelta(texts))
        )
    except ValueError:
        raise FormatError(
            f"{path}: column {layout.header[time]!r} holds {quoted(texts[0])}; times are seconds, "
            "milliseconds, HH:MM:SS.sss or time codes"
        ) from None
    past = moments.as_unit("ns").asi8
    return Table(names, values, (past - past[0]) / 1e9)


def _read_face_cap(path: Path) -> Table:
    with open_file(path, CURVES_BYTES) as stream:
        lines = stream.read().decode("utf-8", "replace").splitlines()
    names: tuple[str, ...] = ()
    leading: list[list[str]] = []
    shapes: list[list[Any]] = []
    for line in lines:
        mark, *cells = [cell.strip() for cell in line.rstrip(", ").split(",")]
        if mark == "bs":
            names = tuple(cells)
        elif mark == "k":
            leading.append(cells[:FACE_CAP_LEADING])
            shapes.append(cells[FACE_CAP_LEADING:] or [np.nan] * len(names))
    if not names or not leading:
        raise FormatError(f"{path} needs a line 'bs' of names and lines 'k'; Face Cap writes both")
    numbers = _matrix(path, leading, FACE_CAP_LEADING)
    moved = np.ptp(numbers[:, 1:], axis=0).any()
    note = ("head and eyes as angles are left out",) if moved else ()
    return Table(names, _matrix(path, shapes, len(names)), numbers[:, 0], notes=note)


def _read_npz(path: Path) -> Table:
    data = read_npz(path)
    if "names" not in data or "values" not in data:
        raise FormatError(f"{path}: holds {', '.join(data) or 'nothing'}; needs names and values")
    names = tuple(str(name) for name in np.atleast_1d(data["names"]))
    rate = np.ravel(data["fps"])[0] if np.size(data.get("fps", ())) else None
    values = _matrix(path, np.atleast_1d(data["values"]), len(names))
    return Table(names, values, None, _rate(path, rate))


def _rate(path: Path, value: Any) -> float | None:
    if value is None:
        return None
    try:
        rate = float(value)
    except (TypeError, ValueError, OverflowError):
        raise FormatError(f"{path}: rate {quoted(value)} is no number") from None
    check_rate(rate, path)
    return rate


def _read_json(path: Path) -> Table:
    data = read_json(path, JSON_CURVES_BYTES)
    rate = times = None
    if isinstance(data, dict):
        names, rows, rate = (_first(data, keys) for keys in (NAME_KEYS, VALUE_KEYS, RATE_KEYS))
        rate = _rate(path, rate)
        is_named = isinstance(names, list) and all(isinstance(name, str) for name in names)
        if is_named and isinstance(rows, list):
            texts, times = tuple(names), _listed_times(path, data, len(rows))
            if rows and all(isinstance(row, dict) for row in rows):
                times = _times(path, rows)
                rows = [_first(row, WEIGHT_KEYS) for row in rows]
            rows = [[np.nan] * len(texts) if row in (None, []) else row for row in rows]
            return Table(texts, _matrix(path, rows, len(texts)), times, rate)
        times = _listed_times(path, data, len(rows)) if isinstance(rows, list) else None
        data = rows
    # Names, values and times of frames that are objects, or lists of categories.
    frames = data if isinstance(data, list) else []
    is_known = all(isinstance(frame, dict | list) for frame in frames)
    weights = [_weights(path, k, frame) for k, frame in enumerate(frames, 1)] if is_known else []
    names = tuple(next((row for row in weights if row), ()))
    if not names:
        raise FormatError(f"{path}: is no JSON of curves; docs/finetuning.md lists what is read")
    none = dict.fromkeys(names, np.nan)
    rows = [row or none for row in weights]
    for place, row in enumerate(rows, 1):
        if row.keys() != none.keys():
            raise FormatError(f"{path}: frame {place} has other curves than the first frame")
    values = _matrix(path, [[row[name] for name in names] for row in rows], len(names))
    is_object = all(isinstance(frame, dict) for frame in frames)
    own = _times(path, frames) if is_object else None
    return Table(names, values, times if own is None else own, rate)


def _listed_times(path: Path, data: Mapping[str, Any], n_frames: int) -> Float64 | None:
    """Times that an object lists beside its frames; None if it lists none."""
    listed = [v for k, v in data.items() if is_time(k) and isinstance(v, list)]
    fitting = [[[time] for time in v] for v in listed if len(v) == n_frames]
    return _matrix(path, fitting[0], 1)[:, 0] if fitting else None


def _weights(path: Path, place: int, frame: Any) -> dict[str, Any]:
    """Weights of a frame by name; empty without a face."""
    weights: Any = frame
    if isinstance(frame, dict):
        key = next((key for key in WEIGHT_KEYS if key in frame), None)
        weights = frame[key] if key else {
            k: v for k, v in frame.items() if not (is_time(k) or is_count(k))
        }  # fmt: skip
    if isinstance(weights, list) and len(weights) == 1 and isinstance(weights[0], list):
        weights = weights[0]  # of one face
    elif isinstance(weights, list) and weights and isinstance(weights[0], dict):
        inner = _first(weights[0], ("categories",))
        weights = inner if inner is not None else weights
    elif isinstance(weights, dict) and "categories" in weights:
        weights = weights["categories"]
    if isinstance(weights, list):
        pairs = [
            (_first(c, LABEL_KEYS), _first(c, SCORE_KEYS)) if isinstance(c, dict) else (None, None)
            for c in weights
        ]
        if any(not isinstance(name, str) or score is None for name, score in pairs):
            raise FormatError(
                f"{path}: frame {place} is no object of names and weights, nor a list of "
                "categories with categoryName and score"
            )
        weights = dict(pairs)
    return weights if isinstance(weights, dict) else {}


def _times(path: Path, frames: Sequence[dict[str, Any]]) -> Float64 | None:
    """Times of frames that are objects; None if they hold none."""
    keys = [key for key in frames[0] if is_time(key)] if frames else []
    return _matrix(path, [[f.get(keys[0])] for f in frames], 1)[:, 0] if keys else None


def _first(data: Mapping[str, Any], keys: Sequence[str]) -> Any:
    return next((data[key] for key in keys if key in data), None)


def _matrix(path: Path, rows: Any, n_columns: int) -> Float64:
    if n_columns > CONTROLS or len(rows) > FRAMES:
        raise FormatError(f"{path}: {len(rows)} frames of {n_columns} curves are too many; cut it")
    try:
        values = np.array(rows, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        bad = next((k for k, row in enumerate(rows, 1) if not _is_row(row, n_columns)), 1)
        raise FormatError(
            f"{path}: values are no rows of {n_columns} numbers each; see frame {bad}"
        ) from None
    if values.ndim != 2 or values.shape[1] != n_columns or not len(values):
        raise FormatError(
            f"{path}: values have shape {values.shape}; must be frames x {n_columns} names"
        )
    usable = np.abs(values) <= LARGEST
    usable[np.isnan(values).all(axis=1)] = n_columns > 1  # no face
    if not usable.all():
        row = int(np.argwhere(~usable)[0, 0])
        raise FormatError(f"{path}: frame {row + 1} holds NaN or infinity; mend or cut it")
    return values


def _is_row(row: Any, n_columns: int) -> bool:
    try:
        return np.array(row, np.float64).shape == (n_columns,)
    except (ValueError, TypeError, OverflowError):
        return False


def _on_even_grid(
    path: Path, table: Table, given: float | None, otherwise: float | None
) -> NamedCurves:
    """Curves at an even rate from the first row on, a straight line where rows are missing."""
    notes = list(table.notes)
    rate = given or table.rate or otherwise
    count = np.arange(len(table.values)) if table.frames is None else table.frames
    seconds: Float64 | None = None if rate is None else (count - count[0]) / rate
    own, timed = rate, None
    if table.times is not None:
        try:
            timed, note = seconds_of(table.times, rate, path, is_known=table.start is not None)
        except FormatError:
            if given is None:
                raise
            timed, note = None, "its times are of no capture and not used"
        notes += [note] if note else []
        if timed is not None:
            own = rate_of(timed)
            if given is not None and not _agree(given, own):
                notes.append(f"read at {given:g} Hz as given; its times say {own:.5g}")
                own = given
            else:
                seconds = timed
            if given is None and rate is not None and not _agree(rate, own):
                notes.append(f"its times say {own:.5g} Hz, not {rate:g}: they count")
    if seconds is None or own is None:
        raise FormatError(f"{path}: holds no times and no rate; give `fps`", parameter="fps")
    fps = snap_fps(rate if rate is not None and _agree(rate, own) else own)
    values, seen, said = even(path, table.values, seconds, fps)
    first = float(seconds[0]) if seconds is timed else float(count[0]) / own
    return NamedCurves(table.names, values, fps, (*notes, *said), seen, table.start, first)


def _agree(one: float, other: float) -> bool:
    return abs(one - other) <= 5e-4 * max(one, other)
