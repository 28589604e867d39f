"""Edges of takes: what a take has at one of its ends, read of folders, files and performances.

Pose, speeds, seconds without speech, and the traits of its character; takes that follow one
another are led from edge to edge by `deitalk.postprocess.joins`.
"""

import json
import math
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.emotions.actor import checked_traits
from deitalk.errors import DataError
from rig import RigCurves, limits
from rig.arrays import Float32, Float64
from rig.curves import HEAD
from rig.errors import listed, quoted
from rig.files.reading import load_json, read_text
from rig.formats import read_curves

FORMAT, VERSION = "deitalk-edge", 1
TAKE_CURVES, TAKE_ABOUT, TAKE_SOUND, ARCHIVE = "curves.json", "take.json", "audio.wav", ".zip"
QUIET, ENDS = "quiet_seconds", ("start", "end")
"""Entry of ``take.json``: seconds without speech at both ends."""
HANDLES = "handles_frames"
"""Entry of ``take.json``: frames that were added at both ends."""
LONGEST_QUIET = 10.0
"""Seconds without speech that a gate may depend on; more are no different."""
ROUNDING = 5


@dataclass(frozen=True)
class Edge:
    """One end of a take.

    Attributes
    ----------
    pose, speed : mapping of str to float
        Value of each control in the first or last frame, and its change in a thirtieth of a
        second, in control units; 0 of those that are absent.
    head, head_speed : tuple of float
        The same of the head, in the order of `rig.curves.HEAD`; empty: the take has no head.
    quiet : float or None
        Seconds without speech at that end; None if it is not known.
    traits : mapping of str to float
        Of the character (`deitalk.postprocess.life.character.Traits`); empty if they are not known.
    """

    pose: Mapping[str, float] = field(default_factory=dict)
    speed: Mapping[str, float] = field(default_factory=dict)
    head: tuple[float, ...] = ()
    head_speed: tuple[float, ...] = ()
    quiet: float | None = None
    traits: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of_curves(
        cls,
        curves: RigCurves,
        *,
        last: bool,
        quiet: float | None = None,
        traits: Mapping[str, float] | None = None,
    ) -> "Edge":
        """The last or the first edge of curves at any rate."""
        rows, step = curves.values, curves.fps / FRAME_RATE
        here, beside = (-1, -2) if last else (0, 1)
        beside = beside if len(curves) > 1 else here
        sign = step if last else -step

        def speed(track: Float32) -> Float64:
            return np.asarray(sign * (track[here].astype(float) - track[beside].astype(float)))

        head = curves.head
        return cls(
            _named(curves.names, rows[here]),
            _named(curves.names, speed(rows)),
            () if head is None else _rounded(head[here]),
            () if head is None else _rounded(speed(head)),
            None if quiet is None else round(min(quiet, LONGEST_QUIET), ROUNDING),
            {name: round(value, 6) for name, value in (traits or {}).items()},
        )

    @property
    def content(self) -> dict[str, Any]:
        """What a file of it holds."""
        found = {
            "pose": dict(self.pose), "speed": dict(self.speed), "head": list(self.head),
            "head_speed": list(self.head_speed), "quiet": self.quiet, "traits": dict(self.traits),
        }  # fmt: skip
        kept = {name: value for name, value in found.items() if value not in ({}, [], None)}
        return {"format": FORMAT, "version": VERSION, **kept}

    def __str__(self) -> str:
        return json.dumps(self.content)


def _named(names: Sequence[str], values: Float32 | Float64) -> dict[str, float]:
    rounded = zip(names, _rounded(values), strict=True)
    return {name: value for name, value in rounded if value}


def _rounded(values: Float32 | Float64) -> tuple[float, ...]:
    return tuple(round(float(value), ROUNDING) + 0.0 for value in values)


def edge_of(given: Any, where: str, *, last: bool) -> Edge:
    """The edge of a take folder, a file of curves, a performance, or the content of an edge.

    Parameters
    ----------
    given : Edge, mapping, path, str or Performance
        A text that begins with ``{`` is the content of an edge, any other a path.
    where : str
        Name of the field, for messages.
    last : bool
        The last edge; else the first.

    Raises
    ------
    UserError
        If there is no such take, or it cannot be read.
    """
    if isinstance(given, Edge):
        return given
    if isinstance(given, Mapping):
        return _parsed(given, where)
    if isinstance(given, str) and given.lstrip().startswith("{"):
        return _parsed(load_json(given, where, error=DataError), where)
    if isinstance(given, str | Path):
        return _read(Path(given), where, last=last)
    curves, recording = getattr(given, "curves", None), getattr(given, "recording", None)
    if isinstance(curves, RigCurves):
        quiet = None if recording is None else quiet_seconds(recording.activity, last=last)
        traits = getattr(given, "traits", None)
        return Edge.of_curves(curves, last=last, quiet=quiet, traits=traits)
    raise DataError(
        f"{where} {quoted(given)} is a {type(given).__name__}; give a take folder, a file of "
        "curves or a Performance"
    )


def quiet_seconds(activity: Float32, *, last: bool) -> float:
    """Seconds without speech at an end of a recording [shape=(T,)]; `LONGEST_QUIET` of none."""
    speaking = np.flatnonzero(np.asarray(activity) > 0.5)
    if not len(speaking):
        return LONGEST_QUIET
    frames = len(activity) - 1 - speaking[-1] if last else speaking[0]
    return float(frames) / FRAME_RATE


def _read(path: Path, where: str, *, last: bool) -> Edge:
    if not path.exists():
        raise DataError(f"{where}: there is no take {path}; name a take folder or a file of curves")
    if path.is_dir() or path.suffix.lower() == ARCHIVE:
        with opened_take(path, (TAKE_CURVES, TAKE_ABOUT)) as folder:
            return _of_take(folder, path, where, last=last)
    if path.suffix.lower() == ".json":
        text = read_text(path, limits.JSON_CURVES_BYTES, error=DataError)
        if f'"{FORMAT}"' in text[:200]:
            return _parsed(load_json(text, path, error=DataError), where)
    return Edge.of_curves(_some(read_curves(path), path), last=last)


def _of_take(folder: Path, name: Path, where: str, *, last: bool) -> Edge:
    """The edge of a take folder; `name` is for messages."""
    if not (folder / TAKE_CURVES).is_file():
        raise DataError(f"{where}: {name} is no take, it has no {TAKE_CURVES}; name another")
    curves = _some(read_curves(folder / TAKE_CURVES, control_set=None), name)
    about, content = folder / TAKE_ABOUT, None
    if about.is_file():
        content = load_json(read_text(about, limits.TRACK_JSON_BYTES, error=DataError), name)
    content = content if isinstance(content, dict) else {}
    handles = content.get(HANDLES)
    if type(handles) is int and 0 < 2 * handles < len(curves):
        curves = curves[handles:-handles]
    traits = checked_traits(name, content.get("traits", {}))
    quiet = content.get(QUIET)
    if not isinstance(quiet, list) or len(quiet) != len(ENDS):
        return Edge.of_curves(curves, last=last, traits=traits)
    ends = _numbers(dict(zip(ENDS, quiet, strict=True)), f"{name}: {QUIET}")
    seconds = max(ends[ENDS[int(last)]], 0.0)
    return Edge.of_curves(curves, last=last, quiet=seconds, traits=traits)


@contextmanager
def opened_take(path: Path, names: Sequence[str]) -> Iterator[Path]:
    """Unpack files of a zipped take for as long as they are read.

    Parameters
    ----------
    path : Path
        A zipped take, its files or their folder; any other path is given back as it is.
    names : sequence of str
        The only files that are unpacked, into a folder of their own; absent ones are left out.

    Raises
    ------
    DataError
        If it is no archive, holds several takes, or a file is larger than
        `rig.limits.JSON_CURVES_BYTES`.
    """
    if path.suffix.lower() != ARCHIVE or path.is_dir():
        yield path
        return
    with TemporaryDirectory(prefix="deitalk-take-") as made:
        folder = Path(made)
        try:
            with zipfile.ZipFile(path) as archive:
                entries = {entry: PurePosixPath(entry) for entry in archive.namelist()}
                takes = sorted({e.parent for e in entries.values() if e.name == TAKE_CURVES})
                top = min((len(take.parts) for take in takes), default=0)
                takes = [take for take in takes if len(take.parts) == top]
                if len(takes) > 1:
                    raise DataError(
                        f"{path} holds {len(takes)} takes: {listed(takes)}; zip the one that is "
                        "meant, or name its folder"
                    )
                for entry, inside in entries.items():
                    if inside.name not in names or inside.parent not in takes:
                        continue
                    with archive.open(entry) as file:
                        data = file.read(limits.JSON_CURVES_BYTES + 1)
                    if len(data) > limits.JSON_CURVES_BYTES:
                        raise DataError(f"{path}: {entry} is too large; name a take folder")
                    (folder / inside.name).write_bytes(data)
        except (
            zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError
        ) as error:  # fmt: skip
            raise DataError(f"{path}: no zipped take ({error}); name a take folder") from None
        yield folder


def _some(curves: RigCurves, path: Path) -> RigCurves:
    if not len(curves):
        raise DataError(f"{path} has no frames to begin or end with; name another take")
    return curves


def _parsed(content: Any, where: str) -> Edge:
    """An edge of its content."""
    rule = "is no edge of a take; name the take folder"
    if not isinstance(content, Mapping) or content.get("format") != FORMAT:
        raise DataError(f"{where} {quoted(str(content))} {rule}")
    if content.get("version") != VERSION:
        raise DataError(f"{where}: version {quoted(content.get('version'))} is not {VERSION}")
    head, head_speed = (_row(content.get(n, []), f"{where}: {n}") for n in ("head", "head_speed"))
    if len(head) != len(head_speed):
        raise DataError(f"{where}: head without head_speed, or the reverse; give both or none")
    pose, speed = (_numbers(content.get(n, {}), f"{where}: {n}") for n in ("pose", "speed"))
    traits = checked_traits(where, content.get("traits", {}))
    quiet = content.get("quiet")
    if quiet is not None:
        quiet = _numbers({"quiet": quiet}, where)["quiet"]
        if not 0 <= quiet <= LONGEST_QUIET:
            raise DataError(f"{where}: quiet {quiet:g} must be 0 to {LONGEST_QUIET:g} seconds")
    return Edge(pose, speed, head, head_speed, quiet, traits)


def _row(values: Any, where: str) -> tuple[float, ...]:
    """Numbers of a head; none are given where the take has none."""
    if not isinstance(values, list | tuple) or len(values) not in (0, len(HEAD)):
        raise DataError(f"{where} {quoted(str(values))} must be {len(HEAD)} numbers, or none")
    return tuple(_numbers(dict(zip(HEAD, values, strict=False)), where).values())


def _numbers(values: Any, where: str) -> dict[Any, float]:
    if not isinstance(values, Mapping):
        raise DataError(f"{where} {quoted(values)} must be an object of names and numbers")
    for name, value in values.items():
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not math.isfinite(value) or abs(value) > 1e3:
            raise DataError(f"{where}: {name} is {quoted(value)}; it must be a finite number")
    return {name: float(value) for name, value in values.items()}
