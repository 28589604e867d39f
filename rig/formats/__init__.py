"""Files of curves: one module per format, one table from names and suffixes to them.

`read_curves` and `write_curves` go through the table, so that every format gets the same checks:
sizes, ranges, NaN, missing and doubled controls, and a file that is written whole or not at all.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rig.controls import DEFAULT_ID, ControlSet, default_controls
from rig.curves import RigCurves
from rig.edit import ClampReport, clamp
from rig.errors import FormatError
from rig.files import atomic_write
from rig.formats import curves_csv, curves_json, curves_npz

Reader = Callable[[Path, ControlSet, float | None], RigCurves]
Writer = Callable[[Path, RigCurves], None]
RANGE_TOLERANCE = 1e-4
"""Excess over a range that a reader takes for rounding and clamps."""


@dataclass(frozen=True)
class Format:
    """One file format.

    Parameters
    ----------
    name : str
        What ``--format`` says.
    suffixes : tuple of str
        Ends of file names that mean this format, the longest match wins.
    description : str
        One line.
    read, write : callable, optional
        None where a format goes one way only.
    has_tracks : bool
        Whether emotion and intensity are kept.
    """

    name: str
    suffixes: tuple[str, ...]
    description: str
    read: Reader | None = None
    write: Writer | None = None
    has_tracks: bool = False


@dataclass(frozen=True)
class WriteReport:
    """What a writer did besides writing.

    Parameters
    ----------
    path : Path
    format : str
    n_frames : int
    fps : float
    clipped : ClampReport
        Values brought into their ranges; empty if none.
    dropped : tuple of str
        Tracks the format cannot hold.
    """

    path: Path
    format: str
    n_frames: int
    fps: float
    clipped: ClampReport
    dropped: tuple[str, ...] = ()


FORMATS: tuple[Format, ...] = (
    Format(
        "csv",
        (".csv",),
        "frame, time and one column per control",
        curves_csv.read,
        curves_csv.write,
    ),
    Format(
        "json",
        (".json",),
        "schema deitalk.curves/1, with tracks",
        curves_json.read,
        curves_json.write,
        has_tracks=True,
    ),
    Format(
        "npz",
        (".npz",),
        "numpy archive, exact, with tracks",
        curves_npz.read,
        curves_npz.write,
        has_tracks=True,
    ),
)


def read_curves(
    path: Path | str,
    *,
    format: str | None = None,
    controls: ControlSet | None = None,
    fps: float | None = None,
) -> RigCurves:
    """Read curves from a file of any known format.

    Parameters
    ----------
    path : Path or str
        The file.
    format : str, optional
        Name of a format; by default the suffix, and for CSV the header, tells.
    controls : ControlSet, optional
        What the columns are; by default the MetaHuman board. All its controls must be there, in
        any order and any known spelling.
    fps : float, optional
        Frames per second where the file does not say, or says wrong.

    Raises
    ------
    FormatError
        If the format is unknown or the file is not what it should be: not there, too large, NaN,
        out of range (naming row and column), uneven times.
    ControlError
        If a control is unknown or doubled.
    """
    path = Path(path)
    controls = controls or default_controls()
    chosen = find_format(path, format, readable=True)
    assert chosen.read is not None
    return check_range(chosen.read(path, controls, fps), controls, where=str(path))


def write_curves(
    path: Path | str, curves: RigCurves, *, format: str | None = None, fps: float | None = None
) -> WriteReport:
    """Write curves to a file, whole or not at all; values outside their ranges are clamped.

    Parameters
    ----------
    path : Path or str
        An existing file is replaced.
    curves : RigCurves
        At least one frame.
    format : str, optional
        Name of a format; by default the suffix tells.
    fps : float, optional
        Rate to resample to.

    Returns
    -------
    WriteReport
        Says what was clamped and which tracks the format cannot hold.

    Raises
    ------
    FormatError
        If the format is unknown, there are no frames, or the file cannot be written.
    """
    path = Path(path)
    chosen = find_format(path, format, writable=True)
    assert chosen.write is not None
    if not len(curves):
        raise FormatError(f"there are no frames to write to {path}")
    clipped = ClampReport()
    if curves.control_set == DEFAULT_ID:
        curves, clipped = clamp(curves)
    if fps is not None:
        curves = curves.resample(fps)
    try:
        with atomic_write(path) as beside:
            chosen.write(beside, curves)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FormatError(f"cannot write {path}: {reason}") from error
    tracks = {"emotion": curves.emotion, "intensity": curves.intensity}
    lost = () if chosen.has_tracks else tuple(k for k, v in tracks.items() if v is not None)
    return WriteReport(path, chosen.name, len(curves), curves.fps, clipped, lost)


def find_format(
    path: Path, name: str | None = None, *, readable: bool = False, writable: bool = False
) -> Format:
    """Return the format of a name, or of a path's suffix.

    Raises
    ------
    FormatError
        If there is none that goes the way that is asked for; the known ones are listed.
    """
    fits = [f for f in FORMATS if (f.read or not readable) and (f.write or not writable)]
    by_name: Mapping[str, Format] = {f.name: f for f in fits}
    if name is not None:
        if name not in by_name:
            raise FormatError(f"unknown format {name!r}; known: {', '.join(by_name)}")
        return by_name[name]
    endings = [(s, f) for f in fits for s in f.suffixes if path.name.lower().endswith(s)]
    if not endings:
        known = ", ".join(s for f in fits for s in f.suffixes)
        raise FormatError(f"{path}: no format has the suffix {path.suffix!r}; known: {known}")
    return max(endings, key=lambda ending: len(ending[0]))[1]


def check_range(curves: RigCurves, controls: ControlSet, *, where: str) -> RigCurves:
    """Return the curves, rounding excess clamped.

    Raises
    ------
    FormatError
        If a value lies outside its control's range, naming row, column and range.
    """
    if curves.control_set != controls.id or not len(curves):
        return curves
    places = controls.indices(curves.names)
    low, high = controls.minimum[places], controls.maximum[places]
    outside = (curves.values < low - RANGE_TOLERANCE) | (curves.values > high + RANGE_TOLERANCE)
    if outside.any():
        row, column = (int(i) for i in np.argwhere(outside)[0])
        raise FormatError(
            f"{where}: data row {row + 1}, column {curves.names[column]!r} is "
            f"{curves.values[row, column]:g}, outside {low[column]:g} to {high[column]:g} "
            f"({int(outside.sum())} values in all); clamp the curves before writing them"
        )
    return replace(curves, values=np.clip(curves.values, low, high))


__all__ = [
    "FORMATS",
    "Format",
    "WriteReport",
    "check_range",
    "find_format",
    "read_curves",
    "write_curves",
]
