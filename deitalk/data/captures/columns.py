"""Tables of named curves of any rig (CSV, JSON, NPZ), and tables that map them to known controls.

::

    CSV     a header of names; a column of seconds (`time`, `timeCode` …) or a rate given
    NPZ     names, values (frames, names), fps
    JSON    {"facsNames": […], "weightMat": [[…]], "exportFps": 60}          NVIDIA Audio2Face
            {"names": […], "values": [[…]], "fps": 60}
            [{"time": 0.0, "blendShapes": {"jawOpen": 0.1, …}}, …], or "frames" of an object
            {"names": […], "frames": [{"time": 0.0, "weights": […]}, …]}
"""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.errors import DataError
from rig import RigCurves
from rig.arrays import Float64
from rig.controls import check_unique
from rig.conversion.convert import KNOWN
from rig.curves import check_clip, snap_fps
from rig.errors import listed, quoted
from rig.files.reading import read_json, read_npz, read_text
from rig.formats.wide_csv import LARGEST, read_header, read_numbers
from rig.limits import CONTROLS, FRAMES, JSON_CURVES_BYTES, POINTS_BYTES

TIMES = ("time", "timecode", "seconds", "time_s", "timestamp", "t")
COUNTS = ("", "frame", "frames", "frame_number", "framenumber", "index", "blendshapecount")
A2F_PREFIX = "blendShapes."
NAME_KEYS = ("facsNames", "names", "blendShapeNames", "blendshape_names", "blendshapes")
VALUE_KEYS = ("weightMat", "values", "weights", "frames", "data")
RATE_KEYS = ("exportFps", "fps", "frame_rate", "frameRate")
WEIGHT_KEYS = ("blendShapes", "blendshapes", "weights", "values", "shapes")
UNEVEN = 0.1
"""Share of a step by which steps may differ without being put on an even grid."""
LONGEST_GAP_SECONDS = 1.0


@dataclass(frozen=True)
class NamedCurves:
    """Curves of any rig on an even grid, and what was done to get there."""

    names: tuple[str, ...]
    values: Float64
    """[shape=(T, N)]."""
    fps: float
    notes: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Float64:
        values: Float64 = self.values[:, self.names.index(name)]
        return values

    def to_curves(self, names: Mapping[str, str], control_set: str) -> RigCurves:
        """Return the columns that `names` gives another name, of a control set."""
        places = [self.names.index(name) for name in names]
        values = self.values[:, places].astype(np.float32)
        return RigCurves(values, tuple(names.values()), self.fps, control_set=control_set)


def read_named(path: Path, fps: float | None = None) -> NamedCurves:
    """Read a table of named curves.

    Parameters
    ----------
    path : Path
        .csv, .json or .npz.
    fps : float or None
        Frames per second, instead of the file's.

    Raises
    ------
    DataError
        If it is no such table, holds no rate and none is given, or its times do not rise.
    FormatError
        If a cell is no finite number (naming row and column), or the file cannot be read.
    """
    read = {".csv": _read_csv, ".json": _read_json, ".npz": _read_npz}.get(path.suffix.lower())
    if read is None:
        raise DataError(f"{path}: {path.suffix!r} is no table of curves; use .csv, .json or .npz")
    names, values, times, rate = read(path)
    check_unique(names, where=str(path))
    check_clip(len(values), len(names))
    if fps is not None:
        return NamedCurves(names, values, snap_fps(fps))
    if times is not None:
        return _on_even_grid(path, names, values, times)
    if rate is None:
        raise DataError(f"{path}: holds no times and no rate; give `fps`", parameter="fps")
    return NamedCurves(names, values, snap_fps(rate))


Table = tuple[tuple[str, ...], Float64, Float64 | None, float | None]
"""Names, values, times and rate."""


def _read_csv(path: Path) -> Table:
    header = read_header(path)
    lower = [cell.lower() for cell in header]
    numbers, _ = read_numbers(path, header)
    time = next((lower.index(name) for name in TIMES if name in lower), None)
    columns = [i for i, name in enumerate(lower) if name not in (*TIMES, *COUNTS)]
    names = tuple(header[i].removeprefix(A2F_PREFIX) for i in columns)
    return names, numbers[:, columns], None if time is None else numbers[:, time], None


def _read_npz(path: Path) -> Table:
    data = read_npz(path)
    if "names" not in data or "values" not in data:
        raise DataError(f"{path}: holds {', '.join(data) or 'nothing'}; needs names and values")
    names = tuple(str(name) for name in np.atleast_1d(data["names"]))
    rate = np.ravel(data["fps"])[0] if np.size(data.get("fps", ())) else None
    values = _matrix(path, np.atleast_1d(data["values"]), len(names))
    return names, values, None, None if rate is None else _rate(path, rate)


def _rate(path: Path, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise DataError(f"{path}: rate {quoted(value)} is no number") from None


def _read_json(path: Path) -> Table:
    data = read_json(path, JSON_CURVES_BYTES)
    if isinstance(data, dict):
        names, rows, rate = (_first(data, keys) for keys in (NAME_KEYS, VALUE_KEYS, RATE_KEYS))
        rate = None if rate is None else _rate(path, rate)
        if isinstance(names, list) and isinstance(rows, list):
            texts, times = tuple(str(name) for name in names), None
            if rows and all(isinstance(row, dict) for row in rows):
                times = _times(path, rows)
                rows = [_first(row, WEIGHT_KEYS) for row in rows]
            return texts, _matrix(path, rows, len(texts)), times, rate
        data = rows
    else:
        rate = None
    if not (isinstance(data, list) and data and all(isinstance(row, dict) for row in data)):
        raise DataError(f"{path}: is no JSON of curves; docs/finetuning.md lists what is read")
    return *_rows(path, data), rate


def _rows(path: Path, frames: Sequence[dict[str, Any]]) -> tuple[tuple[str, ...], Float64, Any]:
    """Names, values and times of frames that are objects."""
    weights = [_first(frame, WEIGHT_KEYS) for frame in frames]
    if not isinstance(weights[0], dict):
        weights = [
            {k: v for k, v in frame.items() if k.lower() not in (*TIMES, *COUNTS)}
            for frame in frames
        ]
    names = tuple(weights[0])
    for place, frame in enumerate(weights):
        if not isinstance(frame, dict) or frame.keys() != weights[0].keys():
            raise DataError(f"{path}: frame {place + 1} has other curves than the first frame")
    values = _matrix(path, [[frame[name] for name in names] for frame in weights], len(names))
    return names, values, _times(path, frames)


def _times(path: Path, frames: Sequence[dict[str, Any]]) -> Float64 | None:
    """Times of frames that are objects; None if they hold none."""
    keys = [key for key in frames[0] if key.lower() in TIMES]
    return _matrix(path, [[f.get(keys[0])] for f in frames], 1)[:, 0] if keys else None


def _first(data: Mapping[str, Any], keys: Sequence[str]) -> Any:
    return next((data[key] for key in keys if key in data), None)


def _matrix(path: Path, rows: Any, n_columns: int) -> Float64:
    if n_columns > CONTROLS or len(rows) > FRAMES:
        raise DataError(f"{path}: {len(rows)} frames of {n_columns} curves are too many; cut it")
    try:
        values = np.array(rows, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        raise DataError(f"{path}: values are no rows of {n_columns} numbers each") from None
    if values.ndim != 2 or values.shape[1] != n_columns or not len(values):
        raise DataError(
            f"{path}: values have shape {values.shape}; must be frames x {n_columns} names"
        )
    usable = np.abs(values) <= LARGEST
    if not usable.all():
        row = int(np.argwhere(~usable)[0, 0])
        raise DataError(f"{path}: frame {row + 1} holds NaN or infinity; mend or cut it")
    return values


def _on_even_grid(
    path: Path, names: tuple[str, ...], values: Float64, times: Float64
) -> NamedCurves:
    """Curves on the grid of their median step, where steps differ."""
    steps = np.diff(times)
    if not len(steps):
        return NamedCurves(names, values, 30.0)
    if not (steps > 0).all():
        row = int(np.argmax(~(steps > 0))) + 2
        raise DataError(f"{path}: data row {row} comes not after the one before; sort the times")
    step = float(np.median(steps))
    # The nearest whole rate where it is within a thousandth and a half.
    rate = 1 / step if np.ptp(steps) > UNEVEN * step else 1 / steps.mean()
    whole = round(rate)
    fps = snap_fps(float(whole) if whole and abs(rate - whole) < 5e-4 * rate else rate)
    if np.ptp(steps) <= UNEVEN * step:
        return NamedCurves(names, values, fps)
    longest = float(steps.max())
    if longest > LONGEST_GAP_SECONDS:
        raise DataError(
            f"{path}: {longest:.2g} s without a frame after data row {int(steps.argmax()) + 1}; "
            f"at most {LONGEST_GAP_SECONDS:g} s are bridged: cut the take there"
        )
    n_frames = int((times[-1] - times[0]) * fps + 0.5) + 1
    grid = times[0] + np.arange(n_frames) / fps
    even = np.stack([np.interp(grid, times, column) for column in values.T], axis=1)
    note = f"frames {steps.min() * 1000:.3g} to {longest * 1000:.3g} ms apart, put on {fps:g} fps"
    return NamedCurves(names, even, fps, (note,))


def describe_columns(names: Sequence[str]) -> str:
    """The first three names, quoted."""
    return listed([quoted(name) for name in names])


# Another rig's curves to known controls, by a table.
#
# ``map.csv``::
#
#     target,source,weight,offset
#     JawOpen,mouth_stretch_c,1,0
#     MouthPucker,mouth_pucker_l|mouth_pucker_r,1,0
#
# A target is a board channel, a raw curve or an ARKit shape, all rows of one set. It is the sum
# over its rows of weight * source + offset; of sources with ``|`` between them the largest counts.


HEADER = ("target", "source", "weight", "offset")
LARGEST_WEIGHT = 100.0
"""Most of a weight or an offset."""


@dataclass(frozen=True)
class Row:
    """A row of the table."""

    target: str
    sources: tuple[str, ...]
    weight: float
    offset: float


@dataclass(frozen=True)
class RigMapping:
    """A table of one control set."""

    path: Path
    control_set: str
    rows: tuple[Row, ...]

    @property
    def targets(self) -> tuple[str, ...]:
        """Controls that the table gives, each once, canonical."""
        return tuple(dict.fromkeys(row.target for row in self.rows))

    @property
    def sources(self) -> set[str]:
        """Curves that the table takes."""
        return {name for row in self.rows for name in row.sources}

    def apply(self, curves: NamedCurves, where: Path) -> RigCurves:
        """Return the targets' curves.

        Raises
        ------
        DataError
            If the file lacks a source of the table.
        """
        missing = sorted(self.sources - set(curves.names))
        if missing:
            raise DataError(
                f"{where}: lacks {describe_columns(missing)}, a source of {self.path.name}; mend "
                f"the table (the file has {describe_columns(curves.names)})"
            )
        values = np.zeros((len(curves.values), len(self.targets)))
        for row in self.rows:
            largest = np.max([curves[name] for name in row.sources], axis=0)
            values[:, self.targets.index(row.target)] += row.weight * largest + row.offset
        with np.errstate(over="ignore"):  # what becomes infinite is named by RigCurves
            rounded = values.astype(np.float32)
        return RigCurves(rounded, self.targets, curves.fps, control_set=self.control_set)


def read_mapping(path: Path) -> RigMapping:
    """Read a table of targets and sources.

    Raises
    ------
    DataError
        If it lacks a column, holds something that is no number or no control, or targets of
        several sets.
    """
    lines = csv.DictReader(io.StringIO(read_text(path, POINTS_BYTES, error=DataError)))
    try:
        header = [name.strip() for name in lines.fieldnames or ()]
        lines.fieldnames = header
        missing = [name for name in HEADER[:2] if name not in header]
        if missing:
            raise DataError(
                f"{path}: lacks the column {missing[0]}; the header is {','.join(HEADER)}"
            )
        rows = [_row(path, number, cells) for number, cells in enumerate(lines, 1)]
    except csv.Error as error:
        raise DataError(f"{path}: is no CSV: {error}") from None
    rows = [row for row in rows if row is not None]
    if not rows:
        raise DataError(f"{path}: has no rows; each names a target and a source")
    control_set = _set_of(path, [row.target for row in rows if row])
    names = KNOWN[control_set]()
    canonical = (
        Row(names.canonical(row.target), row.sources, row.weight, row.offset) for row in rows if row
    )
    return RigMapping(path, control_set, tuple(canonical))


def _row(path: Path, number: int, cells: dict[str, str]) -> Row | None:
    target, source = ((cells.get(name) or "").strip() for name in HEADER[:2])
    if not target and not source:
        return None
    sources = tuple(filter(None, (name.strip() for name in source.split("|"))))
    if not target or not sources:
        raise DataError(f"{path}: row {number} needs a target and a source; remove or fill it")
    weight, offset = (
        _number(path, number, name, (cells.get(name) or "").strip() or default)
        for name, default in (("weight", "1"), ("offset", "0"))
    )
    return Row(target, sources, weight, offset)


def _number(path: Path, row: int, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) <= LARGEST_WEIGHT:
        raise DataError(
            f"{path}: row {row}, {name} {quoted(text)} must be a number within ±{LARGEST_WEIGHT:g}"
        )
    return value


def _set_of(path: Path, targets: Sequence[str]) -> str:
    """The known set that has all targets."""
    unknown = {}
    for control_set, make in KNOWN.items():
        unknown[control_set] = [name for name in targets if name not in make()]
        if not unknown[control_set]:
            return control_set
    best = min(unknown, key=lambda name: len(unknown[name]))
    raise DataError(
        f"{path}: target {quoted(unknown[best][0])} is no control of {best}; all targets are of "
        "one set: board, raw curves or ARKit (`deitalk face controls` lists the board)"
    )
