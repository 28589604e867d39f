"""A Python script that keys the MetaHuman face board in Maya, with the curves in it.

Board controls are nodes of the facial board in Maya (``CTRL_C_jaw``), their channels the attributes
``translateX`` and ``translateY``, as in Epic's assemble scripts for the rig (DNA calibration, mh4).
The script runs in Maya's Python 2.7 and 3 and takes namespaces, the time unit of the scene and
boards of 2021 to 2023 into account.
"""

import ast
import inspect
import json
import re
from pathlib import Path

import numpy as np

from rig.controls import ControlSet, default_controls
from rig.curves import RigCurves, check_clip
from rig.errors import FormatError
from rig.files.reading import read_text
from rig.formats.decimal_text import Block, rows
from rig.formats.unreal_json import keyed_controls
from rig.limits import CURVES_BYTES
from rig.unreal.deitalk_clip import KEYS

DECIMALS = 4
STILL = 5e-5
ATTRIBUTES = {"x": "translateX", "y": "translateY"}
TEMPLATE = Path(__file__).with_name("maya_template.txt")


def write(path: Path, curves: RigCurves) -> None:
    """Write the script; a curve that never moves is one number."""
    text = TEMPLATE.read_text(encoding="utf-8").replace("KEY_FRAMES\n", key_frames_text())
    head, tail = text.split("CURVES = {}\n")
    # Names of boards of 2021 to 2023, where they differ; ``-`` of those they lack.
    names = {c.ue_control: c.mh3_name.partition(".")[0] for c in default_controls().controls}
    older = {new: old for new, old in names.items() if old and old != new}
    with path.open("wb") as stream:
        stream.write(head.replace("FPS = 30.0", f"FPS = {curves.fps!r}").encode())
        stream.write(f"OLDER = {json.dumps(older)}\nCURVES = {{\n".encode())
        for name, control in _attributes().items():
            values = curves[control]
            stream.write(f'"{name}": ['.encode())
            if values.max() - values.min() < STILL:
                values = values[:1]
            stream.writelines(rows([Block(values.reshape(1, -1), DECIMALS)]))
            stream.write(b"],\n")
        stream.write(b"}\n" + tail.encode())


def _attributes() -> dict[str, str]:
    """Controls by the attribute that is keyed."""
    return {f"{c.ue_control}.{ATTRIBUTES[c.name[-1]]}": c.name for c in keyed_controls()}


def read(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read a script of `write`, which is parsed and not run; switches and multipliers rest.

    Raises
    ------
    FormatError
        If it is no script of ours: its rate or a curve is missing or damaged.
    """
    text, board = read_text(path, CURVES_BYTES), default_controls()
    try:
        given = {
            node.targets[0].id: ast.literal_eval(node.value)
            for node in ast.parse(text).body
            if isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Name)
            and node.targets[0].id in ("FPS", "CURVES")
        }
        columns = {_attributes()[name]: given["CURVES"][name] for name in given["CURVES"]}
        rate, frames = fps or float(given["FPS"]), max(map(len, columns.values()))
        check_clip(frames, len(board))
        values = np.tile(board.rest, (frames, 1)).astype(np.float32)
        with np.errstate(over="ignore"):  # refused below as not finite
            for control, numbers in columns.items():
                values[:, board.index(control)] = np.broadcast_to(np.float32(numbers), frames)
    except (SyntaxError, ValueError, TypeError, LookupError, AttributeError, RecursionError,
            OverflowError) as error:  # fmt: skip
        raise FormatError(f"{path} is no script of deitalk: FPS and CURVES are needed") from error
    if not np.isfinite(values).all():
        raise FormatError(f"{path} holds numbers that are not finite")
    return RigCurves(values, board.names, rate)


def key_frames_text() -> str:
    """Return the sources of the keys' functions without annotations, as Python 2.7 reads them."""
    return "\n\n".join(_bare(inspect.getsource(function)) for function in KEYS)


def _bare(source: str) -> str:
    head, _, body = source.partition(":\n")
    name, given = head.split("(", 1)
    names = [argument.partition(":")[0].strip() for argument in given.split(") ->")[0].split(", ")]
    body = re.sub(r"^( +\w+): [^=\n]+ =", r"\1 =", body, flags=re.MULTILINE)
    return f"{name}({', '.join(names)}):\n{body}"
