"""RigMapper CSV: the long table that Unreal's RigMapper plugin imports (5.7 and later).

``curve_name, frame_number, value``, one row per key. Unreal turns it into an AnimSequence or into a
section of a control rig. The file holds frame numbers only: the rate is given on import.
"""

import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.controls import ControlSet
from rig.conversion.arkit import raw_controls
from rig.conversion.convert import controls_of
from rig.curves import RigCurves
from rig.errors import FormatError, quoted, shorten
from rig.files.reading import check_expansion, check_file
from rig.formats.decimal_text import Block, Text, rendered, rows
from rig.formats.wide_csv import LARGEST, Layout, read_layout, read_quietly
from rig.limits import CONTROLS, CURVES_BYTES, FRAMES, SPARSE_BYTES, VALUES

if TYPE_CHECKING:
    import pandas as pd

HEADER = ("curve_name", "frame_number", "value")
DECIMALS = 6


def write(path: Path, curves: RigCurves) -> None:
    """Write curve after curve, a key per frame; a curve that never moves has its first and last."""
    every = np.arange(len(curves))
    ends = np.unique([0, len(curves) - 1])
    columns = np.ascontiguousarray(curves.values.T)  # column by column, as in memory
    frame_text = rendered(Block(every.reshape(-1, 1), 0))
    with path.open("wb") as stream:
        stream.write(", ".join(HEADER).encode() + b"\n")
        for name, values in zip(curves.names, columns, strict=True):
            keys = every if np.ptp(values) else ends
            frames = Text(frame_text.characters[keys])
            blocks: list[Block | Text] = [frames, Block(values[keys].reshape(-1, 1), DECIMALS)]
            head = name.encode() + b","
            for text in rows(blocks):
                stream.write(head + text[:-1].replace(b"\n", b"\n" + head) + b"\n")


def read(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read all curves; frames without a key hold a straight line between keys.

    Parameters
    ----------
    path : Path
        The file.
    controls : ControlSet, optional
        Control set of the curves; inferred from the names if not given.
    fps : float, optional
        Frames per second, which the file does not hold; 30 if not given.
    """
    layout = read_layout(path)
    if layout.header != HEADER:
        raise FormatError(f"{path}: the first line must be {', '.join(HEADER)!r}")
    table = _read_keys(path, layout)
    names = table["curve_name"].astype(str).str.strip()
    frame = table["frame_number"].to_numpy()
    n_frames = _count_frames(path, frame, names.nunique())
    grid = np.arange(n_frames)
    columns: dict[str, np.ndarray[tuple[int], np.dtype[np.float32]]] = {}
    for name, keys in table.groupby(names, sort=False):
        keys = keys.sort_values("frame_number")
        at, values = keys["frame_number"].to_numpy(), keys["value"].to_numpy(np.float64)
        if (np.diff(at) == 0).any():
            raise FormatError(f"{path}: curve {quoted(name)} has two keys on one frame")
        columns[str(name)] = np.interp(grid, at, values).astype(np.float32)
    controls = controls or controls_of(list(columns), where=str(path))
    values = np.stack(list(columns.values()), axis=1)
    values.setflags(write=False)  # not copied again
    curves = RigCurves(
        values, controls.resolve(list(columns)), fps or 30.0, control_set=controls.id
    )
    return curves.reorder(controls)


def _count_frames(path: Path, frame: np.ndarray[Any, Any], n_curves: int) -> int:
    """Return the length of the clip; FormatError if it cannot be one."""
    first, last = float(frame.min()), float(frame.max())
    if first < 0 or last >= FRAMES or n_curves > CONTROLS or (last + 1) * n_curves > VALUES:
        raise FormatError(
            f"{path}: frame numbers {first:g} to {last:g} of {n_curves} curves; at most {FRAMES} "
            f"frames, {CONTROLS} curves and {VALUES} values are read"
        )
    n_frames = int(last) + 1
    size = check_file(path, CURVES_BYTES)
    check_expansion(
        4 * n_frames * len(raw_controls()), size, path, error=FormatError, floor=SPARSE_BYTES
    )
    return n_frames


def _read_keys(path: Path, layout: Layout) -> "pd.DataFrame":
    import pandas as pd  # takes longer to import than a take to write

    try:
        table = read_quietly(
            path,
            sep=layout.separator,
            decimal=layout.decimal,
            encoding=layout.encoding,
            skiprows=layout.skipped + 1,
            header=None,
            names=list(HEADER),
            index_col=False,
            low_memory=False,
        )
        table = table.dropna(how="all")  # empty rows of a spreadsheet
        for column in ("frame_number", "value"):
            table[column] = pd.to_numeric(table[column])
    except (ValueError, TypeError, OverflowError, pd.errors.ParserWarning) as error:
        reason = " ".join(shorten(str(error), 160).split())
        raise FormatError(f"{path} is no table of keys: {reason}") from error
    except pd.errors.EmptyDataError:
        table = pd.DataFrame(columns=list(HEADER))
    if table.empty:
        raise FormatError(f"{path} has a header and no keys")
    numbers = table[["frame_number", "value"]].to_numpy(np.float64)
    bad = ~(np.abs(numbers) <= LARGEST).all(axis=1) | (numbers[:, 0] != np.rint(numbers[:, 0]))
    if bad.any():
        row = int(np.argmax(bad))
        cells = ", ".join(str(cell) for cell in itertools.islice(table.iloc[row], 3))
        raise FormatError(
            f"{path}: data row {row + 1} is {quoted(cells)}; frame and value must be numbers"
        )
    return table
