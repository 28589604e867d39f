"""Wide tables of numbers as CSV: one column per curve, one row per frame."""

import csv
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rig.arrays import Bool, Float64
from rig.errors import FormatError, quoted, shorten
from rig.files.reading import (
    check_expansion,
    check_file,
    decode_text,
    encoding_of,
    open_file,
)
from rig.files.text_rows import separator_of
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
_SAMPLE_LINES = 40
"""Lines by which separator, decimal mark and width of a table are told."""
_SEPARATOR_LINE = re.compile(r"\s*\"?sep=(.)\"?[\s,;]*", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")


@dataclass(frozen=True)
class Layout:
    """Layout of the text of a table.

    Parameters
    ----------
    encoding : str
        Of the text: ``utf-8-sig``, or ``utf-16`` with or without its order of bytes.
    separator : str
        Between cells: a comma, a semicolon or a tab.
    decimal : str
        Of numbers: a point or a comma.
    skipped : int
        Lines before the header: empty ones, ``sep=;`` of a spreadsheet, and comments.
    header : tuple of str
        Cells of the header without white space; empty ones at its end are left out.
    first : tuple of str
        Cells of the first row; empty if there is none.
    width : int
        Most cells of a line at the beginning of the file.
    """

    encoding: str
    separator: str
    decimal: str
    skipped: int
    header: tuple[str, ...]
    first: tuple[str, ...]
    width: int


def read_layout(path: Path) -> Layout:
    """Return the layout of a table by its beginning.

    Raises
    ------
    FormatError
        If the file is absent, empty, too large, no text, or has no sensible first line.
    """
    with open_file(path, CURVES_BYTES) as stream:
        data = stream.read(2 * HEADER_BYTES)
    is_whole = len(data) < 2 * HEADER_BYTES
    text = decode_text(data, path, is_whole=is_whole)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    if not is_whole and len(lines) > 1:
        lines.pop()  # cut short
    skipped, separator = 0, ""
    for line, below in zip(lines, [*lines[1:], ""], strict=True):
        named = _SEPARATOR_LINE.fullmatch(line)
        is_comment = line.startswith("#") and not re.match(r"\s*[\d.+-]", below)
        if line.strip(' ,;\t"') and not named and not is_comment:
            break
        separator = named[1] if named else separator
        skipped += 1
    sample = lines[skipped : skipped + _SAMPLE_LINES]
    header = sample[0] if sample else ""
    if len(header.encode()) > HEADER_BYTES:
        raise FormatError(f"{path}: the first line is longer than 1 MiB; this is no table")
    separator = separator or separator_of(header)
    try:
        rows = list(csv.reader(sample, delimiter=separator))
    except csv.Error as error:
        raise FormatError(f"{path} is no CSV text: {error}") from None
    cells = [cell.strip() for cell in rows[0]] if rows else []
    while cells and not cells[-1]:
        cells.pop()
    if len(cells) > MAX_COLUMNS:
        raise FormatError(f"{path} has {len(cells)} columns; at most {MAX_COLUMNS} are read")
    first = next((row for row in rows[1:] if any(cell.strip() for cell in row)), [])
    has_commas = any(_DECIMAL_COMMA.fullmatch(cell.strip()) for row in rows for cell in row)
    width = min(max((len(row) for row in rows), default=0), MAX_COLUMNS)
    return Layout(
        encoding_of(data),
        separator,
        "," if has_commas else ".",
        skipped,
        tuple(cells),
        tuple(cell.strip() for cell in first),
        width,
    )


def read_header(path: Path) -> tuple[str, ...]:
    """Return the cells of the header, without the white space around them.

    Errors are those of `read_layout`.
    """
    return read_layout(path).header


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
    path: Path,
    layout: Layout,
    *,
    text_columns: Sequence[int] = (),
    face: Sequence[int] = (),
    count: int | None = None,
) -> tuple[Float64, list[list[str]]]:
    """Read the rows under the header; rows without any cell are left out.

    Parameters
    ----------
    path : Path
        The file.
    layout : Layout
        From `read_layout`.
    text_columns : sequence of int
        Columns that are returned as text (time codes) and not as numbers.
    face : sequence of int
        Columns that a row may lack all together: it is a time without a face. They are then NaN.
    count : int, optional
        Column of a number of shapes: rows of 0 may lack any cell.

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
    header = layout.header
    if not text_columns and (plain := _read_plain(path, layout)) is not None:
        return plain, []
    table = _read_table(path, layout, dict.fromkeys(text_columns, str))
    n_columns = len(header)
    too_long = table.loc[:, n_columns:].notna().any(axis=1).to_numpy()
    if too_long.any():
        raise FormatError(
            f"{path}: data row {int(np.argmax(too_long)) + 1} has more cells than the "
            f"{n_columns} of the header"
        )
    numeric = [i for i in range(n_columns) if i not in text_columns]
    filled = table.loc[:, : n_columns - 1].notna().any(axis=1).to_numpy(copy=True)
    if not (text_columns or face) and filled.any():  # rows are frames: only those at the end
        filled[: np.flatnonzero(filled)[-1]] = True
    table = table[filled]
    if not len(table):
        raise FormatError(f"{path} has no rows under its header; it needs one per frame")
    try:
        numbers = table[numeric].to_numpy(dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        raise _bad_cell(path, header, table[numeric]) from None
    usable = np.abs(numbers) <= LARGEST
    if face:
        places: Sequence[int] = [numeric.index(i) for i in face]
        no_face = np.isnan(numbers[:, places]).all(axis=1)
        if count is not None:
            shapes = numbers[:, numeric.index(count)]
            no_face |= shapes == 0
            places = range(len(numeric))
        usable[np.ix_(no_face, places)] |= np.isnan(numbers[np.ix_(no_face, places)])
    if not usable.all():
        raise _bad_cell(path, header, table[numeric], usable)
    return numbers, [table[i].astype(str).tolist() for i in text_columns]


def read_matrix(path: Path, n_columns: int) -> Float64:
    """Read a table without a header [shape=(T, n_columns)].

    Raises
    ------
    FormatError
        As `read_numbers`.
    """
    found = read_layout(path)
    names = tuple(str(i + 1) for i in range(n_columns))
    layout = replace(found, header=names, skipped=found.skipped - 1)
    return read_numbers(path, layout)[0]


def _read_plain(path: Path, layout: Layout) -> Float64 | None:
    """A small table of finite numbers alone; None of any other, which pandas reads or refuses."""
    if layout.encoding != "utf-8-sig" or layout.decimal != ".":
        return None
    if check_file(path, CURVES_BYTES) > _SMALL:
        return None
    n_columns = len(layout.header)
    count_rows(path, n_columns + 1)
    try:
        with warnings.catch_warnings(), open_file(path, CURVES_BYTES) as stream:
            warnings.simplefilter("error", UserWarning)  # no rows
            numbers = np.loadtxt(
                stream,
                delimiter=layout.separator,
                skiprows=layout.skipped + 1,
                comments=None,
                ndmin=2,
                encoding="ascii",
            )
    except (ValueError, UserWarning):
        return None
    is_fit = numbers.shape[1] == n_columns and numbers.size and (np.abs(numbers) <= LARGEST).all()
    return numbers if is_fit else None


def _read_table(path: Path, layout: Layout, dtype: dict[int, type]) -> "pd.DataFrame":
    import pandas as pd  # takes longer to import than a take to write

    width = max(len(layout.header), layout.width) + 1  # one more, to catch rows that are too long
    count_rows(path, width)
    try:
        with warnings.catch_warnings(), open_file(path, CURVES_BYTES) as stream:
            warnings.simplefilter("error", pd.errors.ParserWarning)
            return pd.read_csv(
                stream, header=None, sep=layout.separator, decimal=layout.decimal,
                skiprows=layout.skipped + 1, names=list(range(width)), index_col=False, dtype=dtype,
                low_memory=False, encoding=layout.encoding, on_bad_lines="error",
            )  # fmt: skip
    except pd.errors.EmptyDataError:
        return pd.DataFrame(columns=list(range(width)))
    except (ValueError, OverflowError, pd.errors.ParserWarning) as error:
        reason = " ".join(shorten(str(error), 160).split())
        if ragged := re.search(r"Expected \d+ fields in line (\d+), saw (\d+)", reason):
            reason = f"line {ragged[1]} has {ragged[2]} cells"
        raise FormatError(
            f"{path} is no table of {len(layout.header)} columns: {reason}"
        ) from error
    except OSError as error:
        raise FormatError(f"cannot read {path}: {error.strerror or error}") from error


def _bad_cell(
    path: Path, header: Sequence[str], table: "pd.DataFrame", usable: Bool | None = None
) -> FormatError:
    """Return the error that names the first cell that is no finite number."""
    import pandas as pd

    if usable is None:
        numbers = table.apply(pd.to_numeric, errors="coerce").to_numpy(np.float64)
        usable = np.abs(numbers) <= LARGEST
    row, place = (int(i) for i in np.argwhere(~usable)[0])
    column = int(table.columns[place])
    cell = table[column].iloc[row]
    cell = cell.item() if isinstance(cell, np.generic) else cell
    got = "empty or NaN" if pd.isna(cell) else quoted(cell)
    return FormatError(
        f"{path}: data row {int(table.index[row]) + 1}, column {header[column]!r} is {got}; "
        "every cell must be a finite number"
    )
