"""Curves as JSON and as a numpy archive, schema ``deitalk.curves/1``: tracks included.

The schema is written down in ``docs/formats.md``.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rig.arrays import Float32
from rig.controls import ControlSet
from rig.curves import HEAD, RigCurves
from rig.emotions import EMOTIONS, LABELS
from rig.errors import CurveError, FormatError, quoted
from rig.files.reading import read_json, read_npz
from rig.formats.curves_csv import DECIMALS, names_of_set
from rig.formats.decimal_text import Block, rows
from rig.formats.units import check_rate
from rig.limits import CONTROLS, JSON_CURVES_BYTES

SCHEMA = "deitalk.curves/1"
COLUMNS = {"emotion": LABELS, "head": HEAD}
"""Tracks of several columns."""


def write(path: Path, curves: RigCurves, digits: int = DECIMALS) -> None:
    """Write one line per frame; `digits` after the point of the values, six of the tracks."""
    head = {
        "schema": SCHEMA,
        "control_set": curves.control_set,
        "fps": curves.fps,
        "n_frames": len(curves),
        "names": curves.names,
    }
    parts: dict[str, Any] = {key: Block(track, DECIMALS) for key, track in curves.tracks.items()}
    parts |= {f"{key}_names": of for key, of in COLUMNS.items() if key in curves.tracks}
    parts["values"] = Block(curves.values, digits)
    write_object(path, json.dumps(head, indent=1, ensure_ascii=False), parts)


def write_object(path: Path, head: str, parts: Mapping[str, Any]) -> None:
    """Write a JSON object, and after its fields others, a `Block` of numbers with a row a line."""
    with path.open("wb") as stream:
        stream.write(head[:-2].encode())
        for key, part in parts.items():
            stream.write(f',\n "{key}": '.encode())
            if isinstance(part, Block):
                _write_array(stream, part)
            else:
                stream.write(json.dumps(part).encode())
        stream.write(b"\n}\n")


def _write_array(stream: Any, block: Block) -> None:
    values = block.values
    stream.write(b"[\n")
    if len(values):
        before, after = (b"  ", b",\n") if values.ndim == 1 else (b"  [", b"],\n")
        table = replace(block, values=values.reshape(len(values), -1))
        last = b""
        for text in rows([table], before=before, after=after):
            stream.write(last + text[:-2])
            last = text[-2:]
    stream.write(b"\n ]")


def read(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read curves; the control set named in the file must be `controls` if that is given.

    Raises
    ------
    FormatError
        If the text is no JSON, of another schema, or a field is missing or of a wrong type.
    """
    data = read_object(path, SCHEMA)
    for key, columns in COLUMNS.items():
        named = data.get(f"{key}_names", list(columns))
        without_moods = key == "emotion" and named == list(EMOTIONS)
        if key in data and named != list(columns) and not without_moods:
            raise FormatError(f"{path}: '{key}_names' must be {', '.join(columns)}, in this order")
    curves = _curves(path, data, controls, fps)
    if data.get("n_frames", len(curves)) != len(curves):
        raise FormatError(
            f"{path}: 'n_frames' is {quoted(data['n_frames'])} and there are {len(curves)} rows of "
            "values"
        )
    return curves


def _curves(
    path: Path, data: dict[str, Any], controls: ControlSet | None, fps: float | None
) -> RigCurves:
    """Curves of the fields of a file; the tracks may be missing."""
    names = _field(path, data, "names", list)
    if len(names) > CONTROLS:
        raise FormatError(f"{path}: {len(names)} names; at most {CONTROLS} are read")
    if not all(isinstance(name, str) for name in names):
        raise FormatError(f"{path}: every one of 'names' must be text")
    set_id = str(_field(path, data, "control_set", str))
    names, known = names_of_set(path, set_id, names, controls)
    empty = {"emotion": (0, len(LABELS)), "intensity": (0,), "head": (0, len(HEAD))}
    tracks = {k: _array(path, data, k, shape) for k, shape in empty.items() if k in data}
    values = _array(path, data, "values", (0, len(names)))
    try:
        rate = fps or float(_field(path, data, "fps", (int, float)))
        check_rate(rate, path)
        curves = RigCurves(values, tuple(names), rate, control_set=set_id, **tracks)  # type: ignore[arg-type]
    except (CurveError, OverflowError) as error:
        raise FormatError(f"{path}: {error}") from error
    return curves if known is None else curves.reorder(known)


def read_object(
    path: Path, schema: str | None = None, limit: int = JSON_CURVES_BYTES
) -> dict[str, Any]:
    """Read a JSON object; NaN and Infinity, which JSON does not have, are errors.

    Raises
    ------
    FormatError
        If the file is absent or too large, the text is no JSON object, or its ``schema`` differs.
    """
    data = read_json(path, limit)
    if not isinstance(data, dict):
        raise FormatError(f"{path} must hold a JSON object, not a {type(data).__name__}")
    if schema is not None:
        _check_schema(path, data, schema)
    return data


def _check_schema(path: Path, data: dict[str, Any], schema: str) -> None:
    if data.get("schema") != schema:
        raise FormatError(f"{path}: schema is {quoted(data.get('schema'))}; this reads {schema!r}")


def _field(path: Path, data: dict[str, Any], key: str, kind: type | tuple[type, ...]) -> Any:
    value = data.get(key)
    if not isinstance(value, kind) or isinstance(value, bool):
        got = "missing" if key not in data else f"a {type(value).__name__}"
        raise FormatError(f"{path}: field {key!r} is {got}; see docs/formats.md")
    return value


def _array(path: Path, data: dict[str, Any], key: str, empty_shape: tuple[int, ...]) -> Float32:
    given = _field(path, data, key, (list, np.ndarray))
    if not len(given):
        return np.zeros(empty_shape, np.float32)
    try:
        with np.errstate(over="ignore"):  # what becomes infinite is named by RigCurves
            array = np.asarray(given, dtype=np.float32)
        array.setflags(write=False)
        return array
    except (ValueError, TypeError, OverflowError) as error:
        raise FormatError(
            f"{path}: {key!r} must be rows of numbers of one length: {error}"
        ) from error


def write_archive(path: Path, curves: RigCurves) -> None:
    """Write an exact, compact archive: ``schema, control_set, fps, names, values``, the tracks."""
    arrays: dict[str, Any] = {
        "schema": np.array(SCHEMA),
        "control_set": np.array(curves.control_set),
        "fps": np.array(curves.fps),
        "names": np.array(curves.names),
        "values": curves.values,
        **curves.tracks,
    }
    with path.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


def read_archive(
    path: Path, controls: ControlSet | None = None, fps: float | None = None
) -> RigCurves:
    """Read curves; the control set named in the file must be `controls` if that is given.

    Raises
    ------
    FormatError
        If the file is no such archive, holds objects, or unpacks to more than the limit.
    """
    arrays = read_npz(path)
    data: dict[str, Any] = {key: np.atleast_1d(array) for key, array in arrays.items()}
    for key in {"schema", "control_set", "fps", "names"} & data.keys():
        values = data[key].tolist()
        data[key] = values if key == "names" or len(values) != 1 else values[0]
    _check_schema(path, data, SCHEMA)
    return _curves(path, data, controls, fps)
