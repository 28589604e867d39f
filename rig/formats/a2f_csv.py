"""``animation_frames.csv`` as NVIDIA Audio2Face-3D samples write it.

An index without a name, ``timeCode`` in seconds, and ``blendShapes.<Name>`` for 52 ARKit shapes in
the order of NVIDIA's models, which is that of ARKit's enum: JawLeft before JawRight, MouthLeft
before MouthRight. Live Link Face has the right ones first.
"""

from pathlib import Path

import numpy as np

from rig.controls import ControlSet
from rig.conversion.arkit import ARKIT_ID, arkit_controls, udp_order
from rig.curves import RigCurves
from rig.errors import FormatError
from rig.formats.curves_csv import fps_of
from rig.formats.decimal_text import Block, rows
from rig.formats.wide_csv import read_header, read_numbers

PREFIX = "blendShapes."
DECIMALS = 6
N_SHAPES = 52


def write(path: Path, curves: RigCurves) -> None:
    """Write the 52 shapes, without rotations."""
    order = udp_order()[:N_SHAPES]
    names = [curves.names[i] for i in order]
    frame = np.arange(len(curves)).reshape(-1, 1)
    blocks = [
        Block(frame, 0),
        Block(curves.times.reshape(-1, 1), 9),
        Block(curves.values[:, order], DECIMALS),
    ]
    with path.open("wb") as stream:
        header = ("", "timeCode", *(PREFIX + name for name in names))
        stream.write(",".join(header).encode() + b"\n")
        stream.writelines(rows(blocks))


def read(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read the ARKit shapes; tongue shapes that ARKit lacks are left out."""
    header = read_header(path)
    arkit = arkit_controls()
    known = {PREFIX + spelling: c.name for c in arkit.controls for spelling in (c.name, *c.aliases)}
    columns = [i for i, name in enumerate(header) if name in known]
    if "timeCode" not in header or not columns:
        raise FormatError(f"{path} needs a column 'timeCode' and columns '{PREFIX}<ARKit name>'")
    numbers, _ = read_numbers(path, header)
    fps = fps or fps_of(numbers[:, header.index("timeCode")], where=str(path))
    names = tuple(known[header[i]] for i in columns)
    values = numbers[:, columns].astype(np.float32)
    return RigCurves(values, names, fps, control_set=ARKIT_ID).reorder(arkit)
