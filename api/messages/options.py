"""Options of an animation, from the query or a form to an order; formats of its answer.

The fields of an acting go to the worker as they were sent, which reads them whole; here they are
checked but for tables of keys and files.
"""

import json
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from api.compute.order import ACTING
from api.errors import Problem
from deitalk.acting import Acting
from deitalk.audio.choice import MOST_TRACKS, AudioChoice
from deitalk.audio.original import start_of
from deitalk.emotions.track_files import is_table
from rig.curves.edit import parse_gains
from rig.errors import quoted
from rig.formats import FORMATS
from rig.limits import MOST_DELAY, MOST_HANDLES

NAME_PATTERN = r"^[A-Za-z0-9](?:[A-Za-z0-9 _-]{0,62}[A-Za-z0-9])?$"
TIMECODE_PATTERN = r"^(zero|recording|[0-9]{1,2}:[0-9]{2}:[0-9]{2}([:;][0-9]{2}|\.[0-9]{1,6})?)$"
FIELD_FILES = ("emotion", "intensity_curve", "voice", "words", "script", "edit", "after", "into")
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
    """

    options: Options
    fields: dict[str, Any]
    sent: dict[str, str]


Gain = Annotated[
    str | None,
    Field(
        max_length=4096,
        description="Factors on controls or regions, around rest: `brow=0.5,mouth=1.2`.",
        examples=["brow=0.5"],
    ),
]


class SpeechOptions(Acting):
    """What to make of a recording: an acting, and of what kind the answer is."""

    model: Annotated[
        str, Field(max_length=64, description="A name of /v1/models.", examples=["default"])
    ] = "default"
    fps: Annotated[
        float | None, Field(ge=1, le=240, description="Rate of the result, Hz; 30 by default.")
    ] = None
    format: Annotated[
        str | None, Field(max_length=32, description="Kind of file; else that of `Accept`.")
    ] = None
    name: Annotated[
        str | None, Field(pattern=NAME_PATTERN, description="Name of the result's file.")
    ] = None
    wait: Annotated[
        bool, Field(description="False: answer 202 with a job, whatever the length.")
    ] = True
    track: Annotated[
        int | None,
        Field(ge=1, le=MOST_TRACKS, description="Sound track; else the first with speech."),
    ] = None
    channel: Annotated[
        str | None,
        Field(
            max_length=16,
            description="A number from 1 on, left, right, centre, loudest or mix; else the centre "
            "of surround sound, or the mean of all.",
            examples=["left"],
        ),
    ] = None
    raw: Annotated[
        str | None,
        Field(
            max_length=64,
            description="Form of samples without a header: encoding, Hz, channels.",
            examples=["s16le,24000,1"],
        ),
    ] = None


Delay = Annotated[
    int,
    Field(
        ge=-MOST_DELAY,
        le=MOST_DELAY,
        description="Frames by which the face is late against the sound; early if negative.",
    ),
]
Handles = Annotated[int, Field(ge=0, le=MOST_HANDLES, description="Frames added before and after.")]


class AnimationOptions(SpeechOptions):
    """The same, for curves."""

    timecode: Annotated[
        str,
        Field(
            pattern=TIMECODE_PATTERN,
            description="Of the first frame: zero, recording (that of a WAV), or HH:MM:SS:FF "
            "(;FF for drop frame).",
            examples=["recording", "10:00:00:12", "10:00:00;12"],
        ),
    ] = "zero"
    delay: Delay = 0
    handles: Handles = 0


class MeshOptions(SpeechOptions):
    """The same, for a mesh."""

    speaker: Annotated[
        str,
        Field(max_length=64, description="Embedded head, or speaker of a mesh model."),
    ] = "0"


class RetargetOptions(SpeechOptions):
    """The same, for a mesh that the request sends."""

    method: Annotated[
        str,
        Field(pattern="^(displacements|gradients)$", description="How shapes are made for a mesh."),
    ] = "displacements"
    as_neutral: Annotated[bool, Field(description="Ignore the mesh's own shapes.")] = False
    curves_fps: Annotated[
        float | None, Field(ge=1, le=240, description="Rate of curves without one.")
    ] = None


class ConversionOptions(BaseModel):
    """What to make of a file of curves."""

    model_config = ConfigDict(extra="forbid")

    format: Annotated[
        str | None, Field(max_length=32, description="Kind of file; else that of `Accept`.")
    ] = None
    fps: Annotated[
        float | None,
        Field(ge=1, le=240, description="Rate of the result, Hz; as it is by default."),
    ] = None
    curves_fps: Annotated[
        float | None, Field(ge=1, le=240, description="Rate of curves without one.")
    ] = None
    gain: Gain = None
    delay: Delay = 0
    handles: Handles = 0
    name: Annotated[
        str | None, Field(pattern=NAME_PATTERN, description="Name of the result's file.")
    ] = None

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


# Files that a request can be answered with: names, suffixes, media types.
#
# A request names one by ``?format=`` or by its ``Accept`` header.


MEDIA_TYPES = {
    ".csv": "text/csv; charset=utf-8",
    ".json": "application/json",
    ".npz": "application/x-npz",
    ".txt": "text/plain; charset=utf-8",
    ".tsv": "text/tab-separated-values; charset=utf-8",
    ".anim": "application/yaml",
    ".vrma": "model/gltf-binary",
    ".py": "text/x-python; charset=utf-8",
    ".glb": "model/gltf-binary",
    ".fbx": "application/octet-stream",
    ".usd": "model/vnd.usd",
    ".zip": "application/zip",
    ".mp4": "video/mp4",
    ".html": "text/html; charset=utf-8",
    ".gz": "application/gzip",
}


@dataclass(frozen=True)
class OutputFormat:
    """A kind of file, with the text on it in the documentation."""

    name: str
    suffix: str
    description: str
    cost: float = 0.1
    """Seconds of one processor for a second of sound, rounded up (`python -m tests.api.load
    --formats`); what takes longer than a client should wait for becomes a job."""

    def at_once_seconds(self, work_seconds: float) -> float:
        """Longest recording, seconds, that takes a twelfth of the longest work on a request."""
        return work_seconds / 12 / self.cost

    @property
    def media_type(self) -> str:
        """Value of ``Content-Type``."""
        return MEDIA_TYPES["." + self.suffix.rpartition(".")[2]]


COSTS = {"glb": 1.0, "fbx": 2.0, "usd": 0.2}
"""Of formats of curves that draw a head; others have the default."""
PACKAGES = {"usd": "pxr", "fbx": "bpy"}
"""Optional ones that a format needs."""
CURVE_FORMATS = {
    known.name: OutputFormat(
        known.name, known.suffixes[0], known.description, COSTS.get(known.name, 0.1)
    )
    for known in FORMATS
    if known.write and find_spec(PACKAGES.get(known.name, "numpy"))
}
_READ = [known for known in FORMATS if known.read and known.name != "fbx"]
CURVE_SUFFIXES = tuple(sorted((s for known in _READ for s in known.suffixes), key=len))[::-1]
"""Of curves that are read, longer ones first. An FBX would be opened by Blender, without limits."""
ANIMATION_FORMATS = CURVE_FORMATS | {
    "take": OutputFormat("take", ".zip", "the take folder of `deitalk animate`, zipped"),
    "mp4": OutputFormat("mp4", ".mp4", "review video, 960 x 720", cost=3.0),
    "page": OutputFormat("page", ".html", "preview page in one file, offline"),
    "packed": OutputFormat("packed", ".packed.gz", "arrays that the studio shows, and the sound"),
}
MESH_FORMATS = {
    "glb": OutputFormat("glb", ".glb", "morph targets and their animation", cost=0.7),
    "npz": OutputFormat("npz", ".npz", "vertices (T, V, 3) and triangles", cost=0.4),
    "ply": OutputFormat("ply", ".zip", "one PLY file a frame, zipped", cost=0.8),
}


def choose_format(
    formats: dict[str, OutputFormat], name: str | None, accept: str | None, default: str
) -> OutputFormat:
    """Return the format that a request is to be answered in.

    Parameters
    ----------
    formats : dict
        `ANIMATION_FORMATS` or `MESH_FORMATS`.
    name : str or None
        Of ``?format=``; it goes before `accept`.
    accept : str or None
        The header: the first media type that fits, in the order of ``q``.
    default : str
        Name of the format for ``*/*`` or no header.

    Raises
    ------
    Problem
        400 if there is no such format.
    """
    known = ", ".join(formats)
    if name is not None:
        if name not in formats:
            raise Problem(400, f"format {quoted(name)} is none of {known}", "format_unknown")
        return formats[name]
    # Media types of an ``Accept`` header, the most wanted first.
    header = accept or "*/*"
    found = []
    for part in header[:1000].split(","):
        media_type, *options = (piece.strip().lower() for piece in part.split(";"))
        weight = next((o[2:] for o in options if o.startswith("q=")), "1")
        try:
            found.append((-float(weight), media_type))
        except ValueError:
            continue
    wanted = [media_type for weight, media_type in sorted(found, key=lambda w: w[0]) if weight < 0]
    for media_type in wanted:
        if media_type in ("*/*", "application/*") or media_type == "application/problem+json":
            return formats[default]
        for known_format in formats.values():
            own = known_format.media_type.partition(";")[0]
            if media_type == own or media_type == own.partition("/")[0] + "/*":
                return known_format
    raise Problem(
        400, f"Accept {quoted(accept)} fits none of the formats {known}", "format_unknown"
    )
