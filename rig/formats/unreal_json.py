"""JSON for the script that runs inside Unreal, schema ``deitalk.unreal/1``.

The script has neither numpy nor rig, so the file holds both raw curves for an AnimSequence and
board controls, float or Vector2D, for a Level Sequence. A curve that never moves is one number.
"""

import json
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

from rig.arrays import Float32
from rig.controls import default_controls
from rig.conversion.raw import board_to_raw
from rig.curves import RigCurves
from rig.formats.decimal_text import Block, rows

SCHEMA = "deitalk.unreal/1"
DECIMALS = 6


def write(path: Path, curves: RigCurves) -> None:
    """Write ``frame_rate``, ``n_frames``, ``raw`` and ``board``."""
    rate = Fraction(curves.fps).limit_denominator(1001)
    head = {
        "schema": SCHEMA,
        "control_set": curves.control_set,
        "frame_rate": [rate.numerator, rate.denominator],
        "n_frames": len(curves),
    }
    raw = board_to_raw(curves)
    columns = np.ascontiguousarray(raw.values.T)
    with path.open("wb") as stream:
        stream.write(json.dumps(head).encode()[:-1])
        stream.write(b',\n"raw": {')
        for i, name in enumerate(raw.names):
            stream.write(_key(name, first=i == 0))
            stream.writelines(_values(columns[i]))
        stream.write(b'\n},\n"board": {')
        for i, (control, channels) in enumerate(_by_control().items()):
            stream.write(_key(control, first=i == 0) + b"{")
            for j, (axis, name) in enumerate(channels.items()):
                stream.write((b", " if j else b"") + f'"{axis}": '.encode())
                stream.writelines(_values(curves[name]))
            stream.write(b"}")
        stream.write(b"\n}}\n")


def _by_control() -> dict[str, dict[str, str]]:
    """Return, by Unreal control, its channels: ``value``, or ``x`` and ``y``.

    Switches and multipliers are left to the animator and not keyed.
    """
    controls: dict[str, dict[str, str]] = {}
    for c in default_controls().controls:
        if c.role not in ("driver", "master"):
            continue
        axis = c.axis.lower() if c.type == "Vector2D" else "value"
        controls.setdefault(c.ue_control, {})[axis] = c.name
    return {name: dict(sorted(channels.items())) for name, channels in controls.items()}


def _key(name: str, *, first: bool) -> bytes:
    return (b"\n " if first else b",\n ") + json.dumps(name).encode() + b": "


def _values(values: Float32) -> Iterator[bytes]:
    if np.ptp(values) < 0.5 * 10.0**-DECIMALS:
        yield f"{round(float(values[0]), DECIMALS):g}".encode()
        return
    yield from rows([Block(values.reshape(1, -1), DECIMALS)], before=b"[", after=b"]")
