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
from python_multipart.exceptions import FormParserError
from starlette.datastructures import FormData, UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import ClientDisconnect

from api.compute.order import LISTEN_TO, MESH_SUFFIXES, RECORDING, SOUND, suffix_of
from api.errors import Problem
from api.messages.formats import CURVE_SUFFIXES
from api.messages.options import Options, Received, is_deferred
from deitalk.acting import user_error
from deitalk.acting_fields import LONGEST_TEXT, SCRIPT_SUFFIXES, WORDS_SUFFIXES
from deitalk.config.section import rule
from deitalk.emotions.track_files import TRACK_SUFFIXES
from deitalk.errors import ConfigError
from rig.errors import quoted

EDGE_SUFFIXES, TAKE_SUFFIXES = (".zip", *CURVE_SUFFIXES), (".zip", ".json")
FILES: dict[str, tuple[str, tuple[str, ...]]] = {
    "recording": (RECORDING, ()),
    "sound": (SOUND, ()),
    "performance": ("performance", EDGE_SUFFIXES),
    "edited": ("edited", CURVE_SUFFIXES),
    "take": ("take", TAKE_SUFFIXES),
    "mesh": ("mesh", MESH_SUFFIXES),
    "curves": ("curves", CURVE_SUFFIXES),
    "landmarks": ("landmarks", (".json", ".csv")),
    "mapping": ("mapping", (".csv",)),
    "emotion": ("emotion", TRACK_SUFFIXES),
    "intensity_curve": ("intensity", TRACK_SUFFIXES),
    "voice": ("voice", (".json",)),
    "words": ("words", WORDS_SUFFIXES),
    "script": ("script", SCRIPT_SUFFIXES),
    "listen_to": (LISTEN_TO, ()),
    "after": ("after", EDGE_SUFFIXES),
    "into": ("into", EDGE_SUFFIXES),
    "edit": ("edit", (".json",)),
}
"""Parts of a form that are files: the fixed name, and the suffixes that tell how to read them."""
FILES_ALONE = (
    "recording", "sound", "performance", "edited", "take", "mesh", "curves", "landmarks", "mapping"
)  # fmt: skip
"""Parts of a form that are no text."""
RAW_TYPES = ("audio/", "video/", "application/octet-stream")
MOST_FIELDS = 64
"""Most fields of a form; the options of a route are under 40."""


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
    fields: dict[str, Any] = {}
    names: dict[str, str] = {}
    for name, value in request.query_params.multi_items():
        if name in fields:
            raise _twice(name)
        fields[name] = value
    try:
        if kind.strip().lower() == "multipart/form-data":
            sent = await _form(request, folder, files, fields, names)
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
    given = {name: value for name, value in fields.items() if not is_deferred(name, value)}
    return Received(_checked(model, given), fields, sent, names)


def _twice(name: str) -> Problem:
    return Problem(422, f"{quoted(name)} is given twice; give it once", "option_invalid")


async def _form(
    request: Request,
    folder: Path,
    files: tuple[str, ...],
    fields: dict[str, Any],
    names: dict[str, str],
) -> dict[str, str]:
    sent: dict[str, str] = {}
    form = await _parsed(request)
    try:
        for name, value in form.multi_items():
            if name in fields or name in sent:
                raise _twice(name)
            if isinstance(value, UploadFile):
                if name not in files:
                    raise Problem(422, f"file {quoted(name)} is none of {', '.join(files)}")
                sent[name] = await _save(value, name, folder)
                names[name] = value.filename or ""
            elif name in FILES_ALONE:
                raise Problem(
                    422, f"{name}: text where a file is needed; curl sends one by {name}=@FILE"
                )
            else:
                fields[name] = value
    finally:
        await form.close()
    return sent


class _Parser(MultiPartParser):
    """Notes whether a form is whole."""

    is_whole = False

    def on_end(self) -> None:
        self.is_whole = True


async def _parsed(request: Request) -> FormData:
    parser = _Parser(
        request.headers, request.stream(), max_files=len(FILES), max_fields=MOST_FIELDS,
        max_part_size=LONGEST_TEXT,
    )  # fmt: skip
    try:
        form = await parser.parse()
    except (MultiPartException, FormParserError) as error:
        why = f"{error} {error.__cause__ or ''}".strip()
    except UnicodeError:
        why = "its charset does not fit; send UTF-8"
    else:
        if parser.is_whole:
            return form
        await form.close()
        why = "it ends before its last boundary"
    raise Problem(400, f"the form is malformed: {why}", "form_malformed")


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
        problems = error.errors(include_url=False)
        stated = [item | {"type": "value_error", "msg": rule(item, model)} for item in problems]
        raise RequestValidationError(stated) from None
