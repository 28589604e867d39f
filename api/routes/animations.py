"""Recordings to curves, to meshes, onto a mesh of the caller; checks of curves."""

import re
from typing import Any, NamedTuple

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict

from api.compute.order import (
    Kind,
    Order,
)
from api.errors import Problem
from api.messages.formats import (
    ANIMATION_FORMATS,
    CURVE_FORMATS,
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
    RetargetOptions,
    SpeechOptions,
    order_options,
)
from api.messages.outgoing import ServiceRequest, answer_order, file_answer
from api.messages.views import JobView, ValidationView
from api.routes import form_schema
from api.routes.body import receive
from api.routes.deps import AnimatorDep, ServiceDep, problems

router = APIRouter(prefix="/v1", tags=["animation"], responses=problems(404, 409, 415))
SPEECH = ("recording", *FIELD_FILES)
DUB = ("performance", "sound", "mapping", *SPEECH)
DIFF = ("edited", "take")
RETARGET = ("mesh", "curves", "landmarks", "mapping", *SPEECH)


class Made(NamedTuple):
    """Order of a route for a recording: its kind and options, formats, parts of a form."""

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
