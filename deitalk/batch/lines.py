"""A line of a batch: recording and acting, order to a worker, outcome, row of the summary."""

import csv
import hashlib
import io
import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from time import monotonic
from typing import NamedTuple

from deitalk.acting import Acting
from deitalk.audio.choice import AudioChoice
from deitalk.audio.original import ZERO, start_of
from deitalk.errors import DeitalkError
from deitalk.pipeline.speech import MeasuredVoice
from rig.curves import snap_fps
from rig.curves.edit import checked_shift
from rig.errors import as_line, quoted
from rig.formats import checked_digits, find_format
from rig.formats.table import FORMATS, Format, writable_suffixes

TAKE = "take"
"""Name of the format that is a whole take folder."""


@dataclass(frozen=True, slots=True)
class Written:
    """How the curves of a line are written.

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
            _check_digits(self.digits, self.formats)
        return self


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
    """Which signal of the recording."""
    actor: str = ""
    """Who speaks; lines of one actor share a reference. Empty: nobody in particular."""
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


@cache
def _check_digits(digits: int, formats: tuple[str, ...]) -> None:
    """Raise if there are too few or too many digits, or none of the formats has them."""
    taking = any(has_option(suffix, "digits") for suffix in formats)
    checked_digits(digits, None if taking else _format(formats[0]))


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
    parts = {
        "acting": acting.settings, "written": asdict(line.written), "actor": line.actor,
        "model": model, "signal": line.choice.settings,
    }  # fmt: skip
    if TAKE in line.written.formats:
        parts["name"] = Path(line.audio).name  # files of a take are named after it
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


# What goes to a worker, and what comes back.


class File(NamedTuple):
    """A file of a line."""

    path: str
    """Below the output folder, with ``/``."""
    sha: str
    size: int
    mtime: int
    """Nanoseconds."""


@dataclass(frozen=True, slots=True)
class Order:
    """A line as a worker gets it."""

    output: str
    audio: str
    acting: Acting = field(default_factory=Acting)
    """With the voice of the actor, where one was measured."""
    written: Written = field(default_factory=Written)
    actor: str = ""
    known: str = ""
    """SHA-256 of the recording that the outputs are of; empty: they are to be made."""
    size: float = 0.0
    """Bytes of the recording."""
    only_voice: bool = False
    """Measure the strength of the voice and write nothing."""
    choice: AudioChoice = field(default_factory=AudioChoice)
    with_edges: bool = False
    """Return the edges of the take: another line begins or ends there."""


class Target(NamedTuple):
    """A staged file or take folder, and its place below the output folder."""

    name: str
    path: str


@dataclass(slots=True)
class Outcome:
    """What a worker made of a line.

    Attributes
    ----------
    status : str
        ``done``, ``unchanged`` (the recording is the known one), ``failed``, or ``full`` where the
        disk is.
    """

    output: str
    status: str
    error: str = ""
    sound: str = ""
    seconds: float = 0.0
    frames: int = 0
    warnings: tuple[str, ...] = ()
    voice: MeasuredVoice | None = None
    edges: tuple[str, str] | None = None
    """First and last edge of the take (`deitalk.postprocess.joins.Edge`), where they are wanted."""
    stage: str = ""
    targets: tuple[Target, ...] = ()
    files: tuple[File, ...] = ()


# Progress of a run, and its tables: a row for each line, and the lines that failed.


LEAST_SECONDS = 1.0
"""Time after the first result from which a rate is shown."""
Progress = Callable[[float, str], None]
"""Called with the share of the work that is done, 0 to 1, and a text on rate and time left."""

DONE, UNCHANGED, EDITED, FAILED = "done", "unchanged", "edited", "failed"
"""Made in this run; made before, from the same; the same, and changed by hand since; not made."""


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the summary."""

    number: int
    audio: str
    output: str
    status: str
    seconds: float = 0.0
    warnings: str = ""
    """One a line."""
    error: str = ""


@dataclass(frozen=True)
class BatchReport:
    """Result of `deitalk.animate_batch`.

    Attributes
    ----------
    rows : list of Row
        One for each line, in the order of the source.
    out : str
        Folder or URL of the results, with ``batch-summary.csv`` and, if lines failed,
        ``batch-failed.csv``.
    wall_seconds : float
        Duration of the run.
    notes : tuple of str
        What applies to the batch as a whole, such as columns that are not used.
    """

    rows: list[Row]
    out: str
    wall_seconds: float
    notes: tuple[str, ...] = ()

    @property
    def counts(self) -> dict[str, int]:
        """Number of rows of each status: done, unchanged, edited, failed."""
        found = Counter(row.status for row in self.rows)
        return {status: found[status] for status in (DONE, UNCHANGED, EDITED, FAILED)}

    @property
    def failed(self) -> list[Row]:
        """Rows that were not made."""
        return [row for row in self.rows if row.status == FAILED]

    @property
    def seconds(self) -> float:
        """Length of the recordings that were animated in this run."""
        return sum(row.seconds for row in self.rows if row.status == DONE)


def summary_text(rows: Sequence[Row]) -> str:
    """The summary as CSV."""
    header = ("number", "audio", "output", "status", "seconds", "warnings", "error")
    return _table(header, ((*_place(r), r.status, _seconds(r), _joined(r), r.error) for r in rows))


def failed_text(rows: Sequence[Row]) -> str:
    """The failed lines as CSV."""
    return _table(("number", "audio", "output", "error"), ((*_place(r), r.error) for r in rows))


def _place(row: Row) -> tuple[int, str, str]:
    return row.number, as_line(row.audio), as_line(row.output)


def _seconds(row: Row) -> str:
    return f"{row.seconds:.3f}" if row.seconds else ""


def _joined(row: Row) -> str:
    return "; ".join(row.warnings.splitlines())


def _table(header: Sequence[str], rows: Iterable[tuple[object, ...]]) -> str:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


class Pace:
    """Rate since the first result, so that the loading of models does not count.

    Parameters
    ----------
    lines : int
        Lines to animate.
    weight : float
        Their work in any unit, such as the bytes of the recordings.
    clock : callable
        Seconds.
    """

    def __init__(self, lines: int, weight: float, clock: Callable[[], float] = monotonic) -> None:
        self.lines, self.weight = lines, max(weight, 1.0)
        self.done = self.failed = 0
        self._clock, self._done_weight, self._seconds = clock, 0.0, 0.0
        self._first: tuple[float, int, float, float] | None = None

    def add(self, weight: float, seconds: float, *, failed: bool) -> None:
        """Count a result: its work, and the seconds of sound in it."""
        self.done += 1
        self.failed += failed
        self._done_weight += weight
        self._seconds += seconds
        if self._first is None:
            self._first = (self._clock(), self.done, self._done_weight, self._seconds)

    @property
    def share(self) -> float:
        """Share of the work that is done."""
        return min(self._done_weight / self.weight, 1.0)

    def text(self) -> str:
        """Counts, rate and time left, as one line."""
        parts = [f"{self.done} of {self.lines} lines"]
        if self.failed:
            parts.append(f"{self.failed} failed")
        if self._first is not None:
            began, done, weight, seconds = self._first
            took, advance = self._clock() - began, self._done_weight - weight
            if took >= LEAST_SECONDS and advance > 0:
                parts.append(f"{(self.done - done) / took:.1f} lines/s")
                parts.append(f"{(self._seconds - seconds) / took:.0f} x real time")
                parts.append(
                    f"{clock_text((self.weight - self._done_weight) / advance * took)} left"
                )
        return ", ".join(parts)


def clock_text(seconds: float) -> str:
    """Seconds as ``m:ss`` or ``h:mm:ss``."""
    whole = max(round(seconds), 0)
    hours, minutes = whole // 3600, whole // 60 % 60
    return f"{hours}:{minutes:02d}:{whole % 60:02d}" if hours else f"{minutes}:{whole % 60:02d}"
