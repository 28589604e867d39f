"""One file of a capture to board channels, with those that its source determines.

Whatever a source has no column for is not known: zeros in its place are no measurement.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from deitalk.audio.load import Recording
from deitalk.data.captures.columns import RigMapping
from deitalk.errors import DataError, MissingError
from deitalk.installed import imported
from rig import ControlSet, RigCurves, default_controls, read_curves
from rig.arrays import Bool
from rig.controls import DEFAULT_ID
from rig.conversion.arkit import ARKIT_ID, N_SHAPES, arkit_to_raw
from rig.conversion.convert import KNOWN, convert, reached_controls
from rig.conversion.raw import RAW_ID
from rig.curves.edit import clamp
from rig.curves.timecode import TICKS_PER_SECOND
from rig.errors import UserError
from rig.files.reading import open_file, read_npz
from rig.formats import emoface_txt, livelink_csv, unreal_json
from rig.formats.curves_csv import describe_columns, known_columns
from rig.formats.named import NamedCurves, is_count, is_face_cap, is_time, read_named
from rig.formats.table import format_of_header
from rig.formats.units import in_units
from rig.formats.wide_csv import read_header
from rig.limits import JSON_CURVES_BYTES

READERS: dict[str, str] = {}
"""``module:function`` of readers of kinds of captures that other packages add."""
VIDEOS = (".mp4", ".mov", ".m4v", ".webm", ".mkv")
LEAST_JAW = 0.03
"""`arkit_to_raw`'s: lips-together passes .9 in 8 % of the frames of a range-of-motion take, and in
61 % by Unreal's rule."""
OWN_SCHEMA = b"deitalk.curves/1"
JSON_MARKS = (b"eights", b"hapes", b"facsNames", b"ategory")
"""Text at the beginning of a JSON file of curves: weights, blend shapes, categories."""
LEAST_KNOWN = 3
"""Columns of a known name that make a table a capture, or all that it has."""
DAY = 24 * 3600.0
LEAST_SECONDS = 0.5
"""Least length of curves and sound of a take."""


@dataclass(frozen=True, eq=False)
class CapturedCurves:
    """A capture as board channels, or as controls of another rig."""

    curves: RigCurves
    known: tuple[str, ...]
    """Controls that the source can know."""
    kind: str
    """livelink, arkit, board, raw, emoface, mapped, unreal, video or rig."""
    audio: str = ""
    """Name of the recording, where the file has one."""
    notes: tuple[str, ...] = ()
    seen: Bool | None = None
    """Frames that were captured [shape=(T,)]; None: all."""
    start: float | None = None
    """Time of day of the first frame, seconds, by the take's time codes; None without."""
    shapes: RigCurves | None = None
    """ARKit shapes of the source, those that it has; None of other controls."""
    first: float = 0.0
    """Time of the first frame by the file's own times, seconds."""

    def around(self, first: int, last: int, margin: int) -> slice:
        """Frames from first to last (excluded) and a margin on both sides, as far as captured."""
        start, stop = max(first - margin, 0), min(last + margin, len(self.curves))
        if self.seen is None:
            return slice(start, stop)
        lost = np.flatnonzero(~self.seen)
        start = max([start, *(lost[lost < first] + 1).tolist()])
        return slice(start, min([stop, *lost[lost >= last].tolist()]))


def read_capture(
    path: Path,
    *,
    mapping: RigMapping | None = None,
    rig: ControlSet | None = None,
    fps: float | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> CapturedCurves:
    """Read a file of captured curves: the face of a take as channels of the board, or of a rig.

    Parameters
    ----------
    path : Path
        Live Link Face, board, raw, ARKit or Audio2Face CSV; JSON and NPZ of curves;
        what the script inside Unreal exports; EmoFace text; a video of a face, or the landmarks
        measured on one; with `mapping` any table of curves.
    mapping : RigMapping or None
        Of another rig's curves to the board.
    rig : ControlSet or None
        Another rig, whose curves stay as they are.
    fps : float or None
        Of files without a rate.
    progress : callable
        Given the share of a video that is read.

    Raises
    ------
    DataError, rig.errors.RigError
        One line: what is wrong with the file and where.
    MissingError
        For a video without MediaPipe.
    """
    if rig is not None:
        return _of_rig(path, rig, fps)
    if mapping is not None:
        named = read_named(path, otherwise=fps)
        unused = [name for name in named.names if name not in mapping.sources]
        notes = [f"{len(unused)} columns are in no row of the map: {describe_columns(unused)}"]
        found = _from_set(
            path,
            mapping.apply(named, path),
            "mapped",
            present=mapping.targets,
            notes=tuple(notes if unused else ()),
        )
        return _seen(replace(found, start=named.start), named.seen)
    kind = kind_of(path)
    if kind == "livelink":
        take = livelink_csv.read_take(path)
        curves = take.to_curves()
        controls = KNOWN[curves.control_set]()
        present, said = _columns(path, take.names, controls)
        captured = _from_set(path, curves, "livelink", present=present, notes=said)
        captured = replace(captured, start=float(take.ticks[0]) / TICKS_PER_SECOND)
        return _seen(captured, take.seen(curves))
    if kind == "video":
        if kind not in READERS:
            raise MissingError(
                f"{path}: videos are read by a checkout of the repository; see docs/finetuning.md"
            )
        filmed: CapturedCurves = imported(READERS[kind])(path, progress)
        return filmed
    if kind == "emoface":
        curves = read_curves(path, fps=fps)
        return CapturedCurves(curves, emoface_txt.columns(), "emoface", notes=curves.notes)
    if kind == "unreal":
        curves, audio = unreal_json.read_present(path)
        return _from_set(path, curves, kind, audio=audio)
    if kind == "curves":
        curves = read_curves(path, fps=fps, control_set=None)
        return _from_set(path, curves, _kind_of_set(curves.control_set))
    return _table(path, read_named(path, otherwise=fps))


def paired(capture: CapturedCurves, sound: Recording) -> tuple[CapturedCurves, Recording]:
    """Lay curves and sound together by the time codes of both, and cut what one of them lacks.

    Time codes of one clock (jam sync) overlap. Where they do not, or one has none, both begin
    together.

    Returns
    -------
    capture : CapturedCurves
        With a note on what was done.
    sound : Recording
        Begins with the first frame of the curves.
    """
    if capture.start is None or sound.start is None:
        return capture, sound
    curves = capture.curves
    late = (capture.start - sound.start + DAY / 2) % DAY - DAY / 2
    codes = f"sound {_clock(sound.start)}, curves {_clock(capture.start)}"
    if min(sound.duration, late + curves.duration) - max(late, 0.0) < LEAST_SECONDS:
        note = f"time codes do not overlap ({codes}): not of one clock, laid together at the start"
        return replace(capture, notes=(*capture.notes, note)), sound
    if abs(late) < 0.5 / curves.fps:
        return capture, sound
    early = max(math.ceil(-late * curves.fps - 1e-6), 0)
    before = late + early / curves.fps
    seconds = min(sound.duration - before, (len(curves) - early) / curves.fps)
    frames = slice(early, early + math.ceil(seconds * curves.fps - 1e-6))
    first = round(before * sound.sample_rate)
    last = first + round(seconds * sound.sample_rate)
    outside = {
        "sound": sound.duration - seconds,
        "curves": curves.duration - (frames.stop - frames.start) / curves.fps,
    }
    cut = " and ".join(
        f"{t:.2f} s of {what}" for what, t in outside.items() if t > 0.5 / curves.fps
    )
    note = f"paired by time code ({codes}): {cut or 'nothing'} outside both, cut"
    taken = replace(
        capture,
        curves=curves.slice_frames(frames.start, frames.stop),
        seen=None if capture.seen is None else capture.seen[frames],
        notes=(*capture.notes, note),
        start=capture.start + early / curves.fps,
    )
    return taken, replace(sound, waveform=sound.waveform[first:last], start=sound.start + before)


def _clock(seconds: float) -> str:
    whole = round(seconds % DAY, 2)
    return f"{int(whole // 3600):02d}:{int(whole // 60 % 60):02d}:{whole % 60:05.2f}"


def kind_of(path: Path) -> str | None:
    """Return how a file of curves is read; None if it holds no curves that are known.

    Names of columns are not compared for JSON and NPZ.
    """
    suffix = path.suffix.lower()
    if suffix in VIDEOS:
        return "video"
    if suffix == ".txt":
        if is_face_cap(path):
            return "table"
        with open_file(path, JSON_CURVES_BYTES) as stream:
            columns = stream.readline(1 << 16).count(b",") + 1
        if columns == len(emoface_txt.columns()):
            return "emoface"
    if suffix in (".csv", ".tsv", ".txt"):
        header = read_header(path)
        form = format_of_header(header)
        if form == "livelink" or [c.lower() for c in header[:2]] == ["timecode", "blendshapecount"]:
            return "livelink"
        return "table" if form == "a2f" or _are_known(header) else None
    if suffix == ".json":
        with open_file(path, JSON_CURVES_BYTES) as stream:
            head = stream.read(4096).replace(b"\0", b"")  # of UTF-16
        if any(schema.encode() in head for schema in unreal_json.SCHEMAS):
            return "unreal"
        known = "table" if any(mark in head for mark in JSON_MARKS) else None
        return "curves" if OWN_SCHEMA in head else known
    if suffix == ".npz":
        data = read_npz(path)
        return "video" if "landmarks" in data else "curves" if "schema" in data else "table"
    return None


def _are_known(header: Sequence[str]) -> bool:
    curves = [name for name in header if not (is_time(name) or is_count(name))]
    return bool(curves) and _best_set(curves)[1] >= min(LEAST_KNOWN, len(curves))


def _seen(captured: CapturedCurves, seen: Bool | None) -> CapturedCurves:
    """The capture with the frames that were captured, and a note on the others."""
    if seen is None or seen.all():
        return captured
    seconds = float((~seen).sum()) / captured.curves.fps
    lost = f"{seconds:.1f} s without a frame, left out"
    return replace(captured, seen=seen, notes=(*captured.notes, lost))


def _table(path: Path, curves: NamedCurves) -> CapturedCurves:
    control_set, count = _best_set(curves.names)
    if count < min(LEAST_KNOWN, len(curves.names)):
        raise DataError(
            f"{path}: {describe_columns(curves.names)} are no controls of MetaHuman or ARKit; "
            "give `mapping`, a table of target, source, weight, offset",
            parameter="mapping",
        )
    controls = KNOWN[control_set]()
    present, notes = _columns(path, curves.names, controls)
    canonical = dict(zip(present, controls.resolve(present), strict=True))
    captured = curves.to_curves(canonical, control_set)
    if control_set == RAW_ID:
        rest = {name: curves[name] for name in livelink_csv.SUBJECT_REST if name in curves.names}
        captured = replace(captured, head=livelink_csv.subject_head(rest))
    found = _from_set(path, captured, _kind_of_set(control_set), present=present, notes=notes)
    return _seen(replace(found, start=curves.start, first=curves.first), curves.seen)


def _of_rig(path: Path, rig: ControlSet, fps: float | None) -> CapturedCurves:
    """Controls of another rig; those that the file lacks rest and are not known."""
    named = _of_known(path, rig, fps)
    present = [name for name in named.names if name in rig]
    if not present:
        raise DataError(
            f"{path}: {describe_columns(named.names)} are no controls of {rig.id}; "
            "mend the rig file"
        )
    canonical = dict(zip(present, rig.resolve(present), strict=True))
    curves = in_units(named.to_curves(canonical, rig.id), rig, path)
    curves, clipped = clamp(curves.reorder(rig), rig)
    notes = list(curves.notes)
    if missing := rig.missing(present):
        notes.append(f"lacks {len(missing)} controls, not known: {describe_columns(missing)}")
    if left := [name for name in named.names if name not in rig]:
        notes.append(f"{len(left)} columns are left out: {describe_columns(left)}")
    if clipped:
        notes.append(str(clipped))
    known = tuple(name for name in rig.names if name in set(canonical.values()))
    found = CapturedCurves(curves, known, "rig", notes=tuple(notes), start=named.start)
    return _seen(found, named.seen)


def _of_known(path: Path, rig: ControlSet, fps: float | None) -> NamedCurves:
    """Columns of a table; also of a Live Link Face CSV, on the take's own clock."""
    try:
        is_live_link = kind_of(path) == "livelink"
    except UserError:
        is_live_link = False
    if not is_live_link:
        return read_named(path, otherwise=fps, curves=rig)
    take = livelink_csv.read_take(path)
    curves = take.to_curves()
    start, seen = float(take.ticks[0]) / TICKS_PER_SECOND, take.seen(curves)
    return NamedCurves(
        curves.names, curves.values.astype(np.float64), curves.fps, curves.notes, seen, start
    )


def _from_set(
    path: Path,
    curves: RigCurves,
    kind: str,
    *,
    present: Sequence[str] | None = None,
    audio: str = "",
    notes: tuple[str, ...] = (),
) -> CapturedCurves:
    """Board channels within their ranges, and those that the present columns reach."""
    if curves.control_set not in KNOWN:
        raise DataError(
            f"{path}: control set {curves.control_set!r} has no way to the board; give `mapping`",
            parameter="mapping",
        )
    curves = in_units(curves, KNOWN[curves.control_set](), path)
    notes, shapes = (*curves.notes, *notes), None
    known = reached_controls(curves.names if present is None else present, curves.control_set)
    if curves.control_set == ARKIT_ID:
        shapes, beyond = clamp(curves, KNOWN[ARKIT_ID]())
        notes = (*notes, *([str(beyond)] if beyond else ()))
        curves = arkit_to_raw(curves, least_jaw=LEAST_JAW)
    board, clipped = clamp(convert(curves, DEFAULT_ID).reorder(default_controls()))
    if clipped:
        notes = (*notes, str(clipped))
    if not np.ptp(board.values, axis=0).any():
        notes = (*notes, "nothing moves")
    if shapes is not None and present is not None:
        shapes = shapes.select(KNOWN[ARKIT_ID]().resolve(list(present)))
    return CapturedCurves(board, known, kind, audio, notes, shapes=shapes)


def _columns(
    path: Path, names: Sequence[str], controls: ControlSet
) -> tuple[list[str], tuple[str, ...]]:
    """Columns that are controls, and notes about those that are absent or left over."""
    wanted = controls.names[:N_SHAPES] if controls.id == ARKIT_ID else controls.names
    of_head = livelink_csv.SUBJECT_REST if controls.id == RAW_ID else ()
    present, notes = known_columns(path, names, controls, wanted, of_head)
    return present, tuple(notes)


def _best_set(names: Sequence[str]) -> tuple[str, int]:
    """The known set with most of some names, and how many; prefixes of Audio2Face are ignored."""
    plain = [name.removeprefix("blendShapes.") for name in names]
    counts = {
        key: sum(bool(name) and name in make() for name in plain) for key, make in KNOWN.items()
    }
    best = max(counts, key=lambda key: counts[key])
    return best, counts[best]


def _kind_of_set(control_set: str) -> str:
    return {DEFAULT_ID: "board", RAW_ID: "raw", ARKIT_ID: "arkit"}.get(control_set, "foreign")
