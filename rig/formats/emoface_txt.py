"""EmoFace and MEDTalk text: 174 board values per line, commas between, no header and no rate.

The columns are the channels of the mh3 board in the alphabetical order of their Maya names. The
list that EmoFace publishes names ``CTRL_C_tongue_tip`` twice; by its alphabetical order the first
pair is at the place of ``CTRL_C_tongue_roll``, and is read as that.
"""

from functools import cache
from pathlib import Path

import numpy as np

from rig.controls import ControlSet, default_controls
from rig.curves import RigCurves
from rig.errors import FormatError
from rig.files.reading import check_file
from rig.formats.decimal_text import Block, rows
from rig.formats.wide_csv import read_matrix
from rig.limits import CURVES_BYTES

DECIMALS = 6


@cache
def columns() -> tuple[str, ...]:
    """Return the 174 canonical names in column order."""
    controls = [c for c in default_controls().controls if c.emoface_name]
    return tuple(c.name for c in sorted(controls, key=lambda c: c.emoface_name))


def write(path: Path, curves: RigCurves) -> None:
    """Write the 174 channels; the 11 that the older board lacked are left out."""
    with path.open("wb") as stream:
        stream.writelines(rows([Block(curves.select(columns()).values, DECIMALS)]))


def read(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read 174 values per line; channels the file lacks rest.

    Raises
    ------
    FormatError
        If `fps` is not given, or a line has not 174 finite numbers.
    """
    check_file(path, CURVES_BYTES)
    if fps is None:
        raise FormatError(
            f"{path} holds no frame rate; give the curves' rate (deitalk convert: `source_fps`)",
            parameter="source_fps",
        )
    numbers = read_matrix(path, len(columns()))
    return RigCurves(numbers.astype(np.float32), columns(), fps).reorder()
