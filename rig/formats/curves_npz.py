"""Curves as a numpy archive: exact, compact, no pickle."""

from pathlib import Path
from typing import Any

import numpy as np

from rig.controls import ControlSet
from rig.curves import RigCurves
from rig.errors import CurveError, FormatError, RigError, quoted
from rig.files.reading import read_npz
from rig.formats.curves_csv import names_of_set
from rig.limits import CONTROLS

SCHEMA = "deitalk.curves/1"


def write(path: Path, curves: RigCurves) -> None:
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


def read(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
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
