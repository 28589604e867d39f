"""Tables of keys from any spreadsheet, from JSON or YAML, as columns.

A spreadsheet's CSV: commas, semicolons or tabs between cells; decimal points or commas; ``50%`` for
0.5, but in times; UTF-8 with or without mark, UTF-16 with mark; quoted cells; Excel's first line
``sep=;``; empty rows. Names of columns are compared without case and without spaces around them.
K keys.
"""

import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.errors import EmotionError
from rig import limits
from rig.arrays import Bool, Float64, Int64
from rig.errors import quoted
from rig.files.reading import load_json, read_text
from rig.files.text_rows import below_blank_rows
from rig.written_number import number_of

SHEET_SUFFIXES = (".csv", ".tsv")
TRACK_SUFFIXES = (*SHEET_SUFFIXES, ".json", ".yaml", ".yml")
_SEPARATORS = ",;\t"


@dataclass(frozen=True)
class Columns:
    """Columns of equal length.

    Attributes
    ----------
    path : object
        Name of the file or the text, for messages.
    numbers : dict of str to array [shape=(K,)]
        All finite.
    texts : dict of str to list of str
        Lower case, without the spaces around them.
    rows : array [shape=(K,)]
        Number of each key in its file, from 1: empty rows are left out.
    """

    path: object
    numbers: dict[str, Float64]
    texts: dict[str, list[str]]
    rows: Int64

    def refuse(self, bad: Bool, why: Callable[[int], str]) -> None:
        """Raise EmotionError for the first bad key (K,): its number, and why, by its place."""
        if bad.any():
            place = int(np.argmax(bad))
            raise EmotionError(f"{self.path}, key {self.rows[place]}: {why(place)}")


@dataclass(frozen=True)
class Table:
    """Keys of a file, of which columns are taken by name, once.

    Attributes
    ----------
    path : object
        Name of the file or the text, for messages.
    names : frozenset of str
        Of all columns.
    keys : iterable of (int, mapping)
        Number of each key in its file, from 1, and its values; those of empty cells are empty.
    """

    path: object
    names: frozenset[str]
    keys: Iterable[tuple[int, Mapping[str, Any]]]

    def columns(
        self, numbers: Sequence[str], texts: Sequence[str] = (), **defaults: float
    ) -> Columns:
        """Return columns by name; EmotionError names the first cell that is missing or bad.

        `defaults` are what empty cells of a column stand for.
        """
        wanted = (*numbers, *texts)
        needed = [name for name in wanted if name not in defaults]
        for name in needed:
            if name not in self.names:
                if any(math.isfinite(number_of(given)) for given in self.names):
                    raise EmotionError(
                        f"{self.path}: its first line must name the columns, such as "
                        "time,emotion,strength or time,intensity; it holds numbers"
                    )
                raise missing(self.path, 1, name, needed)
        rows, cells = [], []
        for row, key in self.keys:
            given = [key.get(name) for name in wanted]
            if all(value == "" for value in given):
                continue
            pairs = zip(wanted, given, strict=True)
            filled = [defaults.get(name) if v in ("", None) else v for name, v in pairs]
            if None in filled:
                raise missing(self.path, row, wanted[filled.index(None)], needed)
            rows.append(row)
            cells.append(filled)
        if not rows:
            raise _no_keys(self.path)
        columns = dict(zip(wanted, zip(*cells, strict=True), strict=True))
        words = {name: [str(value).strip().lower() for value in columns[name]] for name in texts}
        found = {
            name: np.array([number_of(value, percent=name != "time") for value in columns[name]])
            for name in numbers
        }
        table = Columns(self.path, found, words, np.array(rows))
        for name, column in found.items():
            table.refuse(~np.isfinite(column), lambda k: _not_finite(columns[name][k], name))  # noqa: B023
        return table


def read_table(path: Path) -> Table:
    """Read a table of keys in one of the formats of this module.

    Raises
    ------
    EmotionError
        If the file cannot be read, is too large, has another suffix or holds no keys.
    """
    suffix = path.suffix.lower()
    if suffix in SHEET_SUFFIXES:
        return _sheet(path, read_text(path, limits.TRACK_BYTES, error=EmotionError))
    if suffix == ".json":
        text = read_text(path, limits.TRACK_JSON_BYTES, error=EmotionError)
        return table_of(load_json(text, path, error=EmotionError), path)
    if suffix in (".yaml", ".yml"):
        from deitalk.config.yaml_files import read_yaml

        return table_of(read_yaml(path, error=EmotionError), path)
    raise EmotionError(
        f"{path}: suffix {quoted(suffix)} is none of {', '.join(TRACK_SUFFIXES)}; rename or convert"
    )


def is_table(text: str) -> bool:
    """Whether a text is a table of keys itself, not a name: JSON, or rows under a header."""
    return text.lstrip()[:1] in ("[", "{") or "\n" in text.strip()


def table_of(content: Any, where: object) -> Table:
    """A table of a text, as of a spreadsheet or JSON, or of a list of keys; errors name `where`."""
    if isinstance(content, str) and content.lstrip()[:1] in ("[", "{"):
        content = load_json(content, where, error=EmotionError)
    return _sheet(where, content) if isinstance(content, str) else _keys(where, content)


def number(value: object, name: str, where: str) -> float:
    """Return a value (`rig.written_number`) as a finite number; else EmotionError."""
    found = number_of(value)
    if not np.isfinite(found):
        raise EmotionError(f"{where}: {_not_finite(value, name)}")
    return found


def _not_finite(value: object, name: str) -> str:
    return f"{name} is {quoted(value)}; it must be a finite number"


def missing(path: object, row: int, name: str, needed: Sequence[str]) -> EmotionError:
    """Return the error of a key without a value."""
    return EmotionError(
        f"{path}, key {row}: no {name!r}; every key needs {', '.join(dict.fromkeys(needed))}"
    )


def _rows(
    path: object, text: str, separator: str, header: Sequence[str]
) -> Iterator[tuple[int, dict[str, str]]]:
    """Keys under a header."""
    row, most = 0, len(header)
    for given in _csv(path, text, separator):
        cells = [cell.strip() for cell in given]
        if not any(cells) and len(cells) < 2:
            continue
        row += 1
        if any(cells[most:]):
            raise EmotionError(
                f"{path}, key {row}: more cells than the {most} of the header; quote "
                "numbers with decimal commas, or use semicolons between cells"
            )
        yield row, dict(zip_longest(header, cells[:most], fillvalue=""))


def _csv(path: object, text: str, separator: str) -> Iterator[list[str]]:
    """Rows of cells; EmotionError where they cannot be parsed."""
    lines = io.StringIO(text, newline="")
    try:
        yield from csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=True)
    except csv.Error as error:
        raise EmotionError(f"{path} cannot be parsed: {error}; mend the file") from None


def _no_keys(path: object) -> EmotionError:
    return EmotionError(f"{path} holds no keys; give a list of keys with a 'time' each")


def _sheet(path: object, text: str) -> Table:
    """A spreadsheet."""
    lines = text.count("\n") + text.count("\r") - text.count("\r\n")
    if lines > limits.KEYS + 2:
        raise EmotionError(f"{path} has {lines} lines; at most {limits.KEYS} keys are read")
    given, text = below_blank_rows(text)
    line, rest = _first_line(text)
    separator = given or max(_SEPARATORS, key=re.sub(r'"[^"]*"?', "", line).count)
    if separator not in _SEPARATORS:
        raise EmotionError(f"{path}: 'sep={separator}' is none of comma, semicolon and tab")
    header = tuple(cell.strip().lower() for cell in next(_csv(path, line, separator), []))
    if len(header) > limits.TRACK_COLUMNS:
        raise EmotionError(
            f"{path} has {len(header)} columns; at most {limits.TRACK_COLUMNS} are read"
        )
    doubled = sorted({name for name in header if name and header.count(name) > 1})
    if doubled:
        raise EmotionError(f"{path}: column {quoted(doubled[0])} comes twice; rename one")
    return Table(path, frozenset(header), _rows(path, rest, separator, header))


def _first_line(text: str) -> tuple[str, str]:
    end = re.search(r"\r\n|\r|\n", text)
    if end is None:
        return text[: limits.HEADER_BYTES], ""
    return text[: min(end.start(), limits.HEADER_BYTES)], text[end.end() :]


def _keys(path: object, content: Any) -> Table:
    """A list of keys, alone or as ``keys``."""
    if isinstance(content, dict):
        content = content.get("keys")
    if not isinstance(content, list) or not content:
        raise _no_keys(path)
    if len(content) > limits.KEYS:
        raise EmotionError(f"{path} has {len(content)} keys; at most {limits.KEYS} are read")
    if not all(isinstance(key, dict) for key in content):
        raise _no_keys(path)
    keys = [{str(name).strip().lower(): value for name, value in key.items()} for key in content]
    return Table(path, frozenset(name for key in keys for name in key), enumerate(keys, 1))
