"""A reader to fuzz and its seeds."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from .mutate import Mutation


@dataclass(frozen=True)
class Seed:
    """A valid file: its name in the folder, its bytes and its mutation."""

    name: str
    data: bytes
    mutate: Mutation


@dataclass(frozen=True)
class Reader:
    """A reader to fuzz.

    Parameters
    ----------
    seeds : callable
        Folder to write to -> seeds; every seed is read without an error.
    read : callable
        Reads the file at a path.
    """

    seeds: Callable[[Path], list[Seed]]
    read: Callable[[Path], object]
