"""A line of a batch: recording and acting, order to a worker, outcome, row of the summary."""

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from deitalk.acting import Acting
from deitalk.audio.choice import AudioChoice
from deitalk.audio.original import ZERO, start_of
from deitalk.errors import DataError, DeitalkError
from rig.curves import snap_fps
from rig.curves.shift import checked_shift
from rig.errors import quoted
from rig.formats import checked_digits, find_format
from rig.formats.table import FORMATS, Format, writable_suffixes

TAKE = "take"
"""Name of the format that is a whole take folder."""


@dataclass(frozen=True, slots=True)
class Written:
    """Form in which the curves of a line are written.

    Parameters
    ----------
    formats : tuple of str
        Suffixes of the files to write, and ``take``.
    fps : float, optional
        Rate of the written curves.
    digits : int, range 2 to 6, optional
        Digits after the point, of the formats that have them.
    timecode : str
        Of the first frame: ``zero``, ``recording`` or ``HH:MM:SS:FF``.
    delay, handles : int
        Frames by which the face is late, and that are added before and after.
    """

    formats: tuple[str, ...] = (".csv",)
    fps: float | None = None
    digits: int | None = None
    timecode: str = ZERO
    delay: int = 0
    handles: int = 0

    def checked(self) -> "Written":
        """Return these; UserError if a number is out of its range."""
        if self.fps is not None:
            snap_fps(self.fps)
        start_of(self.timecode, self.fps, 0.0)
        checked_shift(self.delay, self.handles)
        if self.digits is not None:
            taking = any(has_option(suffix, "digits") for suffix in self.formats)
            checked_digits(self.digits, None if taking else _format(self.formats[0]))
        return self


@dataclass(frozen=True, slots=True)
class Dubbing:
    """A performance that a line's recording is to speak: see `deitalk.data.dub.dub`."""

    performance: str
    """Path of a take or of curves."""
    sound: str = ""
    """Path of its recording; empty: that of the take, or beside the curves."""
    mapping: str = ""
    """Path of the map of another rig."""
    stretch: float = 1.5
    source_fps: float | None = None

    @property
    def content(self) -> dict[str, Any]:
        """Numbers, and SHA-256 of the files, that the line follows from.

        Raises
        ------
        DataError
            If there is no such file.
        """
        numbers = {"stretch": self.stretch, "source_fps": self.source_fps}
        paths = [path for path in (self.performance, self.sound, self.mapping) if path]
        return numbers | {"files": [_digest(Path(path)) for path in paths]}


def _digest(path: Path) -> str:
    """SHA-256 of a file, or of the curves and the sound of a take folder."""
    names = ("curves.json", "audio.wav")
    files = [path / name for name in names if (path / name).is_file()] if path.is_dir() else [path]
    if not files or not files[0].is_file():
        raise DataError(f"there is no performance, sound or map {path}; check the path")
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


@dataclass(frozen=True, slots=True)
class Line:
    """One recording to animate."""

    number: int
    """Row of the manifest or place in the folder, from 1."""
    audio: str
    """Path or URL of the recording."""
    output: str
    """Path below the output folder with ``/``, without suffix."""
    acting: Acting = field(default_factory=Acting)
    written: Written = field(default_factory=Written)
    choice: AudioChoice = field(default_factory=AudioChoice)
    """Track, channel and raw form of the recording that are read."""
    actor: str = ""
    """Who speaks; lines of one actor share a reference. Empty: nobody in particular."""
    dubbing: Dubbing | None = None
    """The performance whose mouth the recording replaces."""
    beside: Mapping[str, str] = field(default_factory=dict)
    """Outputs of the lines that come before it (``after``) and next (``into``)."""

    @property
    def targets(self) -> tuple[str, ...]:
        """Files and, for a take, the folder that are written, below the output folder."""
        return tuple(
            self.output if suffix == TAKE else self.output + suffix
            for suffix in self.written.formats
        )


@dataclass(frozen=True, slots=True)
class BadLine:
    """A row or a recording that cannot be animated."""

    number: int
    audio: str
    output: str
    error: str


def parse_formats(text: str) -> tuple[str, ...]:
    """Suffixes of a list of formats, such as ``csv;take`` or ``.npz livelink``.

    Raises
    ------
    DeitalkError
        If one is unknown or cannot be written.
    """
    if not isinstance(text, str):
        raise DeitalkError(f"formats {quoted(text)} must be a text such as csv;take")
    names = [name for name in re.split(r"[\s,;|+]+", text.strip()) if name]
    found = tuple(dict.fromkeys(_suffix(name) for name in names))
    if not found:
        raise DeitalkError("no format is named; give csv, npz, take or another")
    return found


@cache
def _suffix(name: str) -> str:
    lower = name.lower()
    if lower == TAKE:
        return TAKE
    dotted = "." + lower.removeprefix(".")
    if dotted in writable_suffixes():
        return dotted
    by_name = {f.name: f.suffixes[0] for f in FORMATS if f.write}
    if lower not in by_name:
        known = ", ".join((TAKE, *by_name))
        raise DeitalkError(f"format {quoted(name)} is unknown; known are {known}")
    return by_name[lower]


def has_option(suffix: str, option: str) -> bool:
    """Whether an option of `rig.formats.table.Format` applies to a format of a line."""
    return suffix == TAKE or option in _format(suffix).options


def _format(suffix: str) -> Format:
    return find_format(Path(f"x{suffix}"), writable=True)


def line_key(line: Line, acting: Acting, model: str) -> str:
    """Hash of everything but the sound that the outputs of a line follow from.

    Parameters
    ----------
    line : Line
        Of the batch.
    acting : Acting
        The line's, with the measured voice of its actor.
    model : str
        Identity of the model: its weights, configuration and rules.
    """
    parts: dict[str, Any] = {
        "acting": acting.settings, "written": asdict(line.written), "actor": line.actor,
        "model": model, "signal": line.choice.settings,
    }  # fmt: skip
    if line.dubbing is not None:
        parts["dubbing"] = line.dubbing.content
    if TAKE in line.written.formats:
        parts["name"] = Path(line.audio).name  # files of a take are named after it
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
