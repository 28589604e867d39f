"""Tables of text as CSV, of any spreadsheet: rows by the names of the columns."""

import csv
import io
import re
from collections.abc import Callable, Collection
from pathlib import Path

from rig.errors import FormatError, quoted
from rig.files.reading import read_text

Row = dict[str, str]
_ABOVE = re.compile(r'(?:[ ,;\t"]*+(?:sep=(.)[ ,;\t"]*+)?(?:\r\n|\r|\n))*+', re.IGNORECASE)
"""Rows above a header: empty ones, and Excel's own first line ``sep=;``."""


def read_rows(
    path: Path,
    limit: int,
    *,
    error: Callable[[str], Exception] = FormatError,
    needed: Collection[str] = (),
    once: Collection[str] = (),
    lower: bool = False,
) -> tuple[list[str], list[Row]]:
    """Read a table: names of its columns and its rows, as `rows_of_text`.

    Parameters
    ----------
    path, limit, error
        As for `rig.files.reading.check_file`.
    needed, once, lower
        As for `rows_of_text`.

    Raises
    ------
    FormatError
        Or what `error` makes: as `rig.files.reading.read_text`, or if it is no such table.
    """
    text = read_text(path, limit, error=error, may_be_empty=True)
    return rows_of_text(text, path, error=error, needed=needed, once=once, lower=lower)


def rows_of_text(
    text: str,
    where: object,
    *,
    error: Callable[[str], Exception] = FormatError,
    needed: Collection[str] = (),
    once: Collection[str] = (),
    most: int | None = None,
    lower: bool = False,
) -> tuple[list[str], list[Row]]:
    """Names of the columns and rows of a text: commas, semicolons or tabs between the cells.

    White space around cells is left out, as empty rows and Excel's first line ``sep=;`` are, which
    tells the separator; cells that a row lacks are empty.

    Parameters
    ----------
    text : str
        The table.
    where : object
        Begins the message: a path.
    error
        As for `read_rows`.
    needed : collection of str
        Columns that must be there.
    once : collection of str
        Columns that must not come twice; the needed ones must not either.
    most : int, optional
        Largest number of rows.
    lower : bool
        Names of columns in lower case.
    """
    named, text = below_blank_rows(text)
    separator = named or separator_of(re.split(r"[\r\n]", text, maxsplit=1)[0])
    lines = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    rows: list[Row] = []
    try:
        header = [name.strip().lower() if lower else name.strip() for name in next(lines, [])]
        if missing := ", ".join(name for name in needed if name not in header):
            raise error(f"{where}: lacks the column {missing}; it needs {', '.join(needed)}")
        if doubled := [name for name in (*needed, *once) if header.count(name) > 1]:
            raise error(f"{where}: column {doubled[0]!r} is there twice; keep one")
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


def below_blank_rows(text: str) -> tuple[str, str]:
    """Separator that a line ``sep=;`` names, else "", and the text from its header on."""
    above = _ABOVE.match(text)
    assert above is not None, "it matches no row too"
    return above[1] or "", text[above.end() :]


def separator_of(line: str) -> str:
    """The separator of a header: the most frequent outside quotes, a comma if there is none."""
    plain = re.sub(r'"[^"]*"', "", line)
    counts = {mark: plain.count(mark) for mark in ";\t,"}
    if counts[";"] and re.search(r"\d,\d", plain):  # a row of numbers with decimal commas
        return ";"
    return max(counts, key=lambda mark: counts[mark]) if any(counts.values()) else ","
