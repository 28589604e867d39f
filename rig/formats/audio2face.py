"""Curves of NVIDIA's Audio2Face: ``animation_frames.csv``, and JSON of its application.

The CSV is read as any table of ARKit's shapes (`rig.formats.curves_csv.read`). The JSON has
``exportFps``, ``trackPath``, ``numPoses``, ``numFrames``, ``facsNames`` and ``weightMat`` with a
row of weights a frame; names are ARKit's in any spelling, or those of an avatar of
`rig.conversion.avatars`.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from rig.controls import ControlSet
from rig.conversion.arkit import ARKIT_ID, udp_order
from rig.conversion.convert import shapes_named
from rig.curves import RigCurves, check_clip
from rig.curves.edit import clamp
from rig.errors import FormatError
from rig.formats.curves_json import read_object
from rig.formats.decimal_text import Block, rows
from rig.formats.named import A2F_PREFIX
from rig.formats.units import in_units

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
        header = ("", "timeCode", *(A2F_PREFIX + name for name in names))
        stream.write(",".join(header).encode() + b"\n")
        stream.writelines(rows(blocks))


def write_json(path: Path, curves: RigCurves, sound: str = "") -> None:
    """Write the shapes; ARKit's 52 in NVIDIA's order, without rotations."""
    order = (
        udp_order()[:N_SHAPES] if curves.control_set == ARKIT_ID else np.arange(len(curves.names))
    )
    names = [curves.names[i] for i in order]
    if curves.control_set == ARKIT_ID:
        names = [name[0].lower() + name[1:] for name in names]
    head = {
        "exportFps": curves.fps, "trackPath": sound, "numPoses": len(names),
        "numFrames": len(curves), "facsNames": names,
    }  # fmt: skip
    with path.open("wb") as stream:
        stream.write(json.dumps(head, indent=1)[:-2].encode() + b',\n "weightMat": [\n')
        last = b""
        for text in rows([Block(curves.values[:, order], DECIMALS)], before=b"  [", after=b"],\n"):
            stream.write(last + text[:-2])
            last = text[-2:]
        stream.write(b"\n ]\n}\n")


def read_json(
    path: Path, controls: ControlSet | None = None, fps: float | None = None
) -> RigCurves:
    """Read weights of ARKit's or an avatar's shapes; shapes that are not named rest.

    Raises
    ------
    FormatError
        If a part is missing or damaged, there is no rate, or the names are of no known set.
    """
    data = read_object(path)
    names, rate = data.get("facsNames"), fps or data.get("exportFps")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise FormatError(f"{path} needs a list of texts 'facsNames'")
    if type(rate) not in (int, float) or not 0 < rate <= 1000:  # type: ignore[operator]
        raise FormatError(f"{path} has no rate 'exportFps'; state the rate of its frames")
    try:
        with np.errstate(over="ignore"):  # infinite, refused below
            values = np.array(data.get("weightMat"), np.float32)
    except (TypeError, ValueError, OverflowError):
        values = np.empty(0, np.float32)
    if values.ndim != 2 or values.shape[1] != len(names) or not np.isfinite(values).all():
        raise FormatError(f"{path}: 'weightMat' must be rows of {len(names)} finite numbers")
    chosen, places = shapes_named(names, str(path))
    check_clip(len(values), len(chosen))
    shown = np.zeros((len(values), len(chosen)), np.float32)
    for column, place in enumerate(places):
        if place is not None:
            shown[:, place] = values[:, column]
    curves = RigCurves(shown, chosen.names, float(rate), control_set=chosen.id)  # type: ignore[arg-type]
    curves, clipped = clamp(in_units(curves, chosen, path), chosen)
    return replace(curves, notes=(*curves.notes, *([str(clipped)] if clipped else ())))
