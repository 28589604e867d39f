"""A request's body into the folder of an order: a form with files, or the bytes of one recording.

Names of files are fixed (`api.compute.order`); of the names that a request sends only a known
suffix is used.
"""

from pathlib import Path
from typing import Any

import anyio
from fastapi import Request
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError
from starlette.datastructures import UploadFile
from starlette.formparsers import MultiPartException
from starlette.requests import ClientDisconnect

from api.compute.order import CURVE_SUFFIXES, MESH_SUFFIXES, RECORDING, suffix_of
from api.errors import Problem
from api.messages.options import Options, Received, is_deferred
from deitalk.acting import LONGEST_TEXT, WORDS_SUFFIXES, modern, user_error
from deitalk.emotions.track_files import TRACK_SUFFIXES
from deitalk.errors import ConfigError
from rig.errors import quoted

FILES: dict[str, tuple[str, tuple[str, ...]]] = {
    "recording": (RECORDING, ()),
    "mesh": ("mesh", MESH_SUFFIXES),
    "curves": ("curves", CURVE_SUFFIXES),
    "landmarks": ("landmarks", (".json", ".csv")),
    "mapping": ("mapping", (".csv",)),
    "emotion": ("emotion", TRACK_SUFFIXES),
    "intensity_curve": ("intensity", TRACK_SUFFIXES),
    "voice": ("voice", (".json",)),
    "words": ("words", WORDS_SUFFIXES),
    "phones": ("phones", WORDS_SUFFIXES),
    "transcript": ("words", WORDS_SUFFIXES),
}
"""Parts of a form that are files: the fixed name, and the suffixes that tell how to read them."""
RAW_TYPES = ("audio/", "video/", "application/octet-stream")
MOST_FIELDS = 32


async def receive(
    request: Request, folder: Path, model: type[Options], files: tuple[str, ...]
) -> Received[Options]:
    """Write a request's files into a folder and return its options.

    Parameters
    ----------
    request : Request
        A multipart form, or a raw recording with the options in the query.
    folder : Path
        Of the order.
    model : type
        Of the options.
    files : tuple of str
        Names in `FILES` that this route takes.

    Raises
    ------
    Problem
        400 for a malformed form, 413, 415, 422.
    RequestValidationError
        For an option that is unknown or out of its range.
    """
    kind = request.headers.get("content-type", "application/octet-stream").partition(";")[0]
    fields: dict[str, Any] = dict(request.query_params)
    try:
        if kind.strip().lower() == "multipart/form-data":
            sent = await _form(request, folder, files, fields)
        elif "recording" in files and kind.strip().lower().startswith(RAW_TYPES):
            sent = await _raw(request, folder)
        else:
            raise Problem(
                415,
                f"content type {quoted(kind)}: send multipart/form-data"
                + (", or a recording as audio/wav" if "recording" in files else ""),
            )
    except ClientDisconnect:
        raise Problem(400, "the client closed the connection") from None
    fields, notes = modern(fields)
    given = {name: value for name, value in fields.items() if not is_deferred(name, value)}
    return Received(_checked(model, given), fields, sent, notes)


async def _form(
    request: Request, folder: Path, files: tuple[str, ...], fields: dict[str, Any]
) -> dict[str, str]:
    sent: dict[str, str] = {}
    try:
        form = await request.form(
            max_files=len(FILES), max_fields=MOST_FIELDS, max_part_size=LONGEST_TEXT
        )
    except MultiPartException as error:
        raise Problem(400, f"the form is malformed: {error.message}", "form_malformed") from None
    except Problem:
        raise
    except Exception as error:  # of the parser, for a wrong boundary and the like
        if type(error).__name__ == "HTTPException":
            raise Problem(400, "the form is malformed", "form_malformed") from None
        raise
    try:
        for name, value in form.multi_items():
            if isinstance(value, UploadFile):
                if name not in files or name in sent:
                    raise Problem(
                        422, f"file {quoted(name)} is none of {', '.join(files)}, once each"
                    )
                sent["words" if name == "transcript" else name] = await _save(value, name, folder)
            else:
                fields[name] = value
    finally:
        await form.close()
    return sent


async def _save(upload: UploadFile, name: str, folder: Path) -> str:
    fixed, suffixes = FILES[name]
    if suffixes:
        suffix = suffix_of(upload.filename or "", suffixes)
        if suffix is None:
            raise Problem(
                415, f"{name}: the file's name must end with one of {', '.join(suffixes)}"
            )
        fixed += suffix
    async with await anyio.open_file(folder / fixed, "wb") as file:
        while block := await upload.read(1 << 20):
            await file.write(block)
    return fixed


async def _raw(request: Request, folder: Path) -> dict[str, str]:
    n_bytes = 0
    async with await anyio.open_file(folder / RECORDING, "wb") as file:
        async for block in request.stream():
            n_bytes += len(block)
            await file.write(block)
    return {"recording": RECORDING} if n_bytes else {}


def _checked(model: type[Options], fields: dict[str, Any]) -> Options:
    try:
        return model.model_validate(fields, context={"files": {}})
    except ValidationError as error:
        known = user_error(error)
        if not isinstance(known, ConfigError):
            raise known from None
        raise RequestValidationError(error.errors(include_url=False)) from None
