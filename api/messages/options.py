"""Options of an animation: from the query or a form, checked, to the options of an order.

An emotion or an intensity curve comes as text; what is longer than one label is written into the
order's folder under a fixed name and read there by `deitalk.emotions`.
"""

import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from deitalk.audio.original import start_of
from deitalk.emotions import EMOTIONS, parse_emotion
from deitalk.errors import EmotionError
from rig.curves.edit import parse_gains
from rig.errors import quoted
from rig.files.reading import load_json
from rig.limits import SEED

LONGEST_TEXT = 1 << 20
NAME_PATTERN = r"^[A-Za-z0-9](?:[A-Za-z0-9 _-]{0,62}[A-Za-z0-9])?$"
TIMECODE_PATTERN = r"^(zero|recording|[0-9]{1,2}:[0-9]{2}:[0-9]{2}(:[0-9]{2}|\.[0-9]{1,6})?)$"
_WRITTEN = ("transcript", "phones")
"""Options whose text becomes a file of the order, so that no text is taken for a path."""
_LABEL = re.compile(r"[A-Za-z]{1,40}")
_PAIR = r"\s*[A-Za-z]{1,40}\s*=\s*[0-9.eE+-]{1,40}\s*"
_WEIGHTS = re.compile(rf"{_PAIR}(?:,{_PAIR}){{0,20}}")


Gain = Annotated[
    str | None,
    Field(
        max_length=4096,
        description="Factors on controls or regions, around rest: `brow=0.5,mouth=1.2`.",
        examples=["brow=0.5"],
    ),
]


class MotionOptions(BaseModel):
    """What to make of a recording."""

    model_config = ConfigDict(extra="forbid")

    emotion: Annotated[
        str,
        Field(
            max_length=LONGEST_TEXT,
            description="A label; weights `happy=0.7,surprised=0.3`; a JSON object of weights; or "
            "keyframes as a JSON list of `{time, emotion, strength}` or as CSV.",
            examples=["happy", "happy=0.7,surprised=0.3"],
        ),
    ] = "neutral"
    intensity: Annotated[
        float, Field(ge=0, le=4, description="Factor on the intensity predicted from the voice.")
    ] = 1.0
    intensity_curve: Annotated[
        str | None,
        Field(
            max_length=LONGEST_TEXT,
            description="Intensity instead of the predicted one: JSON list of `{time, intensity}` "
            "or CSV, such as a take's intensity.csv.",
        ),
    ] = None
    model: Annotated[
        str, Field(max_length=64, description="A name of /v1/models.", examples=["default"])
    ] = "default"
    fps: Annotated[
        float | None, Field(ge=1, le=240, description="Rate of the result, Hz; 30 by default.")
    ] = None
    seed: Annotated[
        int, Field(ge=0, le=SEED, description="Another drawing of the idle motion.")
    ] = 0
    idle: Annotated[bool, Field(description="Blinks, gaze, brows and head on the voice.")] = True
    life: Annotated[
        str | None,
        Field(
            max_length=200,
            description="Factors on them, 0 to 2.",
            examples=["brows=.8,head=1.2,blinks=1,gaze=.5"],
        ),
    ] = None
    look_at: Annotated[
        str,
        Field(
            max_length=60,
            description="Place of the listener: degrees to the character's left and up.",
            examples=["10,-5"],
        ),
    ] = "0,0"
    listen: Annotated[
        float, Field(ge=0, le=600, description="Seconds of living silence after the speech.")
    ] = 0.0
    transcript: Annotated[
        str | None,
        Field(
            max_length=LONGEST_TEXT,
            description="What is said: its closures are met where the sound agrees; a note where "
            "it does not.",
            examples=["My promise is big."],
        ),
    ] = None
    phones: Annotated[
        str | None,
        Field(
            max_length=LONGEST_TEXT,
            description="The same as phones, ARPABET or IPA.",
            examples=["M AY | P R AA M AH S"],
        ),
    ] = None
    language: Annotated[
        str,
        Field(pattern="^[A-Za-z0-9-]{2,32}$", description="espeak-ng's voice for the words."),
    ] = "en-us"
    raw: Annotated[bool, Field(description="The network alone, without the model's rules.")] = False
    format: Annotated[
        str | None, Field(max_length=32, description="Kind of file; else that of `Accept`.")
    ] = None
    name: Annotated[
        str | None, Field(pattern=NAME_PATTERN, description="Name of the result's file.")
    ] = None
    wait: Annotated[
        bool, Field(description="False: answer 202 with a job, whatever the length.")
    ] = True
    webhook: Annotated[
        str | None,
        Field(max_length=500, description="Address to call when a job has ended."),
    ] = None


class AnimationOptions(MotionOptions):
    """The same, for curves."""

    gain: Gain = None
    timecode: Annotated[
        str,
        Field(
            pattern=TIMECODE_PATTERN,
            description="Of the first frame: zero, recording (that of a WAV), or HH:MM:SS:FF.",
            examples=["recording", "10:00:00:12"],
        ),
    ] = "zero"


class MeshOptions(MotionOptions):
    """The same, for a mesh."""

    speaker: Annotated[
        str,
        Field(max_length=64, description="Embedded head, or speaker of a mesh model."),
    ] = "0"


class RetargetOptions(MotionOptions):
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
    name: Annotated[
        str | None, Field(pattern=NAME_PATTERN, description="Name of the result's file.")
    ] = None

    def order_options(self) -> dict[str, Any]:
        """Return the options of an order."""
        given = self.model_dump(exclude={"format"}, exclude_none=True)
        return given | ({"gain": parse_gains(self.gain)} if self.gain is not None else {})


def order_options(options: MotionOptions, folder: Path, files: set[str]) -> dict[str, Any]:
    """Return the options of an order; texts of keys become files in its folder.

    Parameters
    ----------
    options : MotionOptions
        Of the request.
    folder : Path
        Of the order.
    files : set of str
        Files that the request sent already, such as ``emotion.csv``.

    Raises
    ------
    EmotionError
        If the emotion is none.
    DeitalkError
        If a time code is beyond a day or its second.
    """
    given = options.model_dump(
        exclude={*_WRITTEN, "emotion", "intensity_curve", "format", "wait", "webhook"},
        exclude_none=True,
    )
    sent = {name.partition(".")[0]: name for name in files}
    given["emotion"] = sent.get("emotion") or _emotion(options.emotion, folder)
    if (curve := sent.get("intensity")) is not None:
        given["intensity_curve"] = curve
    elif options.intensity_curve is not None:
        given["intensity_curve"] = _keys(options.intensity_curve, folder, "intensity")
    if "timecode" in given:
        start_of(given["timecode"], options.fps, None)
    for name in _WRITTEN:
        text = getattr(options, name)
        if name in sent:
            given[name] = sent[name]
        elif text is not None:
            given[name] = f"{name}.txt"
            (folder / given[name]).write_text(text, encoding="utf-8", errors="replace")
    if "gain" in given:
        given["gain"] = parse_gains(given["gain"])
    speaker = given.get("speaker", "")
    if speaker.isascii() and speaker.isdigit():
        given["speaker"] = int(speaker)
    return given


def weights_of(text: str) -> dict[str, float]:
    """Return the weights of a label or of ``happy=0.7,…``; a name of a file is refused.

    Raises
    ------
    EmotionError
        If the text is neither.
    """
    if _LABEL.fullmatch(text) is None and _WEIGHTS.fullmatch(text) is None:
        raise EmotionError(
            f"unknown emotion {quoted(text)}; known are {', '.join(EMOTIONS)}, weights are written "
            "happy=0.7,surprised=0.3, and keyframes are JSON or CSV"
        )
    row = parse_emotion(text).weights[0]
    return {name: float(weight) for name, weight in zip(EMOTIONS, row, strict=True) if weight}


def _emotion(text: str, folder: Path) -> dict[str, float] | str:
    stripped = text.strip()
    if stripped.startswith("{"):
        weights = load_json(stripped, "emotion", error=EmotionError)
        if "keys" in weights:
            return _keys(stripped, folder, "emotion")
        return dict(weights)
    if stripped.startswith("[") or "\n" in stripped:
        return _keys(stripped, folder, "emotion")
    return weights_of(stripped)


def _keys(text: str, folder: Path, name: str) -> str:
    """Write keys as JSON or CSV; return the file's name."""
    is_json = text.lstrip()[:1] in ("[", "{")
    file = f"{name}.{'json' if is_json else 'csv'}"
    (folder / file).write_text(text, encoding="utf-8", errors="replace")
    return file
