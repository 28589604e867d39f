"""Interval tiers of Praat's TextGrid files, in the long and in the short form."""

import re

from deitalk.errors import DataError
from rig.errors import quoted

Interval = tuple[float, float, str]
"""Start and end in seconds, and the label."""
_TOKEN = re.compile(r'"((?:[^"]|"")*)"|\[\d+\]|(?<![\w.])(-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)(?!\w)')
"""A quoted text, a number in brackets (which is no value), or a number: both forms have the same
values in the same order."""


def intervals_of(text: str, path: object) -> dict[str, list[Interval]]:
    """Interval tiers of a TextGrid by name, in the order of the text; `path` is for messages.

    Raises
    ------
    DataError
        If it is no TextGrid with interval tiers.
    """
    found = (match for match in _TOKEN.finditer(text) if not match[0].startswith("["))
    values = [float(m[2]) if m[2] else m[1].replace('""', '"') for m in found]
    tiers: dict[str, list[Interval]] = {}
    for i, value in enumerate(values):
        if value == "IntervalTier" and len(values) > i + 4:
            tiers[str(values[i + 1])] = _intervals(path, values[i + 4 :])
    if not tiers:
        raise DataError(f"{path}: no interval tier; save a TextGrid of Praat with one")
    return tiers


def _intervals(path: object, values: list[float | str]) -> list[Interval]:
    """Intervals of a tier from its number of intervals on."""
    count = values[0]
    if not isinstance(count, float) or not 0 <= count <= (len(values) - 1) // 3:
        raise DataError(f"{path}: a tier has {quoted(count)} intervals, which are not in the file")
    rows: list[Interval] = []
    for k in range(1, 1 + 3 * int(count), 3):
        start, end, label = values[k : k + 3]
        if not isinstance(start, float) or not isinstance(end, float) or isinstance(label, float):
            raise DataError(f"{path}: interval {len(rows) + 1} is no start, end and text")
        rows.append((start, end, label))
    return rows
