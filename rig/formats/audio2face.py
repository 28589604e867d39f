"""Curves of NVIDIA's Audio2Face: ``animation_frames.csv``, and JSON of its application.

The CSV is read as any table of ARKit's shapes (`rig.formats.curves_csv.read`). The JSON has
``exportFps``, ``trackPath``, ``numPoses``, ``numFrames``, ``facsNames`` and ``weightMat`` with a
row of weights a frame; names are ARKit's in any spelling, or those of an avatar of
`rig.conversion.avatars`.
"""

import json
from dataclasses import replace
from pathlib import Path

from rig.controls import ControlSet
from rig.conversion.arkit import ARKIT_ID, N_SHAPES, apple_names, udp_order
from rig.conversion.convert import curves_of_shapes, known_controls
from rig.curves import RigCurves
from rig.curves.edit import clamp
from rig.formats.curves_csv import DECIMALS, read_table, write_rows
from rig.formats.curves_json import write_object
from rig.formats.decimal_text import Block
from rig.formats.named import A2F_PREFIX
from rig.formats.units import in_units


def write(path: Path, curves: RigCurves) -> None:
    """Write the 52 shapes, without rotations."""
    shapes = curves.select(curves.names[i] for i in udp_order()[:N_SHAPES])
    write_rows(path, ("", "timeCode", *(A2F_PREFIX + name for name in shapes.names)), shapes)


def write_json(path: Path, curves: RigCurves, sound: str = "") -> None:
    """Write the shapes; ARKit's 52 in NVIDIA's order, without rotations."""
    names = curves.names
    if curves.control_set == ARKIT_ID:
        order = udp_order()[:N_SHAPES]
        curves = curves.select(names[i] for i in order)
        names = tuple(apple_names()[i] for i in order)
    head = {
        "exportFps": curves.fps, "trackPath": sound, "numPoses": len(names),
        "numFrames": len(curves), "facsNames": names,
    }  # fmt: skip
    write_object(path, json.dumps(head, indent=1), {"weightMat": Block(curves.values, DECIMALS)})


def read_json(
    path: Path, controls: ControlSet | None = None, fps: float | None = None
) -> RigCurves:
    """Read weights of ARKit's or an avatar's shapes; shapes that are not named rest.

    Raises
    ------
    FormatError
        If a part is missing or damaged, there is no rate, or the names are of no known set.
    """
    table = read_table(path, controls, fps)
    curves = curves_of_shapes(table.names, table.values, table.fps, str(path))
    known = known_controls(curves.control_set)
    assert known is not None
    curves, clipped = clamp(in_units(curves, known, path), known)
    said = (str(clipped),) if clipped else ()
    return replace(curves, notes=(*table.all_notes, *curves.notes, *said))
