"""Reports of ``docs/results``, and parts of tables."""

import json
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parents[1] / "results"

Group = dict[str, Any]

SOURCES = {
    "librispeech": "LibriSpeech",
    "speechocean-adults": "speechocean762, adults",
    "speechocean-children": "speechocean762, children",
    "espeak": "espeak-ng, English",
}

MEASURES = {
    "opening": "opening",
    "jaw": "jaw",
    "width": "width",
    "upper_lip": "upper lip",
    "lower_lip": "lower lip",
    "corner": "corners",
}
"""Lip measures of people, and their headings."""


def short(value: float, digits: int = 3) -> str:
    """A number without the zero before its point: ``.959``."""
    return re.sub(r"^(-?)0\.", r"\1.", f"{value:.{digits}f}")


@cache
def report(name: str) -> dict[str, Any]:
    """A report of ``docs/results``."""
    loaded: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return loaded


def table(rows: Sequence[Sequence[str]]) -> str:
    """Markdown; the first row is the heading."""
    lines = ["".join(f"| {cell} " if cell else "| " for cell in row) + "|" for row in rows]
    return "\n".join([lines[0], "|---" * len(rows[0]) + "|", *lines[1:]]) + "\n"
