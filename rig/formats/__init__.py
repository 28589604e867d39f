"""Files of curves: one module per format, one table from names and suffixes to them.

`read_curves` and `write_curves` go through the table, so that every format gets the same checks:
sizes, ranges, NaN, missing and doubled controls, and a file that is written whole or not at all.
"""

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rig.controls import DEFAULT_ID, ControlSet
from rig.conversion.arkit import ARKIT_ID
from rig.conversion.convert import convert, convert_and_note, known_controls, unshown
from rig.curves import RigCurves
from rig.curves.edit import ClampReport, clamp
from rig.curves.shift import shift, start_with_handles
from rig.errors import FormatError, quoted
from rig.files import atomic_write
from rig.files.reading import open_file
from rig.formats.named import is_face_cap
from rig.formats.table import FORMATS, Format, find_format, format_of_header
from rig.formats.units import in_units
from rig.formats.wide_csv import read_header
from rig.limits import JSON_CURVES_BYTES

if TYPE_CHECKING:
    from rig.face.identity import Identity

JSON_MARKS = (
    (b'"deitalk.curves/', "json"), (b'"mouthCues"', "rhubarb-json"), (b'"facsNames"', "a2f-json"),
    (b'"categoryName"', "shapes"), (b'"category_name"', "shapes"), (b'lendShapes"', "shapes"),
    (b'lendshapes"', "shapes"),
)  # fmt: skip
"""Text at the beginning of a JSON file, by which its format is recognised."""
RHUBARB_CELLS = 2
"""Cells of a line of Rhubarb's cues; a table of more is one of curves."""
RANGE_TOLERANCE = 1e-4
"""Excess over a range that a reader clamps as rounding."""


@dataclass(frozen=True)
class WriteReport:
    """Changes that a writer made to the curves.

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
    note : str
        Other losses and additions, in one line: the residual of ARKit shapes, rows that hold the
        last frame; empty if nothing.
    """

    path: Path
    format: str
    n_frames: int
    fps: float
    clipped: ClampReport
    dropped: tuple[str, ...] = ()
    note: str = ""

    @property
    def notes(self) -> list[str]:
        """All losses and additions, a line each."""
        lost = f"left out by {self.format}: {', '.join(self.dropped)} (.json and takes keep them)"
        lines = [lost if self.dropped else "", str(self.clipped) if self.clipped else "", self.note]
        return [line for line in lines if line]


def read_curves(
    path: Path | str,
    *,
    format: str | None = None,
    controls: ControlSet | None = None,
    fps: float | None = None,
    control_set: str | None = DEFAULT_ID,
) -> RigCurves:
    """Read curves from a file of any known format, by default as channels of the MetaHuman board.

    Parameters
    ----------
    path : Path or str
        The file.
    format : str, optional
        Name of a format; by default that of the suffix, or of the beginning of a CSV or JSON file.
    controls : ControlSet, optional
        A user's own control set of the columns; all its controls must be there. By default board,
        raw curves or ARKit, by the file or its names, in any order and known spelling.
    fps : float, optional
        Frames per second, instead of the file's.
    control_set : str, optional
        Set to convert to where the file holds another of the known ones: a Live Link take becomes
        board channels. None leaves the curves as they are.

    Returns
    -------
    RigCurves
        With a note for each correction: units, rates, rows without a face.

    Raises
    ------
    FormatError
        If the format is unknown, or the file is missing, too large or invalid: NaN, out of range
        (naming row and column; Live Link takes are clamped), times or angles of no face.
    ControlError
        If a control is unknown or doubled.
    """
    path = Path(path)
    chosen = find_format(path, format, readable=True)
    if format is None:
        # Return the format of a CSV or JSON file by its beginning.
        name = None
        if path.suffix.lower() == ".csv":
            name = format_of_header(read_header(path))
        elif chosen.name == "rhubarb-tsv" and len(read_header(path)) > RHUBARB_CELLS:
            name = "csv"
        elif chosen.name == "emoface" and is_face_cap(path):
            name = "facecap"
        elif chosen.name == "json":
            with open_file(path, JSON_CURVES_BYTES) as stream:
                beginning = stream.read(4096).replace(b"\0", b"")  # of UTF-16
            name = next((found for mark, found in JSON_MARKS if mark in beginning), None)
        chosen = find_format(path, name or chosen.name)
    assert chosen.read is not None
    curves = chosen.read(path, controls, fps)
    known = controls or known_controls(curves.control_set)
    if known is not None:
        curves = in_units(curves, known, path)
    if known is not None and known.id != ARKIT_ID:  # calibrated captures exceed their ranges
        if chosen.name.startswith("livelink"):
            curves, clipped = clamp(curves, known)
            said = (str(clipped),) if clipped else ()
            curves = replace(curves, notes=(*curves.notes, *said))
        else:
            curves = check_range(curves, known, where=str(path))
    wanted = control_set if controls is None else controls.id
    return curves if wanted is None else convert(curves, wanted)


def read_known_or_own(path: Path | str) -> RigCurves:
    """Read curves as channels of the MetaHuman board, or of a user's own rig as they are.

    Errors are those of `read_curves`.
    """
    curves = read_curves(path, control_set=None)
    return curves if known_controls(curves.control_set) is None else convert(curves, DEFAULT_ID)


def write_curves(
    path: Path | str,
    curves: RigCurves,
    *,
    format: str | None = None,
    fps: float | None = None,
    digits: int | None = None,
    sound: Path | str = "",
    seconds: float | None = None,
    start: float = 0.0,
    identity: "int | str | Identity | None" = None,
    delay: int = 0,
    handles: int = 0,
) -> WriteReport:
    """Write curves to a file, whole or not at all; values outside their ranges are clamped.

    Parameters
    ----------
    path : Path or str
        An existing file is replaced.
    curves : RigCurves
        At least one frame.
    format : str, optional
        Name of a format; by default that of the suffix.
    fps : float, optional
        Rate to resample to.
    digits : int, range 2 to 6, optional
        Digits after the point, of csv, json, raw-csv and unreal, which have 6 by default; a value
        read again differs by at most half of the last one.
    sound : Path or str
        File of the speech, for formats that name it (Rhubarb's JSON and XML).
    seconds : float, optional
        Length of the speech, for formats that state it (Rhubarb's); by default that of the curves,
        whose last frame may end up to a frame later.
    start : float
        Time of day of the first frame, seconds, for formats with time codes (Live Link Face, Unreal
        JSON).
    identity : int, str or Identity, optional
        Number or name of the embedded head in a GLB or USD, of `rig.face.IDENTITIES` or ``female``,
        ``male`` or ``child``; head 0 by default.
    delay, handles : int
        Frames of the written rate by which the face is late against the sound, and that are added
        before and after (`rig.curves.shift.shift`); `start` is that of the frame after the handles.

    Returns
    -------
    WriteReport
        The clamped controls, and the tracks that the format cannot hold.

    Raises
    ------
    FormatError
        If the format is unknown, there are no frames, the digits are out of range or the format
        has none, it shows no head, or the file cannot be written.
    """
    path = Path(path)
    chosen = find_format(path, format, writable=True)
    assert chosen.write is not None
    given: dict[str, object] = {
        "sound": os.path.abspath(sound) if sound else "",
        "seconds": seconds,
        "start": start,
    }
    if digits is not None:
        given["digits"] = checked_digits(digits, chosen)
    if identity is not None:
        name = getattr(identity, "name", identity)
        check_option("identity", quoted(name), chosen)
        given["identity"] = identity
    if not len(curves):
        raise FormatError(f"there are no frames to write to {path}")
    if fps is not None:
        curves = curves.resample(fps)
    curves = shift(curves, delay, handles)
    given["start"] = start_with_handles(start, handles, curves.fps)
    if seconds is not None:
        given["seconds"] = seconds + 2 * handles / curves.fps
    curves, clipped, note = _prepared(path, curves, chosen)
    if start and "start" not in chosen.options:
        note = "; ".join(filter(None, (f"{chosen.name} has no time code: it starts at 0", note)))
    options = {name: value for name, value in given.items() if name in chosen.options}
    try:
        with atomic_write(path) as beside:
            chosen.write(beside, curves, **options)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FormatError(f"cannot write {path}: {reason}") from error
    lost = tuple(name for name in curves.tracks if name not in chosen.tracks)
    return WriteReport(path, chosen.name, len(curves), curves.fps, clipped, lost, note)


def checked_digits(digits: int, chosen: Format | None = None) -> int:
    """Digits after the point that can be written.

    Raises
    ------
    FormatError
        If there are fewer than 2 or more than 6, or the format has none.
    """
    if type(digits) is not int or not 2 <= digits <= 6:
        raise FormatError(f"digits is {quoted(digits)}; must be 2 to 6", parameter="digits")
    if chosen is not None:
        check_option("digits", digits, chosen)
    return digits


def check_option(name: str, given: object, chosen: Format) -> None:
    """Refuse an option that the writer of a format does not take.

    Raises
    ------
    FormatError
        Naming the formats that take it.
    """
    if name not in chosen.options:
        taking = ", ".join(known.name for known in FORMATS if name in known.options)
        raise FormatError(
            f"{name}={given} does not apply to {chosen.name}; it does to {taking}", parameter=name
        )


def _prepared(path: Path, curves: RigCurves, chosen: Format) -> tuple[RigCurves, ClampReport, str]:
    """Return curves clamped and in the control set that a format takes, and what that lost."""
    known = known_controls(curves.control_set)
    clipped, note = ClampReport(), ""
    if known is not None and known.id != ARKIT_ID:
        curves, clipped = clamp(curves, known)
    wanted = chosen.control_set
    if wanted is not None and curves.control_set not in chosen.also:
        curves, note = convert_and_note(curves, wanted)
    more = chosen.note(path, curves) if chosen.note else ""
    note = "; ".join(filter(None, (*curves.notes, note)))
    lost = unshown(curves, chosen.shows(), chosen.name) if chosen.shows else ""
    return curves, clipped, "; ".join(filter(None, (note, more, lost)))


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
    values = np.clip(curves.values, low, high)
    values.setflags(write=False)  # not copied again
    return replace(curves, values=values)


__all__ = [
    "FORMATS",
    "Format",
    "WriteReport",
    "check_option",
    "check_range",
    "checked_digits",
    "find_format",
    "read_curves",
    "write_curves",
]
