"""Wide tables of numbers as CSV: one column per curve, one row per frame."""

import csv
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.arrays import Float64
from rig.errors import FormatError, quoted, shorten
from rig.files.reading import check_expansion, check_file, decode_text, open_file
from rig.limits import CONTROLS, CURVES_BYTES, FRAMES, HEADER_BYTES

if TYPE_CHECKING:
    import pandas as pd

MAX_COLUMNS = CONTROLS + 16
"""Controls, and the columns of times and counts beside them."""
LARGEST = float(np.finfo(np.float32).max)
"""Curves are kept as float32."""
_CHUNK = 1 << 24
_SMALL = 1 << 22
"""Bytes of a table that is read sooner than pandas is imported."""


def read_header(path: Path) -> tuple[str, ...]:
    """Return the cells of the first line, without the white space around them.

    Raises
    ------
    FormatError
        If the file is absent, empty, too large, no text, or has no sensible first line.
    """
    with open_file(path, CURVES_BYTES) as stream:
        line = stream.readline(HEADER_BYTES + 1)
    if len(line) > HEADER_BYTES:
        raise FormatError(f"{path}: the first line is longer than 1 MiB; this is no table")
    text = decode_text(line, path)
    try:
        cells = next(csv.reader([text.rstrip("\r\n")]), [])
    except csv.Error as error:
        raise FormatError(f"{path} is no CSV text: {error}") from None
    if len(cells) > MAX_COLUMNS:
        raise FormatError(f"{path} has {len(cells)} columns; at most {MAX_COLUMNS} are read")
    return tuple(cell.strip() for cell in cells)


def count_rows(path: Path, n_columns: int) -> int:
    """Return the number of lines of a table, so that its size is known before it is parsed.

    Raises
    ------
    FormatError
        If there are more than `limits.FRAMES`, or the table would take far more memory than the
        file: few cells in a line of many columns.
    """
    size, n_lines = check_file(path, CURVES_BYTES), 1
    with open_file(path, CURVES_BYTES) as stream:
        while data := stream.read(_CHUNK):
            n_lines += data.count(b"\n") + data.count(b"\r") - data.count(b"\r\n")
    if n_lines > FRAMES + 2:
        raise FormatError(
            f"{path} has {n_lines} lines; at most {FRAMES} frames are read: cut the clip"
        )
    check_expansion(8 * n_lines * n_columns, size, path, error=FormatError)
    return n_lines


def read_numbers(
    path: Path, header: Sequence[str], *, text_columns: Sequence[int] = (), skip_rows: int = 1
) -> tuple[Float64, list[list[str]]]:
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
    if not text_columns and (plain := _read_plain(path, len(header), skip_rows)) is not None:
        return plain, []
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
    if not (np.abs(numbers) <= LARGEST).all():
        raise _bad_cell(path, header, table[numeric])
    return numbers, [table[i].astype(str).tolist() for i in text_columns]


def read_matrix(path: Path, n_columns: int) -> Float64:
    """Read a table without a header [shape=(T, n_columns)].

    Raises
    ------
    FormatError
        As `read_numbers`.
    """
    header = [str(i + 1) for i in range(n_columns)]
    return read_numbers(path, header, skip_rows=0)[0]


def read_quietly(path: Path, **options: Any) -> "pd.DataFrame":
    """Return the table of `pandas.read_csv`, with its ParserWarning as an error."""
    import pandas as pd  # takes longer to import than a take to write

    with warnings.catch_warnings(), open_file(path, CURVES_BYTES) as stream:
        warnings.simplefilter("error", pd.errors.ParserWarning)
        table: pd.DataFrame = pd.read_csv(stream, **options)
    return table


def _read_plain(path: Path, n_columns: int, skip_rows: int) -> Float64 | None:
    """A small table of finite numbers alone; None of any other, which pandas reads or refuses."""
    if check_file(path, CURVES_BYTES) > _SMALL:
        return None
    count_rows(path, n_columns + 1)
    try:
        with warnings.catch_warnings(), open_file(path, CURVES_BYTES) as stream:
            warnings.simplefilter("error", UserWarning)  # no rows
            numbers = np.loadtxt(
                stream, delimiter=",", skiprows=skip_rows, comments=None, ndmin=2, encoding="ascii"
            )
    except (ValueError, UserWarning):
        return None
    is_fit = numbers.shape[1] == n_columns and numbers.size and (np.abs(numbers) <= LARGEST).all()
    return numbers if is_fit else None


def _read_table(
    path: Path, header: Sequence[str], dtype: dict[int, type], skip_rows: int
) -> "pd.DataFrame":
    import pandas as pd

    count_rows(path, len(header) + 1)
    try:
        return read_quietly(
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
    except (ValueError, OverflowError, pd.errors.ParserWarning) as error:
        reason = " ".join(shorten(str(error), 160).split())
        raise FormatError(f"{path} is no table of {len(header)} columns: {reason}") from error
    except OSError as error:
        raise FormatError(f"cannot read {path}: {error.strerror or error}") from error


def _as_numbers(column: "pd.Series[Any]") -> Float64:
    """Return a column as numbers, NaN where a cell is none."""
    import pandas as pd

    try:
        return pd.to_numeric(column, errors="coerce").to_numpy(np.float64)
    except OverflowError:  # a whole number of hundreds of digits
        return np.array([_as_number(cell) for cell in column])


def _as_number(cell: Any) -> float:
    try:
        return float(cell)
    except (TypeError, ValueError, OverflowError):
        return float("nan")


def _bad_cell(path: Path, header: Sequence[str], table: "pd.DataFrame") -> FormatError:
    """Return the error that names the first cell that is no finite number."""
    import pandas as pd

    numbers = np.stack([_as_numbers(table[i]) for i in table.columns], 1)
    row, place = (int(i) for i in np.argwhere(~(np.abs(numbers) <= LARGEST))[0])
    column = int(table.columns[place])
    cell = table[column].iloc[row]
    cell = cell.item() if isinstance(cell, np.generic) else cell
    got = "empty or NaN" if pd.isna(cell) else quoted(cell)
    return FormatError(
        f"{path}: data row {row + 1}, column {header[column]!r} is {got}; "
        "every cell must be a finite number"
    )
