"""The rig that captures are of, from the names and the motion of their columns."""

import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deitalk.config.rig_file import classified_by_names
from deitalk.data.captures.sources import (
    find_files,
)
from deitalk.errors import DataError
from rig import ControlSet
from rig.controls import Control
from rig.errors import UserError
from rig.formats.named import read_named


def rig_of_takes(sources: Sequence[Path], fps: float | None = None) -> ControlSet:
    """Controls of the columns of tables of curves, in the order of the first table.

    A control goes from 0 to 1, or to the whole numbers around what the takes show, and rests at 0.
    Sides, mouth and upper face follow from the names.

    Parameters
    ----------
    sources : sequence of Path
        Files of curves, or folders that are searched to any depth.
    fps : float or None
        Of files without a rate.

    Raises
    ------
    DataError
        If no file holds named curves.
    """
    low: dict[str, float] = {}
    high: dict[str, float] = {}
    refused: UserError | None = None
    for path in (path for source in sources for path in find_files(source)):
        try:
            curves = read_named(path, otherwise=fps)
        except UserError as error:
            refused = refused or error
            continue  # no table of curves; if it is a take, its import says why
        for name, values in zip(curves.names, curves.values.T, strict=True):
            low[name] = min(low.get(name, 0.0), float(np.min(values)))
            high[name] = max(high.get(name, 1.0), float(np.max(values)))
    if not low:
        raise DataError(
            f"{sources[0]}: holds no table of named curves to make a rig of"
            f"{f' ({refused})' if refused else ''}; give `rig`",
            parameter="rig",
        )
    name = re.sub(r"[^A-Za-z0-9]+", "_", sources[0].stem).strip("_") or "rig"
    return classified_by_names(
        f"{name.lower()}@1",
        (Control(column, math.floor(low[column]), math.ceil(high[column])) for column in low),
    )
