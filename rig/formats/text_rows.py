"""Tables of text as CSV, of any spreadsheet: rows by the names of the columns."""

import csv
import io
from collections.abc import Callable, Collection
from pathlib import Path

from rig.errors import FormatError, quoted
from rig.files.reading import read_text
from rig.formats.wide_csv import separator_of

Row = dict[str, str]


def read_rows(
    path: Path,
    limit: int,
    *,
    error: Callable[[str], Exception] = FormatError,
    needed: Collection[str] = (),
) -> tuple[list[str], list[Row]]:
    """Read a table: names of its columns and its rows, as `rows_of_text`.

    Parameters
    ----------
    path, limit, error
        As for `rig.files.reading.check_file`.
    needed : collection of str
        Columns that must be there.

    Raises
    ------
    FormatError
        Or what `error` makes: as `rig.files.reading.read_text`, or if it is no such table.
    """
    text = read_text(path, limit, error=error, may_be_empty=True)
    return rows_of_text(text, path, error=error, needed=needed)


def rows_of_text(
    text: str,
    where: object,
    *,
    error: Callable[[str], Exception] = FormatError,
    needed: Collection[str] = (),
    most: int | None = None,
    lower: bool = False,
) -> tuple[list[str], list[Row]]:
    """Names of the columns and rows of a text: commas, semicolons or tabs between the cells.

    White space around cells is left out, as empty rows and Excel's first line ``sep=;`` are; cells
    that a row lacks are empty.

    Parameters
    ----------
    text : str
        The table.
    where : object
        Begins the message: a path.
    error, needed
        As for `read_rows`.
    most : int, optional
        Largest number of rows.
    lower : bool
        Names of columns in lower case.
    """
    if text[:5].lower().strip('"').startswith("sep="):
        text = text.partition("\n")[2]
    lines = csv.reader(
        io.StringIO(text, newline=""), delimiter=separator_of(text.partition("\n")[0])
    )
    rows: list[Row] = []
    try:
        header = [name.strip().lower() if lower else name.strip() for name in next(lines, [])]
        if missing := ", ".join(name for name in needed if name not in header):
            raise error(f"{where}: lacks the column {missing}; it needs {', '.join(needed)}")
        for given in lines:
            cells = [cell.strip() for cell in given]
            if not any(cells):
                continue
            if any(cells[len(header) :]):
                raise error(
                    f"{where}, row {len(rows) + 1}: more cells than the {len(header)} of the "
                    "header; put quotes around cells with commas"
                )
            if len(rows) == most:
                raise error(f"{where}: more than {most:,} rows; divide it")
            rows.append(dict.fromkeys(header, "") | dict(zip(header, cells, strict=False)))
    except csv.Error as problem:
        raise error(
            f"{where}, row {len(rows) + 1}: cannot be read as CSV ({quoted(str(problem))})"
        ) from None
    return header, rows
