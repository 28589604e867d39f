"""Curves as JSON and as a numpy archive, schema ``deitalk.curves/1``: tracks included.

The schema is written down in ``docs/formats.md``.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from rig.controls import ControlSet
from rig.curves import HEAD, RigCurves
from rig.emotions import EMOTIONS, LABELS
from rig.errors import CurveError, FormatError, RigError, quoted
from rig.files.reading import read_json, read_npz
from rig.formats.curves_csv import DECIMALS, names_of_set
from rig.formats.decimal_text import Block, rows
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
    with path.open("wb") as stream:
        stream.write(json.dumps(head, indent=1, ensure_ascii=False)[:-2].encode())
        for key, track in curves.tracks.items():
            _write_array(stream, key, track)
        for key, columns in COLUMNS.items():
            if key in curves.tracks:
                stream.write(f',\n "{key}_names": {json.dumps(columns)}'.encode())
        _write_array(stream, "values", curves.values, digits)
        stream.write(b"\n}\n")


def _write_array(
    stream: Any, key: str, values: np.ndarray[Any, Any], digits: int = DECIMALS
) -> None:
    stream.write(f',\n "{key}": [\n'.encode())
    if len(values):
        is_flat = values.ndim == 1
        before, after = (b"  ", b",\n") if is_flat else (b"  [", b"],\n")
        last = b""
        for text in rows(
            [Block(values.reshape(len(values), -1), digits)], before=before, after=after
        ):
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
    names = _field(path, data, "names", list)
    if len(names) > CONTROLS:
        raise FormatError(f"{path}: {len(names)} names; at most {CONTROLS} are read")
    if not all(isinstance(name, str) for name in names):
        raise FormatError(f"{path}: every one of 'names' must be text")
    set_id = str(_field(path, data, "control_set", str))
    names, known = names_of_set(path, set_id, names, controls)
    for key, columns in COLUMNS.items():
        named = data.get(f"{key}_names", list(columns))
        without_moods = key == "emotion" and named == list(EMOTIONS)
        if key in data and named != list(columns) and not without_moods:
            raise FormatError(f"{path}: '{key}_names' must be {', '.join(columns)}, in this order")
    try:
        curves = RigCurves(
            _array(path, data, "values", (0, len(names))),
            tuple(names),
            fps or float(_field(path, data, "fps", (int, float))),
            emotion=_track(path, data, "emotion"),
            intensity=_track(path, data, "intensity"),
            head=_track(path, data, "head"),
            control_set=set_id,
        )
    except (CurveError, OverflowError) as error:
        raise FormatError(f"{path}: {error}") from error
    if data.get("n_frames", len(curves)) != len(curves):
        raise FormatError(
            f"{path}: 'n_frames' is {quoted(data['n_frames'])} and there are {len(curves)} rows of "
            "values"
        )
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
    if schema is not None and data.get("schema") != schema:
        raise FormatError(f"{path}: schema is {quoted(data.get('schema'))}; this reads {schema!r}")
    return data


def _field(path: Path, data: dict[str, Any], key: str, kind: type | tuple[type, ...]) -> Any:
    value = data.get(key)
    if not isinstance(value, kind) or isinstance(value, bool):
        got = "missing" if key not in data else f"a {type(value).__name__}"
        raise FormatError(f"{path}: field {key!r} is {got}; see docs/formats.md")
    return value


def _array(
    path: Path, data: dict[str, Any], key: str, empty_shape: tuple[int, ...]
) -> np.ndarray[Any, Any]:
    rows_of = _field(path, data, key, list)
    if not rows_of:
        return np.zeros(empty_shape, np.float32)
    try:
        with np.errstate(over="ignore"):  # what becomes infinite is named by RigCurves
            array = np.array(rows_of, dtype=np.float32)
        array.setflags(write=False)
        return array
    except (ValueError, TypeError, OverflowError) as error:
        raise FormatError(
            f"{path}: {key!r} must be rows of numbers of one length: {error}"
        ) from error


def _track(path: Path, data: dict[str, Any], key: str) -> np.ndarray[Any, Any] | None:
    """A track, if the file has it."""
    if key not in data:
        return None
    return _array(path, data, key, (0, len(COLUMNS[key])) if key in COLUMNS else (0,))


# Curves as a numpy archive: exact, compact, no pickle.


def write_archive(path: Path, curves: RigCurves) -> None:
    """Write ``schema, control_set, fps, names, values`` and the tracks there are."""
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
    data = read_npz(path)
    try:
        names = _names(path, data["names"])
        set_id = str(_only(data["control_set"]))
        rate = fps or float(_only(data["fps"]))
        schema = str(_only(data["schema"]))
        if schema != SCHEMA:
            raise FormatError(f"{path}: schema is {quoted(schema)}; this reads {SCHEMA!r}")
        names, known = names_of_set(path, set_id, names, controls)
        curves = RigCurves(
            data["values"],
            tuple(names),
            rate,
            emotion=data.get("emotion"),
            intensity=data.get("intensity"),
            head=data.get("head"),
            control_set=set_id,
        )
    except KeyError as error:
        raise FormatError(f"{path} has no array {error}; see docs/formats.md") from error
    except CurveError as error:
        raise FormatError(f"{path}: {error}") from error
    except (TypeError, ValueError) as error:
        if isinstance(error, RigError):
            raise
        raise FormatError(f"{path} does not hold curves: {error}") from error
    return curves if known is None else curves.reorder(known)


def _names(path: Path, names: np.ndarray[Any, Any]) -> list[str]:
    if names.ndim > 1 or names.size > CONTROLS:
        raise FormatError(f"{path}: names have shape {names.shape}; at most {CONTROLS} are read")
    return [str(name) for name in np.atleast_1d(names)]


def _only(array: np.ndarray[Any, Any]) -> Any:
    """Return the one value of an array."""
    if array.size != 1:
        raise ValueError(f"an array of shape {array.shape} must be one value")
    return array.reshape(-1)[0]
