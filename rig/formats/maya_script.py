"""A Python script that keys the MetaHuman face board in Maya, with the curves in it.

Board controls are nodes of the facial board in Maya (``CTRL_C_jaw``), their channels the attributes
``translateX`` and ``translateY``, as in Epic's assemble scripts for the rig (DNA calibration, mh4).
The script runs in Maya's Python 2.7 and 3 and takes namespaces, the time unit of the scene and
boards of 2021 to 2023 into account.
"""

import inspect
import json
import re
from pathlib import Path

from rig.controls import default_controls
from rig.curves import RigCurves
from rig.formats.decimal_text import Block, rows
from rig.unreal.deitalk_clip import curve_keys, fit_segment, key_frames, split_curve

DECIMALS = 4
STILL = 5e-5
ROLES = ("driver", "master")
"""Switches and multipliers are not keyed."""
ATTRIBUTES = {"x": "translateX", "y": "translateY"}
TEMPLATE = Path(__file__).with_name("maya_template.txt")


def write(path: Path, curves: RigCurves) -> None:
    """Write the script; a curve that never moves is one number."""
    text = TEMPLATE.read_text(encoding="utf-8").replace("KEY_FRAMES\n", key_frames_text())
    head, tail = text.split("CURVES = {}\n")
    with path.open("wb") as stream:
        stream.write(head.replace("FPS = 30.0", f"FPS = {curves.fps!r}").encode())
        stream.write(f"OLDER = {json.dumps(_older_names())}\nCURVES = {{\n".encode())
        for control in default_controls().controls:
            if control.role not in ROLES:
                continue
            axis = control.name.rpartition(".")[2][-1]
            name = f"{control.ue_control}.{ATTRIBUTES[axis]}"
            values = curves[control.name]
            stream.write(f'"{name}": ['.encode())
            if values.max() - values.min() < STILL:
                values = values[:1]
            stream.writelines(rows([Block(values.reshape(1, -1), DECIMALS)]))
            stream.write(b"],\n")
        stream.write(b"}\n" + tail.encode())


def key_frames_text() -> str:
    """Return the sources of the keys' functions without annotations, as Python 2.7 reads them."""
    functions = (key_frames, curve_keys, split_curve, fit_segment)
    bare = [_bare(inspect.getsource(function)) for function in functions]
    return "\n\n".join(bare)


def _bare(source: str) -> str:
    head, _, body = source.partition(":\n")
    name, given = head.split("(", 1)
    names = [argument.partition(":")[0].strip() for argument in given.split(") ->")[0].split(", ")]
    body = re.sub(r"^( +\w+): [^=\n]+ =", r"\1 =", body, flags=re.MULTILINE)
    return f"{name}({', '.join(names)}):\n{body}"


def _older_names() -> dict[str, str]:
    """Return the names of boards of 2021 to 2023, where they differ; ``-`` of those they lack."""
    names = {c.ue_control: c.mh3_name.partition(".")[0] for c in default_controls().controls}
    return {new: old for new, old in names.items() if old and old != new}
