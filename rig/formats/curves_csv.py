"""Curves as a wide CSV: ``frame,time,<one column per control>``.

For pandas, spreadsheets and Unreal's data tables. Controls are values only: emotion
and intensity tracks go into JSON and NPZ, and beside a take into its ``intensity.csv``.
"""

import difflib
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rig.controls import ControlSet
from rig.conversion.arkit import ARKIT_ID, N_SHAPES, arkit_controls
from rig.conversion.convert import best_set, controls_of, known_controls
from rig.conversion.raw import PREFIX
from rig.curves import RigCurves
from rig.errors import FormatError, listed, quoted
from rig.formats.decimal_text import Block, rows
from rig.formats.named import NamedCurves, read_named

DECIMALS = 6
"""Digits of a value: half a millionth of error at most."""
TIME_DECIMALS = 9
INDEX_COLUMNS = ("frame", "time")
MISSPELT = 0.9
"""Likeness of a name to that of a missing control from which on it is the same one."""
LONGEST_NAME = 100


def write(path: Path, curves: RigCurves, digits: int = DECIMALS) -> None:
    """Write all controls, so many digits after the point, trailing zeros left out."""
    write_rows(path, (*INDEX_COLUMNS, *curves.names), curves, digits)


def write_rows(
    path: Path, header: Sequence[str], curves: RigCurves, digits: int = DECIMALS
) -> None:
    """Write a header, and a row for each frame: its number, its time and its values."""
    blocks = [
        Block(np.arange(len(curves)).reshape(-1, 1), 0),
        Block(curves.times.reshape(-1, 1), TIME_DECIMALS),
        Block(curves.values, digits),
    ]
    with path.open("wb") as stream:
        stream.write(",".join(header).encode() + b"\n")
        stream.writelines(rows(blocks))


def read(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read all controls of a set, in any column order and any known spelling.

    Parameters
    ----------
    path : Path
        The file.
    controls : ControlSet, optional
        Control set of the columns; inferred from their names if not given.
    fps : float, optional
        Frames per second; taken from the times if not given.

    Raises
    ------
    FormatError, ControlError
        If the file is no such table, a control is missing, doubled or unknown, or the times are
        those of no capture.
    """
    table = read_table(path, controls, fps)
    if controls is None and best_set(table.names).id == ARKIT_ID:
        return _shapes(path, table)
    controls = controls or controls_of(table.names, where=str(path))
    require_all(path, controls, table.names)
    names = dict(zip(table.names, controls.resolve(table.names), strict=True))
    curves = table.to_curves(names, controls.id)
    return replace(curves, notes=table.all_notes).reorder(controls)


def read_shapes(
    path: Path, controls: ControlSet | None = None, fps: float | None = None
) -> RigCurves:
    """Read ARKit's shapes, in CSV, JSON or Face Cap's text; those that are absent rest.

    Parameters and errors are those of `read`; other columns are left out, with a note.
    """
    return _shapes(path, read_table(path, controls, fps))


def read_table(path: Path, controls: ControlSet | None, fps: float | None) -> NamedCurves:
    """Read as `read_named`; a message on the rate names the option of deitalk convert."""
    try:
        return read_named(path, fps, curves=controls or ())
    except FormatError as error:
        if error.parameter != "fps":
            raise
        text = str(error).replace("`fps`", "the curves' rate (deitalk convert: `source_fps`)")
        raise FormatError(text, parameter="source_fps") from None


def _shapes(path: Path, table: NamedCurves) -> RigCurves:
    controls = arkit_controls()
    present, notes = known_columns(path, table.names, controls, controls.names[:N_SHAPES])
    if not present:
        raise FormatError(f"{path}: {describe_columns(table.names)} are no shapes of ARKit")
    names = dict(zip(present, controls.resolve(present), strict=True))
    curves = table.to_curves(names, controls.id)
    return replace(curves, notes=(*table.all_notes, *notes)).reorder(controls)


def known_columns(
    path: Path,
    names: Sequence[str],
    controls: ControlSet,
    wanted: Sequence[str],
    others: Sequence[str] = (),
) -> tuple[list[str], list[str]]:
    """Columns that are controls of a set, and notes about those that are absent or left out.

    Parameters
    ----------
    path : Path
        Beginning of a message.
    names : sequence of str
        Of the columns.
    controls : ControlSet
        The set.
    wanted : sequence of str
        Controls whose absence is noted.
    others : sequence of str
        Columns that are no controls and have another use.

    Raises
    ------
    FormatError
        If a column that is none is called almost as one that is absent.
    """
    present = [name for name in names if name in controls]
    resolved = set(controls.resolve(present))
    missing = [name for name in wanted if name not in resolved]
    unknown = [name for name in names if name not in controls and name not in others]
    by_key = {_bare(name): name for name in missing}
    for name in unknown:
        if len(name) > LONGEST_NAME:
            continue
        longer = [key for key in by_key if key in _bare(name)]
        near = longer or difflib.get_close_matches(_bare(name), by_key, n=1, cutoff=MISSPELT)
        if near:
            raise FormatError(
                f"{path}: column {quoted(name)} is unknown and {by_key[near[0]]!r} is missing: "
                "rename the column, or remove it"
            )
    notes = []
    if missing:
        notes.append(f"lacks {_columns(missing)}, not known: {describe_columns(missing)}")
    if unknown:
        is_or_are = "is" if len(unknown) == 1 else "are"
        notes.append(f"{_columns(unknown)} {is_or_are} left out: {describe_columns(unknown)}")
    return present, notes


def _columns(names: Sequence[str]) -> str:
    return "1 column" if len(names) == 1 else f"{len(names)} columns"


def describe_columns(names: Sequence[str]) -> str:
    """The first three names, quoted."""
    return listed([quoted(name) for name in names])


def _bare(name: str) -> str:
    return re.sub(r"[\W_]", "", name.removeprefix(PREFIX)).lower()


def require_all(path: Path, controls: ControlSet, names: Sequence[str]) -> None:
    """Raise FormatError if a header lacks controls of the set."""
    missing = controls.missing(names)
    if missing:
        raise FormatError(
            f"{path} lacks {len(missing)} of the {len(controls)} controls of {controls.id}: "
            f"{listed(missing)}; add these columns, or read it with a control set of its own"
        )


def names_of_set(
    path: Path, set_id: str, names: Sequence[str], controls: ControlSet | None
) -> tuple[list[str], ControlSet | None]:
    """Canonical names of a file that holds its control set, and the set.

    An unknown set is a user's own (None): its names stay as they are.

    Raises
    ------
    FormatError
        If it is not the required set, or lacks some of its controls.
    """
    known = controls or known_controls(set_id)
    if known is None:
        return list(names), None
    if set_id != known.id:
        raise FormatError(f"{path} is of control set {set_id!r}, not {known.id!r}; name its rig")
    require_all(path, known, names)
    return list(known.resolve(names)), known
