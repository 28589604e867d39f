"""The table of formats, ``formats.csv``: names and suffixes to readers and writers.

A function is named by its module in `rig.formats`, or in full, and is loaded when it is called:
heads, scipy and pxr take long.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from rig.controls import DEFAULT_ID, ControlSet
from rig.conversion.arkit import ARKIT_ID
from rig.conversion.avatars import AVATARS
from rig.conversion.raw import RAW_ID
from rig.curves import RigCurves
from rig.errors import FormatError
from rig.files.reading import check_file, rows_of
from rig.limits import CURVES_BYTES

Reader = Callable[[Path, ControlSet | None, float | None], RigCurves]
Writer = Callable[..., None]
Header = tuple[str, ...]


@dataclass(frozen=True)
class Format:
    """One file format.

    Parameters
    ----------
    name : str
        Name of the format.
    suffixes : tuple of str
        Ends of file names that mean this format, the longest match wins.
    description : str
        One line.
    read, write : callable, optional
        None if the format is only written or only read.
    control_set : str, optional
        Control set of the file; curves are converted to it. None: any.
    also : tuple of str
        Further control sets that the file can have; curves of these are not converted.
    tracks : tuple of str
        Names of the tracks that are kept: emotion, intensity, head.
    begins : tuple of str
        First cells (lower case) of a CSV of this format, by which it is recognised.
    note : callable, optional
        A line on path and curves: what the writer adds, or an empty one.
    shows : callable, optional
        Names of the controls of the board that it shows. None: all of its control set.
    options : tuple of str
        Keywords that the writer takes: digits after the point, sound (the path that the file
        names) and seconds (its length), start (time of day of the first frame, seconds), identity.
    """

    name: str
    suffixes: tuple[str, ...]
    description: str
    read: Reader | None = None
    write: Writer | None = None
    control_set: str | None = None
    also: tuple[str, ...] = ()
    tracks: tuple[str, ...] = ()
    begins: tuple[str, ...] = ()
    note: Callable[[Path, RigCurves], str] | None = None
    shows: Callable[[], Iterable[str]] | None = None
    options: tuple[str, ...] = ()


SETS = {"": None, "board": DEFAULT_ID, "arkit": ARKIT_ID, "raw": RAW_ID}


def _format(row: dict[str, str]) -> Format:
    """A format by its row of the table."""
    also = AVATARS if row["also"] == "avatars" else tuple(filter(None, [SETS[row["also"]]]))
    return Format(
        row["name"],
        _split(row["suffixes"]),
        row["description"],
        _late(row["read"]),
        _late(row["write"]),
        SETS[row["control_set"]],
        also,
        _split(row["tracks"]),
        _split(row["begins"]),
        _late(row["note"]),
        _late(row["shows"]),
        _split(row["options"]),
    )


def _split(cell: str) -> tuple[str, ...]:
    return tuple(cell.split("|")) if cell else ()


def _late(name: str) -> Callable[..., Any] | None:
    """A function that is loaded when it is called; None without a name."""
    full = name if name.startswith("rig.") else f"rig.formats.{name}"
    module, _, function = full.rpartition(".")

    def call(*arguments: Any, **options: Any) -> Any:
        return getattr(import_module(module), function)(*arguments, **options)

    return call if name else None


def keyed_controls() -> list[str]:
    """Return the controls that scripts in Unreal and Maya key."""
    from rig.formats import unreal_json

    return [control.name for control in unreal_json.keyed_controls()]


FORMATS = tuple(map(_format, rows_of("formats/formats.csv")))


def writable_suffixes() -> tuple[str, ...]:
    """Return the ends of file names that curves are written to."""
    return tuple(suffix for known in FORMATS if known.write for suffix in known.suffixes)


def find_format(
    path: Path, name: str | None = None, *, readable: bool = False, writable: bool = False
) -> Format:
    """Return the format of a name, or of a path's suffix.

    Raises
    ------
    FormatError
        If there is none, or it cannot be read or written as required; the known ones are listed.
    """
    fits = [f for f in FORMATS if (f.read or not readable) and (f.write or not writable)]
    by_name: Mapping[str, Format] = {f.name: f for f in fits}
    if name is not None:
        if name not in by_name:
            raise FormatError(f"unknown format {name!r}; known: {', '.join(by_name)}")
        return by_name[name]
    endings = [(s, f) for f in FORMATS for s in f.suffixes if path.name.lower().endswith(s)]
    suffix, found = max(endings, key=lambda ending: len(ending[0]), default=(path.suffix, None))
    if found in fits:
        return found
    if readable and not found:
        check_file(path, CURVES_BYTES)  # no suffix helps what is not there
    known = ", ".join(s for f in fits for s in f.suffixes)
    which = (
        f"{found.name} ({suffix}) is only read" if found else f"no format has the suffix {suffix!r}"
    )
    raise FormatError(f"{path}: {which}; known: {known}")


def format_of_header(header: Header) -> str | None:
    """Return the format whose CSV begins with a header's first cells, or None."""
    cells = tuple(cell.lower() for cell in header)
    for known in FORMATS:
        if known.begins and cells[: len(known.begins)] == known.begins:
            return known.name
    return None
