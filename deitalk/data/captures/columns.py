"""Another rig's curves to known controls, by a table.

``map.csv``::

    target,source,weight,offset
    JawOpen,mouth_stretch_c,1,0
    MouthPucker,mouth_pucker_l|mouth_pucker_r,1,0

A target is a board channel, a raw curve or an ARKit shape, all rows of one set. It is the sum over
its rows of weight * source + offset; of sources with ``|`` between them the largest counts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from deitalk.errors import DataError
from rig import RigCurves
from rig.conversion.convert import KNOWN
from rig.errors import listed, quoted
from rig.files.text_rows import read_rows
from rig.formats.named import NamedCurves
from rig.limits import POINTS_BYTES
from rig.written_number import number_of

HEADER = ("target", "source", "weight", "offset")
LARGEST_WEIGHT = 100.0
"""Most of a weight or an offset."""


def describe_columns(names: Sequence[str]) -> str:
    """The first three names, quoted."""
    return listed([quoted(name) for name in names])


@dataclass(frozen=True)
class Row:
    """A row of the table."""

    target: str
    sources: tuple[str, ...]
    weight: float
    offset: float


@dataclass(frozen=True)
class RigMapping:
    """A table of one control set."""

    path: Path
    control_set: str
    rows: tuple[Row, ...]

    @property
    def targets(self) -> tuple[str, ...]:
        """Controls that the table gives, each once, canonical."""
        return tuple(dict.fromkeys(row.target for row in self.rows))

    @property
    def sources(self) -> set[str]:
        """Curves that the table takes."""
        return {name for row in self.rows for name in row.sources}

    def apply(self, curves: NamedCurves, where: Path) -> RigCurves:
        """Return the targets' curves.

        Raises
        ------
        DataError
            If the file lacks a source of the table.
        """
        missing = sorted(self.sources - set(curves.names))
        if missing:
            raise DataError(
                f"{where}: lacks {describe_columns(missing)}, a source of {self.path.name}; mend "
                f"the table (the file has {describe_columns(curves.names)})"
            )
        values = np.zeros((len(curves.values), len(self.targets)))
        for row in self.rows:
            largest = np.max([curves[name] for name in row.sources], axis=0)
            values[:, self.targets.index(row.target)] += row.weight * largest + row.offset
        with np.errstate(over="ignore"):  # what becomes infinite is named by RigCurves
            rounded = values.astype(np.float32)
        return RigCurves(
            rounded, self.targets, curves.fps, control_set=self.control_set, notes=curves.notes
        )


def read_mapping(path: Path) -> RigMapping:
    """Read a table of targets and sources.

    Raises
    ------
    DataError
        If it lacks a column, holds something that is no number or no control, or targets of
        several sets.
    """
    _, lines = read_rows(
        path, POINTS_BYTES, error=DataError, needed=HEADER[:2], once=HEADER, lower=True
    )
    rows = [_row(path, number, cells) for number, cells in enumerate(lines, 1)]
    if not rows:
        raise DataError(f"{path}: has no rows; each names a target and a source")
    # The known set that has all targets, or most.
    unknown = {
        control_set: [row.target for row in rows if row.target not in make()]
        for control_set, make in KNOWN.items()
    }
    control_set = min(unknown, key=lambda name: len(unknown[name]))
    if unknown[control_set]:
        raise DataError(
            f"{path}: target {quoted(unknown[control_set][0])} is no control of {control_set}; all "
            "targets are of one set: board, raw curves or ARKit (`deitalk face controls` lists the "
            "board)"
        )
    names = KNOWN[control_set]()
    canonical = tuple(replace(row, target=names.canonical(row.target)) for row in rows)
    return RigMapping(path, control_set, canonical)


def _row(path: Path, number: int, cells: dict[str, str]) -> Row:
    target = cells["target"]
    sources = tuple(filter(None, (name.strip() for name in cells["source"].split("|"))))
    if not target or not sources:
        raise DataError(f"{path}: row {number} needs a target and a source; remove or fill it")
    weight, offset = (
        _number(path, number, name, cells.get(name) or default)
        for name, default in (("weight", "1"), ("offset", "0"))
    )
    return Row(target, sources, weight, offset)


def _number(path: Path, row: int, name: str, text: str) -> float:
    value = number_of(text)
    if not abs(value) <= LARGEST_WEIGHT:
        raise DataError(
            f"{path}: row {row}, {name} {quoted(text)} must be a number within ±{LARGEST_WEIGHT:g}"
        )
    return value
