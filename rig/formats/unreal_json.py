"""JSON for the script that runs inside Unreal, schema ``deitalk.unreal/2``.

Board controls, float or Vector2D, are for a Level Sequence; raw curves, for an AnimSequence, are
functions of them, and the script, which has neither numpy nor rig, is given their knots. A curve
that never moves is one number.

The script's exports hold what the asset has: raw curves of an AnimSequence as numbers, or board
controls of a Level Sequence, and the name of its sound as ``audio``. Schema ``deitalk.unreal/1``,
whose raw curves are always numbers, is read too.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from rig.arrays import Float32
from rig.controls import DEFAULT_ID, Control, ControlSet, default_controls
from rig.conversion.raw import BOTH_EYES, raw_controls, raw_knots
from rig.curves import HEAD, RigCurves
from rig.errors import CurveError, FormatError, quoted
from rig.files.reading import check_expansion, read_json
from rig.formats.curves_csv import DECIMALS
from rig.formats.decimal_text import CHUNK_CELLS, Block, rows
from rig.limits import CONTROLS, FRAMES, JSON_CURVES_BYTES

SCHEMA = "deitalk.unreal/2"
SCHEMAS = (SCHEMA, "deitalk.unreal/1")


def write(path: Path, curves: RigCurves, digits: int = DECIMALS, start: float = 0.0) -> None:
    """Write ``frame_rate``, ``n_frames``, ``start``, ``raw``, ``board``, and ``head`` if known."""
    rate = Fraction(curves.fps).limit_denominator(1001)
    head = {
        "schema": SCHEMA,
        "control_set": curves.control_set,
        "frame_rate": [rate.numerator, rate.denominator],
        "n_frames": len(curves),
        "start": start,
    }
    raw = {
        name: [json.dumps(function, separators=(",", ":")).encode()]
        for name, function in _functions().items()
    }
    names = [name for channels in _by_control().values() for name in channels.values()]
    texts = _texts((curves[name] for name in names), digits)
    board = {control: _channels(texts, channels) for control, channels in _by_control().items()}
    with path.open("wb") as stream:
        stream.write(json.dumps(head).encode()[:-1])
        _write_entries(stream, "raw", raw)
        _write_entries(stream, "board", board)
        if curves.head is not None:
            track = zip(HEAD, _texts(curves.head.T, DECIMALS), strict=True)
            _write_entries(stream, "head", {name: [text] for name, text in track})
        stream.write(b"}\n")


def _write_entries(stream: BinaryIO, key: str, entries: Mapping[str, Iterable[bytes]]) -> None:
    stream.write(f',\n"{key}": {{'.encode())
    for i, (name, text) in enumerate(entries.items()):
        stream.write((b",\n " if i else b"\n ") + json.dumps(name).encode() + b": ")
        stream.writelines(text)
    stream.write(b"\n}")


def _channels(texts: Iterator[bytes], axes: Iterable[str]) -> Iterator[bytes]:
    for j, axis in enumerate(axes):
        yield (b", " if j else b"{") + f'"{axis}": '.encode()
        yield next(texts)
    yield b"}"


def read(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read board controls, or raw curves if there are none; those that are absent rest."""
    curves, _ = read_present(path)
    if fps is not None:
        curves = replace(curves, fps=fps)
    return curves.reorder(
        default_controls() if curves.control_set == DEFAULT_ID else raw_controls()
    )


def read_present(path: Path) -> tuple[RigCurves, str]:
    """Read the board controls or raw curves that a file has, and the name of its sound.

    Raises
    ------
    FormatError
        If it is of another schema, has no curves, or a curve is unknown or of another length.
    """
    data = read_json(path, JSON_CURVES_BYTES)
    if not isinstance(data, dict) or data.get("schema") not in SCHEMAS:
        raise FormatError(f"{path} is not of schema {SCHEMA}")
    board, raw = (data.get(key) or {} for key in ("board", "raw"))
    if not isinstance(board, dict) or not isinstance(raw, dict) or not (board or raw):
        raise FormatError(f"{path} holds no curves; export an asset that has some")
    known = default_controls() if board else raw_controls()
    spelt = {name.lower(): name for name in known.names}  # Unreal may give names as first spelt
    columns = {spelt.get(str(name).lower(), str(name)): raw[name] for name in raw}
    if board:
        columns = _board_columns(path, board)
    elif len(columns) < len(raw):
        raise FormatError(f"{path}: a curve appears twice, in upper and in lower case")
    names = known.resolve(list(columns))
    n_frames, rate = _length_and_rate(path, data, len(names))
    values = _filled(path, columns, n_frames)
    head = data.get("head")
    if head is not None:
        if not isinstance(head, dict) or any(name not in head for name in HEAD):
            raise FormatError(f"{path}: head needs {', '.join(HEAD)}")
        head = _filled(path, {name: head[name] for name in HEAD}, n_frames)
    try:
        curves = RigCurves(values, names, rate, control_set=known.id, head=head)
    except CurveError as error:
        raise FormatError(f"{path}: {error}") from error
    return curves, str(data.get("audio") or "")


def _filled(path: Path, columns: dict[str, Any], n_frames: int) -> Float32:
    """Columns of a list, or of one number each [shape=(T, columns)]."""
    values = np.empty((n_frames, len(columns)), np.float32)
    for place, (name, numbers) in enumerate(columns.items()):
        if isinstance(numbers, list) and len(numbers) != n_frames:
            raise FormatError(f"{path}: {name} has {len(numbers)} values, not {n_frames}")
        try:
            with np.errstate(over="ignore"):  # what becomes infinite is named by RigCurves
                values[:, place] = numbers
        except (TypeError, ValueError, OverflowError):
            raise FormatError(f"{path}: {name} is no list of numbers") from None
    return values


def _board_columns(path: Path, board: dict[str, Any]) -> dict[str, Any]:
    """Values by channel of the board; controls that are not keyed by speech are left out."""
    columns = {}
    for control, channels in _by_control().items():
        axes = board.get(control)
        if not isinstance(axes, dict):
            continue
        for axis, name in channels.items():
            if axis not in axes:
                raise FormatError(f"{path}: {control} has no channel {axis!r}")
            columns[name] = axes[axis]
    if not columns:
        raise FormatError(f"{path}: no control of the face board; export Face_ControlBoard_CtrlRig")
    return columns


def _length_and_rate(path: Path, data: dict[str, Any], n_curves: int) -> tuple[int, float]:
    n_frames, rate = data.get("n_frames"), data.get("frame_rate")
    if type(n_frames) is not int or not 1 <= n_frames <= FRAMES or n_curves > CONTROLS:
        raise FormatError(f"{path}: n_frames is {quoted(n_frames)}; must be 1 to {FRAMES}")
    if (
        not isinstance(rate, list)
        or [type(part) for part in rate] != [int, int]
        or not 1 <= min(rate) <= max(rate) < 2**31
    ):
        raise FormatError(f"{path}: frame_rate is {quoted(rate)}; must be two whole numbers")
    check_expansion(4 * n_frames * n_curves, path.stat().st_size, path, error=FormatError)
    return n_frames, rate[0] / rate[1]


def _functions() -> dict[str, dict[str, Any]]:
    """Raw curves as functions of channels of the board.

    ``of`` are the channels, as ``control.axis``; their sum, within -1 to 1, is put into the
    piecewise linear function with the ``knots``, which is constant beyond them.
    """
    place = {
        name: f"{control}.{axis}"
        for control, channels in _by_control().items()
        for axis, name in channels.items()
    }
    functions: dict[str, dict[str, Any]] = {}
    for name, (driver, (inputs, outputs)) in raw_knots().items():
        drivers = [driver, *([BOTH_EYES[driver]] if driver in BOTH_EYES else [])]
        knots = [[x, y] for x, y in zip(inputs, outputs, strict=True)]
        functions[name] = {"of": [place[channel] for channel in drivers], "knots": knots}
    return functions


def keyed_controls() -> list[Control]:
    """Controls of the board but switches and multipliers, which are left to the animator."""
    return [c for c in default_controls().controls if c.role in ("driver", "master")]


def _by_control() -> dict[str, dict[str, str]]:
    """Return, by Unreal control, its channels: ``value``, or ``x`` and ``y``."""
    controls: dict[str, dict[str, str]] = {}
    for c in keyed_controls():
        axis = c.axis.lower() if c.type == "Vector2D" else "value"
        controls.setdefault(c.ue_control, {})[axis] = c.name
    return {name: dict(sorted(channels.items())) for name, channels in controls.items()}


def _texts(curves: Iterable[Float32], digits: int) -> Iterator[bytes]:
    """Text of each curve: its numbers, or one of a curve that never moves."""
    remaining = iter(curves)
    for first in remaining:
        block = np.array([first, *islice(remaining, CHUNK_CELLS // max(len(first), 1))])
        is_still = np.ptp(block, axis=1) < 0.5 * 10.0**-digits
        lines = b"".join(rows([Block(block, digits)], before=b"[", after=b"]\n")).splitlines()
        for text, values, still in zip(lines, block, is_still, strict=True):
            yield f"{round(float(values[0]), digits):g}".encode() if still else text
