"""Wide tables of numbers as CSV: one column per curve, one row per frame."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from rig.controls import MAX_CONTROLS
from rig.errors import FormatError

MAX_BYTES = 1 << 30
"""Largest text file that is read: over an hour of 185 curves at 60 fps."""
MAX_HEADER_BYTES = 1 << 20


def check_size(path: Path, limit: int = MAX_BYTES) -> None:
    """Raise FormatError if a file is absent, empty, no file, or larger than a limit (bytes)."""
    try:
        if not path.is_file():
            reason = "is a folder, not a file" if path.is_dir() else "does not exist"
            raise FormatError(f"{path} {reason}")
        size = path.stat().st_size
    except OSError as error:
        raise FormatError(f"cannot read {path}: {error.strerror or error}") from error
    if size == 0:
        raise FormatError(f"{path} is empty")
    if size > limit:
        raise FormatError(f"{path} has {size >> 20} MiB; the limit is {limit >> 20}; cut it")


def read_header(path: Path) -> tuple[str, ...]:
    """Return the cells of the first line, without the white space around them.

    Raises
    ------
    FormatError
        If the file is absent, empty, too large, no text, or has no sensible first line.
    """
    check_size(path)
    try:
        with path.open("rb") as stream:
            line = stream.readline(MAX_HEADER_BYTES + 1)
        if len(line) > MAX_HEADER_BYTES:
            raise FormatError(f"{path}: the first line is longer than 1 MiB; this is no table")
        cells = next(csv.reader([line.decode("utf-8-sig").rstrip("\r\n")]), [])
    except (UnicodeDecodeError, csv.Error) as error:
        raise FormatError(f"{path} is no CSV text: {error}") from error
    except OSError as error:
        raise FormatError(f"cannot read {path}: {error.strerror or error}") from error
    if len(cells) > MAX_CONTROLS + 16:
        raise FormatError(f"{path} has {len(cells)} columns; the limit is {MAX_CONTROLS + 16}")
    return tuple(cell.strip() for cell in cells)


def read_numbers(
    path: Path, header: Sequence[str], *, text_columns: Sequence[int] = (), skip_rows: int = 1
) -> tuple[NDArray[np.float64], list[list[str]]]:
    """Read the rows under the header.

    Parameters
    ----------
    path : Path
        The file.
    header : sequence of str
        From `read_header`.
    text_columns : sequence of int
        Columns that are returned as text (time codes) and not as numbers.

    skip_rows : int
        Lines before the first row.

    Returns
    -------
    numbers : array [shape=(T, columns - text columns)]
    texts : list of lists of str
        One per text column.

    Raises
    ------
    FormatError
        Naming row and column, if a cell is empty or no finite number, or rows differ in length.
    """
    table = _read_table(path, header, dict.fromkeys(text_columns, str), skip_rows)
    too_long = table[len(header)].notna().to_numpy()
    if too_long.any():
        raise FormatError(
            f"{path}: data row {int(np.argmax(too_long)) + 1} has more cells than the "
            f"{len(header)} of the header"
        )
    if not len(table):
        raise FormatError(f"{path} has no rows under its header; it needs one per frame")
    numeric = [i for i in range(len(header)) if i not in text_columns]
    try:
        numbers = table[numeric].to_numpy(dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        raise _bad_cell(path, header, table[numeric]) from None
    if not np.isfinite(numbers).all():
        raise _bad_cell(path, header, table[numeric])
    return numbers, [table[i].astype(str).tolist() for i in text_columns]


def read_matrix(path: Path, n_columns: int) -> NDArray[np.float64]:
    """Read a table without a header [shape=(T, n_columns)].

    Raises
    ------
    FormatError
        As `read_numbers`.
    """
    header = [str(i + 1) for i in range(n_columns)]
    return read_numbers(path, header, skip_rows=0)[0]


def _read_table(
    path: Path, header: Sequence[str], dtype: dict[int, type], skip_rows: int
) -> pd.DataFrame:
    try:
        return pd.read_csv(
            path,
            header=None,
            skiprows=skip_rows,
            names=list(range(len(header) + 1)),  # one more, to catch rows that are too long
            index_col=False,
            dtype=dtype,
            low_memory=False,
            encoding="utf-8-sig",
            on_bad_lines="error",
        )
    except pd.errors.EmptyDataError:
        return pd.DataFrame(columns=list(range(len(header) + 1)))
    except (ValueError, OverflowError) as error:
        reason = " ".join(str(error).split())
        raise FormatError(f"{path} is no table of {len(header)} columns: {reason}") from error
    except OSError as error:
        raise FormatError(f"cannot read {path}: {error.strerror or error}") from error


def _bad_cell(path: Path, header: Sequence[str], table: pd.DataFrame) -> FormatError:
    """Return the error that names the first cell that is no finite number."""
    numbers = np.stack(
        [pd.to_numeric(table[i], errors="coerce").to_numpy(np.float64) for i in table.columns], 1
    )
    row, place = (int(i) for i in np.argwhere(~np.isfinite(numbers))[0])
    column = int(table.columns[place])
    cell = table[column].iloc[row]
    got = "empty or NaN" if pd.isna(cell) else repr(cell)
    return FormatError(
        f"{path}: data row {row + 1}, column {header[column]!r} is {got}; "
        "every cell must be a finite number"
    )
