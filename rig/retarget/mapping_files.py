"""Files that map the shapes of a user's face to controls."""

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rig.errors import FormatError
from rig.files import atomic_write
from rig.files.reading import load_json, read_text
from rig.files.text_rows import rows_of_text
from rig.limits import MAPPED_VALUE, POINT_NAMES, POINTS_BYTES
from rig.written_number import number_of

HEADER = ("shape", "control", "value")


def read_mapping(path: Path | str) -> dict[str, dict[str, float]]:
    """Read a mapping: a spreadsheet ``shape,control,value`` or JSON ``{shape: {control: value}}``.

    A row without a control, as `write_mapping` has it for an unknown shape, says nothing.

    Raises
    ------
    FormatError
        If it is neither, names more than 1000 shapes, or gives a value beyond ±100.
    """
    path = Path(path)
    text = read_text(path, POINTS_BYTES, errors="replace")
    is_json = path.suffix.lower() == ".json"
    given = load_json(text, path.name) if is_json else {}
    rows = [] if is_json else rows_of_text(text, path.name, once=HEADER, lower=True)[1]
    mapping: dict[str, dict[str, float]] = {}
    try:
        for shape, controls in given.items():
            mapping[str(shape)] = {str(c): _value(v) for c, v in controls.items()}
        for row in rows:
            if row["control"]:
                value = _value(row.get("value") or "1")
                mapping.setdefault(_name(row["shape"]), {})[row["control"]] = value
    except (ValueError, KeyError, AttributeError, TypeError, OverflowError):
        mapping = {}
    if len(mapping) > POINT_NAMES:
        raise FormatError(f"{path.name} maps {len(mapping)} shapes; at most {POINT_NAMES} are read")
    if not mapping:
        raise FormatError(
            f"{path.name} is no mapping; write CSV with the header shape,control,value "
            'or JSON {"smile_L": {"mouthCornerPullL": 1.0}}'
        )
    return mapping


def write_mapping(path: Path | str, mapping: Mapping[str, Mapping[str, float]]) -> None:
    """Write a mapping as CSV, to be edited and read by `read_mapping`."""
    with atomic_write(path) as beside, open(beside, "w", encoding="utf-8", newline="") as stream:
        rows = csv.writer(stream, lineterminator="\n")
        rows.writerow(HEADER)
        for shape, controls in mapping.items():
            rows.writerows((shape, *pair) for pair in controls.items() or (("", ""),))


def _name(text: str | None) -> str:
    if not text:
        raise ValueError("every row names a shape and a control")
    return text


def _value(text: Any) -> float:
    value = number_of(text)
    if not abs(value) <= MAPPED_VALUE:
        raise ValueError("a control's value must be within its range")
    return value
