"""Orders of the service to a worker process, and its answers: JSON, and files in one folder.

Names of files are fixed here: no text of a request becomes a path.

::

    folder/                 the worker's working folder during the order
      recording             bytes of any recording; so are sound and listen_to
      mesh.glb … curves.csv files that a request sent, under fixed names
      acting.json           fields of the acting; emotion.csv … files that they name
      out/                  what the worker wrote
"""

from typing import Any, Literal, TypedDict

Kind = Literal[
    "animation", "dub", "diff", "mesh", "retarget", "conversion", "validation", "voices", "studio"
]
RECORDING, SOUND, LISTEN_TO = "recording", "sound", "listen_to"
"""Recordings of an order: that which is animated, that of a performance, and another voice."""
OUT = "out"
ACTING = "acting.json"
"""Fields of the order's acting, as they were sent."""
SAMPLES = "samples"
"""File of an order ``voices``: float32, those of each feed after those of the one before."""
MOST_VOICES = 64
"""Voices of one model."""
MESH_SUFFIXES = (".glb", ".obj", ".ply", ".npz")


class Limits(TypedDict):
    """Limits that a worker process keeps."""

    memory_bytes: int
    max_channels: int
    max_pixels: float
    models: dict[str, str]
    preload: list[str]
    device: str
    backend: str
    threads: int


class Order(TypedDict, total=False):
    """One piece of work."""

    kind: Kind
    folder: str
    options: dict[str, Any]
    at_once_seconds: float
    """Longest recording that is done now; a longer one is answered by its length."""
    most_seconds: float


class Answer(TypedDict, total=False):
    """The last message of an order; `progress` comes in messages of its own."""

    progress: float
    file: str
    notes: list[str]
    facts: dict[str, Any]
    long: float
    error: list[str]
    """Names of the error's classes, the nearest first."""
    message: str


class TooLarge(Exception):
    """Work beyond a limit of the service."""


def suffix_of(name: str, suffixes: tuple[str, ...]) -> str | None:
    """Return the known suffix that a file's name ends with, or None."""
    return next((suffix for suffix in suffixes if name.lower().endswith(suffix)), None)
