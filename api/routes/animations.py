"""Recordings to curves, to meshes, onto a mesh of the caller; checks of curves."""

from typing import Any

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict

from api.compute.order import Kind, Order
from api.errors import Problem
from api.guard.keys import Caller
from api.messages import body_docs
from api.messages.formats import (
    ANIMATION_FORMATS,
    CURVE_FORMATS,
    MESH_FORMATS,
    OutputFormat,
    choose_format,
)
from api.messages.incoming import receive
from api.messages.options import (
    FIELD_FILES,
    AnimationOptions,
    ConversionOptions,
    MeshOptions,
    RetargetOptions,
    SpeechOptions,
    order_options,
)
from api.messages.outgoing import answer_order, file_answer
from api.messages.schemas import JobView, ValidationView
from api.routes.deps import AnimatorDep, ServiceDep, problems
from api.service import Service

router = APIRouter(prefix="/v1", tags=["animation"], responses=problems(404, 409, 415))
SPEECH = ("recording", *FIELD_FILES, "transcript", "phones")


@router.post(
    "/animations",
    response_class=Response,
    responses=body_docs.answers(ANIMATION_FORMATS, JobView),
    openapi_extra=body_docs.body(AnimationOptions, SPEECH, raw=True),
)
async def animations(request: Request, service: ServiceDep, caller: AnimatorDep) -> Response:
    """Curves of a recording: at once up to `max_seconds` (60 s), a job (202) beyond."""
    return await speech(
        request, service, caller, "animation", AnimationOptions, ANIMATION_FORMATS, "json"
    )


@router.post(
    "/meshes",
    response_class=Response,
    responses=body_docs.answers(MESH_FORMATS, JobView),
    openapi_extra=body_docs.body(MeshOptions, SPEECH, raw=True),
)
async def meshes(request: Request, service: ServiceDep, caller: AnimatorDep) -> Response:
    """A moving mesh of a recording: an embedded head, or a mesh model's template."""
    return await speech(request, service, caller, "mesh", MeshOptions, MESH_FORMATS, "glb")


@router.post(
    "/retargets",
    response_class=Response,
    responses=body_docs.answers(MESH_FORMATS, JobView),
    openapi_extra=body_docs.body(
        RetargetOptions, ("mesh", "curves", "landmarks", "mapping", *SPEECH), raw=False
    ),
)
async def retargets(request: Request, service: ServiceDep, caller: AnimatorDep) -> Response:
    """Curves, or a recording, on a mesh that the request sends (GLB, OBJ, PLY or NPZ)."""
    files = ("mesh", "curves", "landmarks", "mapping", *SPEECH)
    return await speech(
        request, service, caller, "retarget", RetargetOptions, MESH_FORMATS, "glb", files
    )


@router.post(
    "/conversions",
    response_class=Response,
    responses=body_docs.file_answers(CURVE_FORMATS),
    openapi_extra=body_docs.body(ConversionOptions, ("curves",), raw=False),
)
async def conversions(request: Request, service: ServiceDep, caller: AnimatorDep) -> Response:
    """A file of curves in another format, on the control board."""
    async with service.stage.folder() as folder:
        received = await receive(request, folder, ConversionOptions, ("curves",))
        given, sent = received.options, received.sent
        output = choose_format(CURVE_FORMATS, given.format, request.headers.get("accept"), "json")
        options = given.order_options() | checked_curves(sent)
        options |= {"format": output.name, "suffix": output.suffix}
        order: Order = {"kind": "conversion", "folder": str(folder), "options": options}
        return await file_answer(folder, await service.pool.run(order), output)


class NoOptions(BaseModel):
    """A request without options."""

    model_config = ConfigDict(extra="forbid")


@router.post("/validate", openapi_extra=body_docs.body(NoOptions, ("curves",), raw=False))
async def validate(request: Request, service: ServiceDep, caller: AnimatorDep) -> ValidationView:
    """Check a file of curves by the rules of the programs that import it."""
    async with service.stage.folder() as folder:
        received = await receive(request, folder, NoOptions, ("curves",))
        options = checked_curves(received.sent)
        order: Order = {"kind": "validation", "folder": str(folder), "options": options}
        answer = await service.pool.run(order)
        return ValidationView(**answer["facts"])


async def speech(
    request: Request,
    service: Service,
    caller: Caller,
    kind: Kind,
    model: type[SpeechOptions],
    formats: dict[str, OutputFormat],
    default: str,
    files: tuple[str, ...] = SPEECH,
    *,
    at_once: bool = True,
) -> Response:
    """Read a request, carry it out or make it a job, and answer.

    Parameters
    ----------
    request, service, caller
        Of the route.
    kind : str
        Of the order.
    model : type
        Of the options.
    formats : dict
        Kinds of results.
    default : str
        Name of the format for any ``Accept``.
    files : tuple of str
        Parts of the form.
    at_once : bool
        Whether a short recording is answered at once.
    """
    async with service.stage.folder() as folder:
        received = await receive(request, folder, model, files)
        given = received.options
        output = choose_format(formats, given.format, request.headers.get("accept"), default)
        options = order_options(received, folder) | checked_files(kind, received.sent)
        if given.model not in service.settings.known_models:
            known = ", ".join(service.settings.known_models)
            raise Problem(404, f"no such model; known models: {known}", "model_unknown")
        given = given if at_once else given.model_copy(update={"wait": False})
        return await answer_order(request, service, caller, folder, kind, options, given, output)


def checked_curves(sent: dict[str, str]) -> dict[str, Any]:
    """Return the file of curves by its part; Problem 422 if it is missing."""
    if "curves" not in sent:
        raise Problem(422, "send the file of curves as the part `curves` of the form")
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
    return {}
