"""Reports of the evaluation: Markdown tables, and JSON without NaN."""

import json
import math
from collections.abc import Sequence
from typing import Any


def as_json(report: dict[str, Any]) -> str:
    """JSON; values that are not finite are null."""
    return json.dumps(_known(report), indent=1) + "\n"


def _known(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _known(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_known(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def turned(rows: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Columns from rows, for `table`."""
    names = dict.fromkeys(name for row in rows.values() for name in row)
    return {
        name: {row: values[name] for row, values in rows.items() if name in values}
        for name in names
    }


def table(corner: str, columns: dict[str, dict[str, Any]]) -> list[str]:
    """Table with a column per key and a row per name of any column."""
    names = list(dict.fromkeys(name for column in columns.values() for name in column))
    rows = [[name, *(column.get(name) for column in columns.values())] for name in names]
    return rows_of([corner, *columns], rows)


def rows_of(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[str]:
    """Lines of a table."""
    lines = ["| " + " | ".join(header) + " |", "|---" * len(header) + "|"]
    return lines + ["| " + " | ".join(map(cell, row)) + " |" for row in rows]


def cell(value: Any) -> str:
    """Text of a value: four digits of a number, a dash for none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    return f"{value:.4g}" if isinstance(value, int | float) else str(value)
