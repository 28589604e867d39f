"""Live Link Face CSV, recorded by the iPhone app and imported by Unreal, Blender and Maya.

Columns are ``Timecode, BlendshapeCount`` and 61 ARKit names; a row is a frame. The time code
``HH:MM:SS:FF.mmm`` counts **sixtieths of a second whatever the rate** (``.mmm`` are thousandths of
a sixtieth), except that a file in which FF never exceeds 30.0 counts thirtieths: the app does so at
30 fps, and Unreal's importer (since August 2023) takes its rate from that. A file in sixtieths that
ends within half a second would be read at half speed, so `write_take` holds its last frame until FF
exceeds 30. Other programs count 24, 25, 48, 50 or 120 frames, or drop frame: the ends of the
seconds show it (`rig.curves.timecode`). A row that counts no shapes, or has empty cells alone, is a
time without a face.

A recorded take has its own, slightly uneven times, so it is kept as `LiveLinkTake` with its time
codes to the last digit; `to_curves` puts it on an even grid.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Bool, Float32, Float64, Int64
from rig.controls import ControlSet, check_unique
from rig.conversion.arkit import ARKIT_ID, arkit_controls
from rig.conversion.raw import PREFIX, RAW_ID, raw_controls
from rig.curves import HEAD, RigCurves, snap_fps
from rig.curves.rig_curves import STANDARD_RATES
from rig.curves.timecode import TICKS_PER_SECOND, Clock, read_timecodes
from rig.errors import CurveError, FormatError
from rig.formats.decimal_text import Block, Text, rows
from rig.formats.even_grid import grid_over, seen_of, usual_steps
from rig.formats.wide_csv import read_layout, read_numbers
from rig.unreal.deitalk_clip import VERSIONS, head_curves, head_of_curves, subject_of

DECIMALS = 10
ENDINGS = ("_cal", "_raw", "_neutral")
"""Ends of file names that the importer leaves out of the subject."""
SUFFIXES = ("livelink", "livelink-raw")
"""Endings before ``.csv`` that name our format; Unreal keeps them."""
SUBJECT_REST = (
    "HeadControlSwitch", "HeadRoll", "HeadPitch", "HeadYaw", "HeadTranslationX",
    "HeadTranslationY", "HeadTranslationZ", "MHFDSVersion", "DisableFaceOverride",
)  # fmt: skip
"""Properties after the raw curves of every MetaHuman subject since Unreal 5.6, in their order
(LiveLinkFaceSource.cpp): degrees in the axes of the head's bone (up, forward, right), first about
the upright one; cm back, left and up."""
COUNT = "BlendshapeCount"
"""Second column. Unreal ignores case; other readers want the spelling of the app since 2024."""


@dataclass(frozen=True, eq=False)
class LiveLinkTake:
    """A recorded take with its own times.

    Parameters
    ----------
    ticks : array of int64 [shape=(T,)]
        Time of each frame in 1/60000 s since midnight; rising.
    values : array of float64, or float32 [shape=(T, C)]
        As in the file, not clamped.
    names : tuple of str [length C]
        Columns after the time code and the count.
    count_column : str
        Spelling of the second column.
    faces : array of bool [shape=(T,)], optional
        Rows with a face; None: all. The others have values on straight lines.
    notes : tuple of str
        What was told of the time codes, a line each.
    """

    ticks: Int64
    values: Float64 | Float32
    names: tuple[str, ...]
    count_column: str = COUNT
    faces: Bool | None = None
    notes: tuple[str, ...] = ()

    @property
    def fps(self) -> float:
        """Frames per second, of the steps near the median one: a standard rate within .03 %."""
        if len(self.ticks) < 2:
            return 30.0
        steps = np.diff(self.ticks)
        mean = float(usual_steps(steps).mean())
        for exact in (TICKS_PER_SECOND / mean, TICKS_PER_SECOND / float(np.median(steps))):
            for standard in STANDARD_RATES:
                if abs(exact - standard) < 3e-4 * standard:
                    return standard
        return snap_fps(TICKS_PER_SECOND / mean)

    def to_curves(self, fps: float | None = None) -> RigCurves:
        """Put the take on an even grid, linear between frames, starting with its first frame.

        ARKit names give curves of ``arkit-61``, raw names of the raw curves; further columns are
        left out.

        Raises
        ------
        FormatError
            If the columns are neither, or most of the take's time has no frame.
        CurveError
            If there are more frames than `limits.FRAMES`.
        """
        controls = _controls_of(self.names)
        places = {controls.canonical(n): i for i, n in enumerate(self.names) if n in controls}
        names = tuple(name for name in controls.names if name in places)
        fps = snap_fps(fps or self.fps)
        seconds = (self.ticks - self.ticks[0]) / TICKS_PER_SECOND
        grid = grid_over(seconds, fps, len(controls), "the take")
        values = np.empty((len(grid), len(names)), np.float32)
        for column, name in enumerate(names):
            with np.errstate(over="ignore", invalid="ignore"):  # named by RigCurves
                values[:, column] = np.interp(grid, seconds, self.values[:, places[name]])
        values.setflags(write=False)  # not copied again
        curves = RigCurves(values, names, fps, control_set=controls.id, notes=self.notes)
        curves = curves.reorder(controls)
        if controls.id != RAW_ID:
            return curves
        columns = {
            name: np.interp(grid, seconds, self.values[:, self.names.index(name)])
            for name in SUBJECT_REST
            if name in self.names
        }
        return replace(curves, head=subject_head(columns))

    def seen(self, curves: RigCurves) -> Bool:
        """Frames of `to_curves` that were captured [shape=(F,)]: not in a gap of over a second."""
        seconds = (self.ticks - self.ticks[0]) / TICKS_PER_SECOND
        known = seconds if self.faces is None else seconds[self.faces]
        return seen_of(curves.times, known, curves.fps)


def read_take(path: Path) -> LiveLinkTake:
    """Read a take with its own times.

    Raises
    ------
    FormatError
        If the first columns are not ``Timecode`` and ``BlendShapeCount``, a time code is malformed
        or does not rise, or a cell is no finite number.
    """
    layout = read_layout(path)
    header = layout.header
    if [cell.lower() for cell in header[:2]] != ["timecode", COUNT.lower()] or len(header) < 3:
        raise FormatError(
            f"{path} begins with {', '.join(header[:2])[:80]!r}; a Live Link Face CSV begins with "
            f"'Timecode,{COUNT}' and has a column per curve"
        )
    names = header[2:]
    check_unique(names, where=str(path))
    columns = range(2, len(header))
    numbers, (timecodes,) = read_numbers(path, layout, text_columns=(0,), face=columns, count=1)
    clock = read_timecodes(timecodes, path)
    still = np.diff(clock.ticks) <= 0
    if still.any():
        row = int(np.argmax(still)) + 2
        raise FormatError(
            f"{path}: data row {row} has time code {timecodes[row - 1]}, not after the one before"
        )
    faces = ~np.isnan(numbers[:, 1:]).any(axis=1) & (numbers[:, 0] != 0)
    if not faces.any():
        raise FormatError(f"{path}: no row has a face; {COUNT} is 0, or every cell empty")
    values = numbers[:, 1:]
    if not faces.all():
        known, at = values[faces], clock.ticks[faces]
        values = np.stack([np.interp(clock.ticks, at, column) for column in known.T], axis=1)
    notes = _clock_notes(clock)
    if faces.all():
        return LiveLinkTake(clock.ticks, values, names, header[1], None, notes)
    lost = f"{int((~faces).sum())} of {len(faces)} rows are without a face"
    return LiveLinkTake(clock.ticks, values, names, header[1], faces, (*notes, lost))


def _clock_notes(clock: Clock) -> tuple[str, ...]:
    """Lines on a frame field that is not the app's, or whose count is not certain."""
    if clock.is_drop:
        return (f"drop-frame time codes of {clock.count * 1000 / 1001:.2f} Hz",)
    if clock.count not in (30, 60):
        return (f"time codes count {clock.count} frames a second",)
    if clock.is_certain or len(clock.ticks) < 2 or (clock.ticks % TICKS_PER_SECOND == 0).all():
        return ()
    if clock.count != 30:
        return ()
    return ("time codes end within a second: FF is taken to count 30 a second",)


def write_take(path: Path, take: LiveLinkTake) -> None:
    """Write a take, ten decimals, one row per frame, and `padding` after them."""
    held = padding(take.ticks)
    ticks = np.concatenate([take.ticks, held])
    values = take.values
    if len(held):
        values = np.concatenate([values, np.repeat(values[-1:], len(held), axis=0)])
    n_curves = np.full((len(ticks), 1), len(take.names))
    blocks: list[Block | Text] = [
        Text(timecode_text(ticks)),
        Block(n_curves, 0),
        Block(values, DECIMALS, trim=False),
    ]
    with path.open("wb") as stream:
        stream.write(",".join(("Timecode", take.count_column, *take.names)).encode() + b"\n")
        stream.writelines(rows(blocks))


def padding(ticks: Int64) -> Int64:
    """Return the times of rows that hold the last frame, so that FF exceeds 30; usually none.

    Without them the sixtieths of a take that ends within half a second are read as thirtieths.
    """
    none: Int64 = np.empty(0, np.int64)
    latest = int((ticks % TICKS_PER_SECOND).max(initial=0))
    if not 0 < latest <= TICKS_PER_SECOND // 2:  # FF exceeds 30.0, or is always 0
        return none
    step = int(np.median(np.diff(ticks))) if len(ticks) > 1 else 2000
    more = ticks[-1] + step * np.arange(1, TICKS_PER_SECOND // 1000 + 1)
    over = more % TICKS_PER_SECOND > TICKS_PER_SECOND // 2
    if not over.any():  # of two frames a second
        return ticks[-1:] // TICKS_PER_SECOND * TICKS_PER_SECOND + TICKS_PER_SECOND // 2 + 1000
    return np.asarray(more[: int(np.argmax(over)) + 1], np.int64)


def notes(path: Path, curves: RigCurves) -> str:
    """Return notes on a file: its padding, and a subject that its suffix changes."""
    n_held = len(padding(frame_ticks(len(curves), curves.fps)))
    held = (
        f"the last frame is held for {n_held} more rows: Unreal plays a Live Link CSV that ends "
        "within half a second at half speed"
    )
    return "; ".join(filter(None, (held if n_held else "", suffix_note(path))))


def suffix_note(path: Path) -> str:
    """Return a line on a name with a second suffix, which becomes part of Unreal's subject."""
    stem, point, suffix = path.stem.rpartition(".")
    if not point or suffix.lower() not in SUFFIXES:
        return ""
    return (
        f"Unreal makes the subject {subject_of(path.name)!r} of this name: call the file "
        f"{stem}_cal.csv for {subject_of(stem + '_cal.csv')!r}"
    )


def read(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read a take onto an even grid, with straight lines where there is no frame."""
    take = read_take(path)
    curves = take.to_curves(fps)
    seconds = float((~take.seen(curves)).sum()) / curves.fps
    gap = (f"{seconds:.1f} s without a frame: straight lines",) if seconds else ()
    return replace(curves, notes=(*curves.notes, *gap))


def write(path: Path, curves: RigCurves, start: float = 0.0) -> None:
    """Write ARKit shapes, or raw curves as a MetaHuman subject has them, from a time of day (s)."""
    if curves.control_set == RAW_ID:
        curves = with_subject(curves)
    ticks = frame_ticks(len(curves), curves.fps) + round(start * TICKS_PER_SECOND)
    write_take(path, LiveLinkTake(ticks, curves.values, curves.names))


def with_subject(curves: RigCurves) -> RigCurves:
    """Raw curves with `SUBJECT_REST` as columns: switch and turn of the head, and constants."""
    track = None if curves.head is None else dict(zip(HEAD, curves.head.T.tolist(), strict=True))
    moved = VERSIONS | head_curves(track)
    rest = np.zeros((len(curves), len(SUBJECT_REST)), np.float32)
    for place, name in enumerate(SUBJECT_REST):
        rest[:, place] = moved.get(name, 0.0)
    values = np.column_stack([curves.values, rest])
    return replace(curves, values=values, names=(*curves.names, *SUBJECT_REST))


def subject_head(columns: Mapping[str, Float64]) -> Float32 | None:
    """The head track [shape=(T, 6)] of columns of `SUBJECT_REST`; None unless the switch is on."""
    if any(name not in columns for name in SUBJECT_REST[:7]) or not columns[SUBJECT_REST[0]].any():
        return None
    track = head_of_curves({name: column.tolist() for name, column in columns.items()})
    return np.column_stack([track[name] for name in HEAD]).astype(np.float32)


def frame_ticks(n_frames: int, fps: float) -> Int64:
    """Return the ticks of evenly spaced frames: 2000 apart at 30 fps, 2002 at 29.97."""
    ticks = np.rint(np.arange(n_frames) * (TICKS_PER_SECOND / fps))
    return np.asarray(ticks, dtype=np.int64)


def timecode_text(ticks: Int64) -> NDArray[np.uint8]:
    """Return ``HH:MM:SS:FF.mmm`` as characters [shape=(T, 15)]."""
    text = np.tile(np.frombuffer(b"00:00:00:00.000", np.uint8), (len(ticks), 1))
    sixtieths = ticks // 1000
    fields = (
        (0, sixtieths // 216_000 % 24, 2),
        (3, sixtieths // 3600 % 60, 2),
        (6, sixtieths // 60 % 60, 2),
        (9, sixtieths % 60, 2),
        (12, ticks % 1000, 3),
    )
    for start, number, width in fields:
        for place in range(start + width - 1, start - 1, -1):
            text[:, place] = number % 10 + ord("0")
            number = number // 10
    return text


def take_name(slate: str, take: int, subject: str) -> str:
    """Return a name whose subject the importer takes, ``<Slate>_take_<Take>_<Subject>.csv``.

    Raises
    ------
    CurveError
        If a part is empty, or the importer would take another subject.
    """
    name = f"{slate}_take_{take}_{subject}.csv"
    if not slate or not subject or take < 0 or subject_of(name) != subject:
        raise CurveError(
            f"slate {slate!r}, take {take}, subject {subject!r}: none may be empty, the slate may "
            f"hold no number between underscores, the subject may not end in {', '.join(ENDINGS)}"
        )
    return name


def _controls_of(names: tuple[str, ...]) -> ControlSet:
    raw_names = sum(name.startswith(PREFIX) for name in names)
    controls = raw_controls() if raw_names > len(names) / 2 else arkit_controls()
    if not any(name in controls for name in names):
        raise FormatError(
            f"none of the columns {', '.join(names[:3])}, … is an ARKit shape or a raw curve "
            f"({ARKIT_ID}, {RAW_ID})"
        )
    return controls
