"""Messages between a batch and its workers: orders and outcomes."""

from dataclasses import dataclass, field
from typing import NamedTuple

from deitalk.acting import Acting
from deitalk.audio.choice import AudioChoice
from deitalk.batch.lines import Dubbing, Written
from deitalk.pipeline.actor_voice import MeasuredVoice


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
    """Acting of the line, with the voice of the actor where one was measured."""
    written: Written = field(default_factory=Written)
    actor: str = ""
    known: str = ""
    """SHA-256 of the recording that the outputs are of; empty: they are to be made."""
    size: float = 0.0
    """Bytes of the recording."""
    only_voice: bool = False
    """Measure the strength of the voice and write nothing."""
    choice: AudioChoice = field(default_factory=AudioChoice)
    dubbing: Dubbing | None = None
    with_edges: bool = False
    """Return the edges of the take: another line begins or ends there."""


class Target(NamedTuple):
    """A staged file or take folder, and its place below the output folder."""

    name: str
    path: str


@dataclass(slots=True)
class Outcome:
    """Result of a line.

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
    """First and last edge of the take (`deitalk.postprocess.edges.Edge`), where they are wanted."""
    stage: str = ""
    targets: tuple[Target, ...] = ()
    files: tuple[File, ...] = ()
