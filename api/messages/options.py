"""Options of an animation, from the query or a form to an order; formats of its answer.

The fields of an acting go to the worker as they were sent, which reads them whole; here they are
checked but for tables of keys and files.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from api.compute.order import ACTING
from deitalk.acting import Acting
from deitalk.audio.choice import MOST_TRACKS, AudioChoice
from deitalk.audio.original import start_of
from deitalk.config.section import Pattern
from deitalk.emotions.track_files import is_table
from rig.curves.edit import parse_gains
from rig.curves.layer_diff import TOLERANCE
from rig.limits import FPS_HIGHEST, FPS_LOWEST, MOST_DELAY, MOST_HANDLES

FIELD_FILES = (
    "emotion", "intensity_curve", "voice", "words", "script", "edit", "listen_to", "after", "into"
)  # fmt: skip
"""Fields that may be files of a form."""
Options = TypeVar("Options", bound=BaseModel)


@dataclass(frozen=True)
class Received(Generic[Options]):
    """A request.

    Attributes
    ----------
    options : model
        Checked.
    fields : dict
        The options as they were sent.
    sent : dict
        The fixed file name of each part that was sent.
    names : dict
        The name of each of these files as it was sent: for titles, never a path.
    """

    options: Options
    fields: dict[str, Any]
    sent: dict[str, str]
    names: dict[str, str]


Rate = Annotated[float | None, Field(ge=FPS_LOWEST, le=FPS_HIGHEST)]
Format = Annotated[
    str | None, Field(max_length=32, description="Kind of file; else that of `Accept`.")
]
NAME = Pattern(
    r"[A-Za-z0-9](?:[A-Za-z0-9 _-]{0,62}[A-Za-z0-9])?",
    "1 to 64 of A to Z, a to z, 0 to 9, _ - and spaces, a letter or digit first and last",
)
Name = Annotated[str, NAME] | None
TIMECODE = Pattern(
    r"(zero|recording|[0-9]{1,2}:[0-9]{2}:[0-9]{2}([:;][0-9]{2}|\.[0-9]{1,6})?)",
    "zero, recording or HH:MM:SS:FF (;FF for drop frame)",
)
Delay = Annotated[
    int,
    Field(
        ge=-MOST_DELAY,
        le=MOST_DELAY,
        description="Frames by which the face is late against the sound; early if negative.",
    ),
]
Handles = Annotated[int, Field(ge=0, le=MOST_HANDLES, description="Frames added before and after.")]


class SpeechOptions(Acting):
    """Options of a recording's animation: an acting, and the kind of the answer."""

    model: str = Field(
        "default", max_length=64, description="A name of /v1/models.", examples=["default"]
    )
    fps: Rate = Field(None, description="Rate of the result, Hz; 30 by default.")
    format: Format = None
    name: Name = Field(None, description="Name of the result's file.")
    wait: bool = Field(True, description="False: answer 202 with a job, whatever the length.")
    track: int | None = Field(
        None, ge=1, le=MOST_TRACKS, description="Sound track; else the first with speech."
    )
    channel: str | None = Field(
        None,
        max_length=16,
        description="A number from 1 on, left, right, centre, loudest or mix; else the centre "
        "of surround sound, or the mean of all.",
        examples=["left"],
    )
    raw: str | None = Field(
        None,
        max_length=64,
        description="Form of samples without a header: encoding, Hz, channels.",
        examples=["s16le,24000,1"],
    )


class AnimationOptions(SpeechOptions):
    """Options of curves of a recording."""

    timecode: Annotated[str, TIMECODE] = Field(
        "zero",
        description="Of the first frame: zero, recording (that of a WAV), or HH:MM:SS:FF "
        "(;FF for drop frame).",
        examples=["recording", "10:00:00:12", "10:00:00;12"],
    )
    delay: Delay = 0
    handles: Handles = 0


class DubOptions(AnimationOptions):
    """Options of another voice for a performance that the request sends."""

    stretch: float = Field(
        1.5, ge=1, le=3, description="Most by which phrases are played slower or faster."
    )
    curves_fps: Rate = Field(None, description="Rate of a performance without one.")


class DiffOptions(BaseModel):
    """Options of the comparison of an edited file with its take."""

    model_config = ConfigDict(extra="forbid")

    fps: Rate = Field(None, description="Rate of the edited file, Hz, if it does not contain it.")
    tolerance: float = Field(
        TOLERANCE,
        ge=0.001,
        le=0.2,
        description="How far curves with the layer may be from the edited ones; half of it is "
        "noise.",
    )
    delay: Delay = 0
    handles: Handles = 0
    name: Name = Field(None, description="Name of the layer; else that of `edited`.")


class MeshOptions(SpeechOptions):
    """Options of a moving mesh of a recording."""

    speaker: str = Field(
        "0", max_length=64, description="Embedded head, or speaker of a mesh model."
    )


class RetargetOptions(SpeechOptions):
    """Options of a recording or curves on a mesh that the request sends."""

    method: Literal["displacements", "gradients"] = Field(
        "displacements", description="How shapes are made for a mesh."
    )
    as_neutral: bool = Field(False, description="Ignore the mesh's own shapes.")
    curves_fps: Rate = Field(None, description="Rate of curves without one.")


class ConversionOptions(BaseModel):
    """Options of the conversion of a file of curves."""

    model_config = ConfigDict(extra="forbid")

    format: Format = None
    fps: Rate = Field(None, description="Rate of the result, Hz; as it is by default.")
    curves_fps: Rate = Field(None, description="Rate of curves without one.")
    gain: str | None = Field(
        None,
        max_length=4096,
        description="Factors on controls or regions, around rest: `brow=0.5,mouth=1.2`.",
        examples=["brow=0.5"],
    )
    delay: Delay = 0
    handles: Handles = 0
    name: Name = Field(None, description="Name of the result's file.")

    def order_options(self) -> dict[str, Any]:
        """Return the options of an order."""
        given = self.model_dump(exclude={"format"}, exclude_none=True)
        return given | ({"gain": parse_gains(self.gain)} if self.gain is not None else {})


def is_deferred(name: str, value: Any) -> bool:
    """Whether a field is a table, which the worker process reads: a hostile one harms no other."""
    if name == "edit":
        return isinstance(value, str) and value.lstrip()[:1] in ("[", "{")
    return name in ("emotion", "intensity_curve") and isinstance(value, str) and is_table(value)


def order_options(given: Received[SpeechOptions], folder: Path) -> dict[str, Any]:
    """Return the options of an order; the fields of its acting become a file in its folder.

    Parameters
    ----------
    given : Received
        Of the request.
    folder : Path
        Of the order.

    Raises
    ------
    DeitalkError
        If a time code is beyond a day or its second, or a channel or form of samples is unknown.
    """
    fields, sent = given.fields, given.sent
    acting = {name: fields[name] for name in Acting.model_fields if name in fields}
    acting |= {name: sent[name] for name in FIELD_FILES if name in sent}
    (folder / ACTING).write_text(json.dumps(acting), encoding="utf-8")
    AudioChoice.of(given.options.track, given.options.channel, given.options.raw)
    options = given.options.model_dump(
        exclude={*Acting.model_fields, "format", "wait"}, exclude_none=True
    )
    if "timecode" in options:
        start_of(options["timecode"], given.options.fps, None)
    speaker = options.get("speaker", "")
    if speaker.isascii() and speaker.isdigit():
        options["speaker"] = int(speaker)
    return options | {"sent": sorted(sent.values())}
