"""Lists of what requests may name: models, control sets, emotions, formats."""

from typing import Annotated

from fastapi import APIRouter, Path

from api.errors import Problem
from api.messages.formats import ANIMATION_FORMATS, MESH_FORMATS
from api.messages.views import ControlSetView, ControlView, EmotionsView, FormatView, ModelView
from api.routes.deps import AnimatorDep, ServiceDep, problems
from deitalk.emotions import LABELS, MOODS
from deitalk.emotions.tracks import MAX_INTENSITY
from deitalk.models.folder import describe_model, product_of
from rig.conversion.convert import KNOWN, known_controls
from rig.emotions import VARIANTS

router = APIRouter(prefix="/v1", tags=["catalogue"], responses=problems())


@router.get("/models")
def list_models(service: ServiceDep, caller: AnimatorDep) -> list[ModelView]:
    """Models that requests may name."""
    views = []
    for name, folder in service.settings.known_models.items():
        product = product_of(folder)
        control_set = describe_model(folder)["control_set"] if product == "curves" else None
        views.append(
            ModelView(
                name=name, product=product, control_set=control_set, is_default=name == "default"
            )
        )
    return views


@router.get("/emotions")
def list_emotions(caller: AnimatorDep) -> EmotionsView:
    """Emotions, and the range of their intensity."""
    return EmotionsView(
        emotions=list(LABELS),
        procedural=list(MOODS),
        variants={emotion: list(own) for emotion, own in VARIANTS.items()},
        intensity_minimum=0.0,
        intensity_maximum=MAX_INTENSITY,
    )


@router.get("/formats")
def list_formats(caller: AnimatorDep) -> dict[str, list[FormatView]]:
    """Kinds of results of animations and of meshes."""
    tables = {"animations": ANIMATION_FORMATS, "meshes": MESH_FORMATS}
    return {
        kind: [FormatView.model_validate(known, from_attributes=True) for known in table.values()]
        for kind, table in tables.items()
    }


@router.get("/control-sets")
def list_control_sets(caller: AnimatorDep) -> list[ControlSetView]:
    """Known control sets."""
    return [ControlSetView(id=name, controls=len(make())) for name, make in KNOWN.items()]


@router.get("/control-sets/{control_set}", responses=problems(404))
def show_control_set(
    control_set: Annotated[str, Path(max_length=64, examples=["metahuman-185@mh4"])],
    caller: AnimatorDep,
) -> list[ControlView]:
    """Names, ranges and rest values of the controls of a set, in order."""
    known = known_controls(control_set)
    if known is None:
        raise Problem(404, f"no such control set; known: {', '.join(KNOWN)}", "control_set_unknown")
    return [
        ControlView(name=c.name, minimum=c.minimum, maximum=c.maximum, rest=c.rest)
        for c in known.controls
    ]
