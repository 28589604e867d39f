"""Recordings to curves, to meshes, onto a mesh of the caller; checks of curves."""

import re
from pathlib import Path
from typing import Any, NamedTuple

import anyio
from fastapi import APIRouter, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ConfigDict, ValidationError
from python_multipart.exceptions import FormParserError
from starlette.datastructures import FormData, UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import ClientDisconnect

from api.compute.order import (
    LISTEN_TO,
    MESH_SUFFIXES,
    RECORDING,
    SOUND,
    Kind,
    Order,
    suffix_of,
)
from api.errors import Problem
from api.messages.formats import (
    ANIMATION_FORMATS,
    CURVE_FORMATS,
    CURVE_SUFFIXES,
    LAYER,
    MESH_FORMATS,
    OutputFormat,
    choose_format,
)
from api.messages.options import (
    FIELD_FILES,
    AnimationOptions,
    ConversionOptions,
    DiffOptions,
    DubOptions,
    MeshOptions,
    Options,
    Received,
    RetargetOptions,
    SpeechOptions,
    is_deferred,
    order_options,
)
from api.messages.outgoing import ServiceRequest, answer_order, file_answer
from api.messages.views import JobView, ValidationView
from api.routes import form_schema
from api.routes.deps import AnimatorDep, ServiceDep, problems
from deitalk.acting import user_error
from deitalk.acting_fields import LONGEST_TEXT, SCRIPT_SUFFIXES, WORDS_SUFFIXES
from deitalk.emotions.track_files import TRACK_SUFFIXES
from deitalk.errors import ConfigError
from rig.errors import quoted

router = APIRouter(prefix="/v1", tags=["animation"], responses=problems(404, 409, 415))
SPEECH = ("recording", *FIELD_FILES)
EDGE_SUFFIXES, TAKE_SUFFIXES = (".zip", *CURVE_SUFFIXES), (".zip", ".json")
DUB = ("performance", "sound", "mapping", *SPEECH)
DIFF = ("edited", "take")
RETARGET = ("mesh", "curves", "landmarks", "mapping", *SPEECH)


class Made(NamedTuple):
    """What a route makes of a recording: an order's kind and options, formats, parts of a form."""

    kind: Kind
    options: type[SpeechOptions]
    formats: dict[str, OutputFormat]
    usual: str
    """Name of the format for any ``Accept``."""
    files: tuple[str, ...] = SPEECH


ANIMATION = Made("animation", AnimationOptions, ANIMATION_FORMATS, "json")


@router.post(
    "/animations",
    response_class=Response,
    responses=form_schema.answers(ANIMATION_FORMATS, JobView),
    openapi_extra=form_schema.body(AnimationOptions, SPEECH, ANIMATION_FORMATS, raw=True),
)
async def animate(request: Request, service: ServiceDep, caller: AnimatorDep) -> Response:
    """Curves of a recording: at once up to `max_seconds` (60 s), a job (202) beyond."""
    return await speech(ServiceRequest(request, service, caller), ANIMATION)


@router.post(
    "/dubs",
    response_class=Response,
    responses=form_schema.answers(ANIMATION_FORMATS, JobView),
    openapi_extra=form_schema.body(DubOptions, DUB, ANIMATION_FORMATS, raw=False),
)
async def dub(request: Request, service: ServiceDep, caller: AnimatorDep) -> Response:
    """A performance that the request sends with the mouth of another recording."""
    made = Made("dub", DubOptions, ANIMATION_FORMATS, "json", DUB)
    return await speech(ServiceRequest(request, service, caller), made)


@router.post(
    "/diffs",
    response_class=Response,
    responses=form_schema.file_answers({LAYER.name: LAYER}),
    openapi_extra=form_schema.body(DiffOptions, DIFF, raw=False),
)
async def diff(request: Request, service: ServiceDep, caller: AnimatorDep) -> Response:
    """Compare an edited file with its take: the changes as a layer of edits, at once."""
    await service.check_room(caller, is_job=False)
    async with service.stage.folder() as folder:
        received = await receive(request, folder, DiffOptions, DIFF)
        sent = checked_parts(received.sent, edited="the edited curves", take="the zipped take")
        suffix = sent["edited"].removeprefix("edited")  # of several parts in some formats
        stem = received.names["edited"][: -len(suffix)]
        title = re.sub(r"[^A-Za-z0-9 _-]+", "_", stem)[:64].strip(" _-")
        options = {"name": title or "fixes"} | received.options.model_dump(exclude_none=True)
        order: Order = {"kind": "diff", "folder": str(folder), "options": options | sent}
        return await file_answer(folder, await service.pool.run(order, caller), LAYER)


@router.post(
    "/meshes",
    response_class=Response,
    responses=form_schema.answers(MESH_FORMATS, JobView),
    openapi_extra=form_schema.body(MeshOptions, SPEECH, MESH_FORMATS, raw=True),
)
async def animate_mesh(request: Request, service: ServiceDep, caller: AnimatorDep) -> Response:
    """A moving mesh of a recording: an embedded head, or a mesh model's template."""
    made = Made("mesh", MeshOptions, MESH_FORMATS, "glb")
    return await speech(ServiceRequest(request, service, caller), made)


@router.post(
    "/retargets",
    response_class=Response,
    responses=form_schema.answers(MESH_FORMATS, JobView),
    openapi_extra=form_schema.body(RetargetOptions, RETARGET, MESH_FORMATS, raw=False),
)
async def retarget(request: Request, service: ServiceDep, caller: AnimatorDep) -> Response:
    """Curves, or a recording, on a mesh that the request sends (GLB, OBJ, PLY or NPZ)."""
    made = Made("retarget", RetargetOptions, MESH_FORMATS, "glb", RETARGET)
    return await speech(ServiceRequest(request, service, caller), made)


@router.post(
    "/conversions",
    response_class=Response,
    responses=form_schema.file_answers(CURVE_FORMATS),
    openapi_extra=form_schema.body(ConversionOptions, ("curves",), CURVE_FORMATS, raw=False),
)
async def convert(request: Request, service: ServiceDep, caller: AnimatorDep) -> Response:
    """A file of curves in another format, on the control board."""
    await service.check_room(caller, is_job=False)
    async with service.stage.folder() as folder:
        received = await receive(request, folder, ConversionOptions, ("curves",))
        given, sent = received.options, received.sent
        output = choose_format(CURVE_FORMATS, given.format, request.headers.get("accept"), "json")
        options = given.order_options() | checked_parts(sent, curves="the file of curves")
        options |= {"format": output.name, "suffix": output.suffix}
        order: Order = {"kind": "conversion", "folder": str(folder), "options": options}
        return await file_answer(folder, await service.pool.run(order, caller), output)


class NoOptions(BaseModel):
    """A request without options."""

    model_config = ConfigDict(extra="forbid")


@router.post("/validate", openapi_extra=form_schema.body(NoOptions, ("curves",), raw=False))
async def validate(request: Request, service: ServiceDep, caller: AnimatorDep) -> ValidationView:
    """Check a file of curves by the rules of the programs that import it."""
    await service.check_room(caller, is_job=False)
    async with service.stage.folder() as folder:
        received = await receive(request, folder, NoOptions, ("curves",))
        options = checked_parts(received.sent, curves="the file of curves")
        order: Order = {"kind": "validation", "folder": str(folder), "options": options}
        answer = await service.pool.run(order, caller)
        return ValidationView(**answer["facts"])


async def speech(asked: ServiceRequest, made: Made, *, at_once: bool = True) -> Response:
    """Read a request, carry it out or make it a job, and answer.

    Parameters
    ----------
    asked : ServiceRequest
        Of the route.
    made : Made
        What the route makes of a recording.
    at_once : bool
        Whether a short recording is answered at once.
    """
    request, service, caller = asked
    is_job = not at_once or request.query_params.get("wait") == "false"
    await service.check_room(caller, is_job=is_job)
    async with service.stage.folder() as folder:
        received = await receive(request, folder, made.options, made.files)
        given, accepted = received.options, request.headers.get("accept")
        output = choose_format(made.formats, given.format, accepted, made.usual)
        options = order_options(received, folder) | checked_files(made.kind, received.sent)
        if given.model not in service.settings.known_models:
            known = ", ".join(service.settings.known_models)
            raise Problem(404, f"no such model; known models: {known}", "model_unknown")
        work: Order = {"kind": made.kind, "options": options}
        return await answer_order(asked, folder, work, output, waits=at_once and given.wait)


def checked_parts(sent: dict[str, str], **needed: str) -> dict[str, Any]:
    """Return the files by their parts; Problem 422 if one that is needed is missing."""
    for part, what in needed.items():
        if part not in sent:
            raise Problem(422, f"send {what} as the part `{part}` of the form")
    return dict(sent)


def checked_files(kind: Kind, sent: dict[str, str]) -> dict[str, Any]:
    """Return the files of an order by their parts; Problem 422 if one is missing."""
    if kind == "retarget":
        if "mesh" not in sent:
            raise Problem(422, "send the mesh as the part `mesh` of the form", "mesh_missing")
        if ("recording" in sent) == ("curves" in sent):
            raise Problem(422, "send either `curves` or a `recording`", "curves_missing")
        parts = ("mesh", "curves", "landmarks", "mapping")
        return {part: sent[part] for part in parts if part in sent}
    if "recording" not in sent:
        raise Problem(
            422,
            "send the recording as the body, or as the part `recording` of a form",
            "recording_missing",
        )
    if kind != "dub":
        return {}
    if "performance" not in sent:
        raise Problem(
            422, "send the performance as the part `performance` of the form", "curves_missing"
        )
    return {part: sent[part] for part in ("performance", "sound", "mapping") if part in sent}


# A request's body into the folder of an order: a form with files, or the bytes of one recording.
#
# Names of files are fixed (`api.compute.order`); of the names that a request sends only a known
# suffix is used.


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
"""Those of them that are no text."""
RAW_TYPES = ("audio/", "video/", "application/octet-stream")
MOST_FIELDS = 64
"""Of a form; the options of a route are under 40."""


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
        raise RequestValidationError(error.errors(include_url=False)) from None
