"""Curves as a numpy archive: exact, compact, no pickle."""

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from rig.controls import ControlSet
from rig.curves import RigCurves
from rig.errors import CurveError, FormatError, RigError
from rig.formats.curves_csv import names_of_set
from rig.formats.wide_csv import MAX_BYTES, check_size

SCHEMA = "deitalk.curves/1"


def write(path: Path, curves: RigCurves) -> None:
    """Write ``schema, control_set, fps, names, values`` and the tracks there are."""
    arrays: dict[str, Any] = {
        "schema": np.array(SCHEMA),
        "control_set": np.array(curves.control_set),
        "fps": np.array(curves.fps),
        "names": np.array(curves.names),
        "values": curves.values,
        "emotion": curves.emotion,
        "intensity": curves.intensity,
    }
    with path.open("wb") as stream:
        np.savez_compressed(stream, **{k: v for k, v in arrays.items() if v is not None})


def read(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read curves; the control set named in the file must be `controls` if that is given.

    Raises
    ------
    FormatError
        If the file is no such archive, holds objects, or unpacks to more than the limit.
    """
    data = _load(path)
    try:
        names = [str(name) for name in np.atleast_1d(data["names"])]
        set_id = str(data["control_set"])
        rate = fps or float(data["fps"])
        if str(data["schema"]) != SCHEMA:
            raise FormatError(f"{path}: schema is {str(data['schema'])!r}; this reads {SCHEMA!r}")
        names, known = names_of_set(path, set_id, names, controls)
        curves = RigCurves(
            data["values"],
            tuple(names),
            rate,
            emotion=data.get("emotion"),
            intensity=data.get("intensity"),
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


def _load(path: Path) -> dict[str, np.ndarray[Any, Any]]:
    check_size(path)
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > MAX_BYTES:
            raise FormatError(
                f"{path} unpacks to {unpacked >> 20} MiB; the limit is {MAX_BYTES >> 20}"
            )
        with np.load(path, allow_pickle=False) as archive:
            return {key: archive[key] for key in archive.files}
    except FormatError:
        raise
    except (
        ValueError,
        OSError,
        EOFError,
        KeyError,
        SyntaxError,
        MemoryError,
        NotImplementedError,
        RuntimeError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise FormatError(f"{path} is no archive of numpy arrays: {error}") from error
