"""Takes that follow one another: the edges of a take, and curves that are led from one to the next.

An `Edge` is what a take has at one of its ends: pose, speeds, seconds without speech, and the
traits of its character. A take that follows another begins in the pose and at the speeds of that
edge and passes to its own motion; one that leads into another ends so. Curves are mixed, not
shifted, so that values stay in their ranges, and a contact of the lips is met as soon as it is
slow enough.

Letters: T frames at 30 per second, C controls.
"""

import json
import math
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.emotions.actor import checked_traits
from deitalk.errors import DataError
from deitalk.postprocess.control_groups import ControlGroups
from rig import ControlSet, RigCurves, limits
from rig.arrays import Bool, Float32, Float64
from rig.curves import HEAD
from rig.errors import quoted
from rig.files.reading import load_json, read_text
from rig.formats import read_curves

FORMAT, VERSION = "deitalk-edge", 1
TAKE_CURVES, TAKE_ABOUT, TAKE_SOUND, ARCHIVE = "curves.json", "take.json", "audio.wav", ".zip"
QUIET, ENDS = "quiet_seconds", ("start", "end")
"""Entry of ``take.json``: seconds without speech at both ends."""
HANDLES = "handles_frames"
"""Entry of ``take.json``: frames that were added at both ends."""
MOUTH_FRAMES, LIDS_FRAMES, FACE_FRAMES = 6, 6, 15
"""Frames in which the mouth, the lids, and brows, cheeks and corners pass into their own motion."""
HEAD_FRAMES, MOST_HEAD_FRAMES, FRAMES_A_DEGREE = 30, 90, 3
"""Frames of the head and of the eyes, which turn against it: more for a larger difference, so that
the head turns by half a degree in a frame at most."""
COASTING = 2.0
"""Time constant in frames of a speed that is left alone: a motion goes on by twice its step."""
CONTACT_FRAMES = 4
"""Frames over which contacts of the lips gain their full weight."""
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
        Of the character (`deitalk.postprocess.life.voice.Traits`); empty if they are not known.
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
        A zipped take; any other path is given back as it is.
    names : sequence of str
        The only files that are unpacked, into a folder of their own; absent ones are left out.

    Raises
    ------
    DataError
        If it is no archive, or a file is larger than `rig.limits.JSON_CURVES_BYTES`.
    """
    if path.suffix.lower() != ARCHIVE or path.is_dir():
        yield path
        return
    with TemporaryDirectory(prefix="deitalk-take-") as made:
        folder = Path(made)
        try:
            with zipfile.ZipFile(path) as archive:
                for name in set(names) & set(archive.namelist()):
                    with archive.open(name) as file:
                        data = file.read(limits.JSON_CURVES_BYTES + 1)
                    if len(data) > limits.JSON_CURVES_BYTES:
                        raise DataError(f"{path}: {name} is too large; name a take folder")
                    (folder / name).write_bytes(data)
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


# Curves that begin or end at an edge.


def lead(
    values: Float32,
    head: Float32 | None,
    controls: ControlSet,
    edge: Edge,
    *,
    last: bool = False,
    most: int | None = None,
) -> None:
    """Have curves begin at the edge of the take before, or end at that of the take after.

    Parameters
    ----------
    values : array [shape=(T, C)]
        Changed in place, but for frames beyond those of the passage.
    head : array [shape=(T, 6)], optional
        Track of the head, changed in place.
    controls : ControlSet
        Of the columns.
    edge : Edge
        Of the other take.
    last : bool
        The curves end at the edge; else they begin there.
    most : int, optional
        Most frames of the passage; by default all but one, so that the other end stays.
    """
    most = len(values) - 1 if most is None else min(most, len(values) - 1)
    if most < 1:
        return
    if last:
        values, head = values[::-1], None if head is None else head[::-1]
    passage = Passage.of(controls, edge, None if head is None else head[0], most, last=last)
    passage.mix(values, head)


def _coasting(frames: Any) -> Float64:
    """Frames' worth of a speed that frames beside an edge have gone on by [shape=(n, 1)]."""
    gone: Float64 = COASTING * (1 - np.exp(-(frames + 1) / COASTING))
    return gone[:, None]


def _shares(frames: Any, lengths: Any, held: Any = 0) -> Float64:
    """Share of the own motion in frames beside an edge [shape=(n, C)]."""
    part = np.clip((frames[:, None] + 1 - held) / (np.atleast_1d(lengths) + 1), 0, 1)
    share: Float64 = part * part * (3 - 2 * part)
    return share


@dataclass(frozen=True)
class Passage:
    """From an edge to the own motion of a take, of consecutive frames.

    Attributes
    ----------
    controls : ControlSet
        Of the columns.
    pose, speed : array [shape=(C,)]
        Of the edge, in the direction of the frames.
    head, head_speed : array [shape=(6,)], or None without a head
    lengths : array [shape=(C,)]
        Frames in which each control passes.
    head_length : int
        The same of the head.
    held : array [shape=(C,)] or int
        Frames for which each control stays at the edge before it passes.
    """

    controls: ControlSet
    pose: Float64
    speed: Float64
    head: Float64 | None
    head_speed: Float64 | None
    lengths: Any
    head_length: int
    held: Any = 0

    @classmethod
    def of(
        cls,
        controls: ControlSet,
        edge: Edge,
        head: Float32 | None,
        most: int,
        *,
        last: bool = False,
        mouth: int = MOUTH_FRAMES,
        held: int = 0,
    ) -> "Passage":
        """The passage from an edge to a take.

        Parameters
        ----------
        controls : ControlSet
            Of the take.
        edge : Edge
            Where the passage begins.
        head : array [shape=(6,)], optional
            Of the take beside the edge.
        most : int
            Most frames of any control.
        last : bool
            The frames go backwards, from the end of the take.
        mouth : int
            Frames of the mouth.
        held : int
            Frames for which brows, cheeks and corners stay first.
        """
        turned = None if head is None or not edge.head else np.array(edge.head)
        head_length = FACE_FRAMES
        if turned is not None and head is not None:
            furthest = float(np.abs(head[:3] - turned[:3]).max())
            wanted = np.ceil(FRAMES_A_DEGREE * furthest)
            head_length = int(np.clip(wanted, HEAD_FRAMES, MOST_HEAD_FRAMES))
        names, sign = controls.names, -1.0 if last else 1.0
        speaks: Bool = ControlGroups(controls).follows_mouth
        lengths, stay = np.where(speaks, mouth, FACE_FRAMES), np.where(speaks, 0, held)
        lids, looks = (
            [k for k, name in enumerate(names) if part in name] for part in ("eye_blink", "_eye.t")
        )
        lengths[lids], lengths[looks], stay[lids + looks] = LIDS_FRAMES, head_length, 0
        return cls(
            controls,
            np.array([edge.pose.get(name, 0.0) for name in names]),
            sign * np.array([edge.speed.get(name, 0.0) for name in names]),
            turned,
            None if turned is None else sign * np.array(edge.head_speed),
            np.minimum(lengths, most),
            min(head_length, most),
            stay,
        )

    @property
    def n_frames(self) -> int:
        """Frames of the whole passage."""
        return int(max((self.lengths + self.held).max(), self.head_length))

    def mix(self, values: Float32, head: Float32 | None, start: int = 0) -> None:
        """Mix the edge into frames (n, C) and their head (n, 6) in place.

        They are those from number `start` of the passage on.
        """
        count = min(len(values), self.n_frames - start)
        if count <= 0:
            return
        frames, controls = start + np.arange(count), self.controls
        rows = values[:count]
        coasted = self.pose + _coasting(frames) * self.speed
        coasted = np.clip(coasted, controls.minimum, controls.maximum)
        share = _shares(frames, self.lengths, self.held)
        groups = ControlGroups(controls)
        if len(groups.together):
            closed = 2 * rows[:, groups.together].mean(axis=1) - 1
            gains = np.minimum((frames + 1) / CONTACT_FRAMES, 1)
            met = (closed.clip(0, 1) * gains)[:, None]
            share = np.where(groups.follows_mouth, np.maximum(share, met), share)
        rows[:] = coasted + share * (rows - coasted)
        if head is not None and self.head is not None and self.head_speed is not None:
            turned = self.head + _coasting(frames) * self.head_speed
            part = _shares(frames, self.head_length)
            head[:count] = turned + part * (head[:count] - turned)


def unknown_controls(edge: Edge, controls: ControlSet) -> tuple[str, ...]:
    """A note on controls of an edge that a network's curves do not have."""
    others = sorted(edge.pose.keys() - set(controls.names))
    if not others:
        return ()
    return (f"{len(others)} controls of the other take are none of the model's: {others[0]} …",)


def activity_beside(edge: Edge | None, *, before: bool) -> Float32:
    """Activity of the sound before or after a take, as far as its gates depend on it.

    The edge's seconds without speech, then speech; nothing without an edge. Without a known time
    the face is held, as in a short pause.
    """
    if edge is None:
        return np.zeros(0, np.float32)
    quiet = PAUSE_SECONDS if edge.quiet is None else edge.quiet
    silence = np.zeros(round(min(quiet, LONGEST_QUIET) * FRAME_RATE), np.float32)
    speech = np.ones(1 if quiet < LONGEST_QUIET else 0, np.float32)
    return np.concatenate((speech, silence) if before else (silence, speech))


PAUSE_SECONDS = 0.3
"""Silence beside a take of which nothing else is known: the mouth is shut, the expression held."""
