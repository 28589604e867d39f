"""Text forms of the fields of an acting, parsed once, and the files that they may name."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import nan
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from pydantic import ValidationInfo

from deitalk.errors import ConfigError, DataError, EmotionError
from deitalk.postprocess.life.listener import NO_PLACE
from rig import limits
from rig.emotions import VARIANTS
from rig.errors import UserError, quoted
from rig.written_number import number_of

if TYPE_CHECKING:
    from deitalk.emotions import ActorReference as ActorReference
    from deitalk.emotions import EmotionTrack as EmotionTrack
    from deitalk.emotions import IntensityCurve as IntensityCurve
    from deitalk.postprocess.edges import Edge as Edge
    from deitalk.postprocess.life.amounts import Life as Life
    from deitalk.postprocess.life.other import OtherVoice as OtherVoice
    from rig.curves.layers import Layer as Layer

    Track = EmotionTrack | Literal["auto"]
else:  # their modules need numpy, which a command line does without until it works
    ActorReference = Edge = EmotionTrack = IntensityCurve = Layer = Life = Any
    OtherVoice = Track = Any


AUTO: Final = "auto"
"""Emotion that stands for the one that the voice suggests."""
LONGEST_LISTENING = 600.0
"""Seconds."""
MOST_INTENSITY = 4.0
LONGEST_TEXT = 1 << 20
"""Letters of a text that comes from elsewhere."""
WORDS_SUFFIXES = (".txt", ".textgrid", ".srt", ".vtt")
VARIANT_NAMES = "; ".join(f"{name}: {', '.join(own)}" for name, own in VARIANTS.items())
SCRIPT_SUFFIXES = (".txt", ".srt", ".vtt", ".ssml", ".xml")
_KINDS = {
    ".ssml": "ssml",
    ".xml": "ssml",
    ".textgrid": "grid",
    ".srt": "subtitles",
    ".vtt": "subtitles",
}
_SUFFIX = re.compile(r"\S\.[A-Za-z][A-Za-z0-9]{1,7}$")
_CUE = re.compile(r"^\s*[\d:]+[.,]\d+ +--> +[\d:]+[.,]\d+", re.M)


@dataclass(frozen=True)
class Words:
    """Spoken words: text, a TextGrid of Praat, or subtitles (SubRip or WebVTT).

    Attributes
    ----------
    text : str
        The words themselves, or the content of the file.
    kind : str
        ``text``, ``grid``, ``subtitles`` or ``ssml``.
    source : str
        Name of the file; empty of a text.
    """

    text: str
    kind: str = "text"
    source: str = field(default="", compare=False)

    @classmethod
    def of(
        cls,
        given: "str | Path | Words",
        files: Mapping[str, Path] | None = None,
        what: str = "words",
    ) -> "Words":
        """Read words, or the file that is named: a line that ends with a suffix such as ``.txt``.

        `what` they are, ``words`` or ``script``, determines the suffixes.

        Raises
        ------
        DataError
            If it is neither text nor path, or the file cannot be read.
        """
        if isinstance(given, Words):
            return given
        if not isinstance(given, str | Path):
            raise DataError(f"{what} {quoted(given)} must be a text or a path")
        text = str(given)
        if isinstance(given, Path) or _names_file(text):
            path = Path(text.strip())
            suffix = path.suffix.lower()
            suffixes = WORDS_SUFFIXES if what == "words" else SCRIPT_SUFFIXES
            if suffix not in suffixes:
                known = ", ".join(suffixes)
                raise DataError(
                    f"{what} {quoted(str(path))}: a file of words is one of {known}; if this is "
                    "spoken, end it with a full stop"
                )
            from rig.files.reading import read_text

            path = _file(str(path), files, DataError)
            content = read_text(path, limits.TRANSCRIPT_BYTES, error=DataError)
            return cls(content, _KINDS.get(suffix, "text"), path.name)
        if len(text) > limits.TRANSCRIPT_BYTES:
            raise DataError(f"the {what} have more than {limits.TRANSCRIPT_BYTES} characters")
        return cls(text if "\n" in text else text.strip(), _kind(text))

    def __str__(self) -> str:
        return self.text


def _names_file(text: str) -> bool:
    return "\n" not in text.strip() and _SUFFIX.search(text.strip()) is not None


def _kind(text: str) -> str:
    """Kind of a file's content that is given in place of its name."""
    if "ooTextFile" in text[:200]:
        return "grid"
    if re.match(r"\s*(<\?xml|<!DOCTYPE|<speak\b)", text):
        return "ssml"
    return "subtitles" if _CUE.search(text) else "text"


def _file(
    name: str, files: Mapping[str, Path] | None, error: type[UserError] = EmotionError
) -> Path:
    """Path of a named file: anywhere on this disk, or only one of `files`."""
    if not name:
        raise error("an empty path; name a file")
    if files is None:
        return Path(name)
    if name not in files:
        raise error(f"file {quoted(name)} was not sent; send it with the request, or its content")
    return files[name]


def _files(info: ValidationInfo) -> Mapping[str, Path] | None:
    return None if info.context is None else info.context["files"]


def neutral_track() -> Track:
    """The default emotion."""
    from deitalk.emotions import parse_emotion

    return parse_emotion("neutral")


def read_emotion(given: Any, info: ValidationInfo) -> Track:
    """A label, weights, keys, a file of them, or ``auto``."""
    from deitalk.emotions import EmotionTrack, parse_emotion
    from deitalk.emotions.tracks import names_track

    if not isinstance(given, str | Path | Mapping | EmotionTrack):
        raise EmotionError(
            f"emotion {quoted(given)} is a {type(given).__name__}; give a name, weights such as "
            "{'happy': 0.7}, a file or an EmotionTrack"
        )
    if given == AUTO:
        return AUTO
    if isinstance(given, str | Path) and names_track(given):
        given = _file(str(given).strip(), _files(info))
    return parse_emotion(given)


def read_curve(given: Any, info: ValidationInfo) -> IntensityCurve:
    """A curve, a file of one, or its content."""
    from deitalk.emotions import IntensityCurve, parse_intensity_curve
    from deitalk.emotions.track_files import is_table

    if not isinstance(given, str | Path | IntensityCurve):
        raise EmotionError(
            f"intensity_curve {quoted(given)} is a {type(given).__name__}; give a file or an "
            "IntensityCurve"
        )
    if isinstance(given, Path) or (isinstance(given, str) and not is_table(given)):
        given = _file(str(given).strip(), _files(info))
    return parse_intensity_curve(given)


def read_voice(given: Any, info: ValidationInfo) -> ActorReference:
    """A reference of an actor, a file of one, or its content."""
    from deitalk.emotions import ActorReference, parse_actor, read_actor

    if isinstance(given, ActorReference):
        return given
    if isinstance(given, Mapping):
        return parse_actor(json.dumps(dict(given)).encode(), "voice")
    if not isinstance(given, str | Path):
        raise EmotionError(
            f"voice {quoted(given)} is a {type(given).__name__}; give a file or an ActorReference"
        )
    if isinstance(given, str) and (given.lstrip().startswith("{") or "\n" in given):
        return parse_actor(given.encode(errors="replace"), "voice")
    return read_actor(_file(str(given).strip(), _files(info)))


def read_edge(given: Any, info: ValidationInfo) -> Edge:
    """The edge of the take beside: a take folder, a file of curves, a performance, its content."""
    from deitalk.postprocess.edges import edge_of

    if isinstance(given, str | Path) and not str(given).lstrip().startswith("{"):
        given = _file(str(given).strip(), _files(info), DataError)
    return edge_of(given, str(info.field_name), last=info.field_name == "after")


def read_other(given: Any, info: ValidationInfo) -> OtherVoice:
    """The voice of another one: a recording, its path, or the content that a take keeps."""
    from deitalk.postprocess.life.other import other_voice

    path = None
    if isinstance(given, str | Path) and not str(given).lstrip().startswith("{"):
        path = _file(str(given).strip(), _files(info), DataError)
    return other_voice(given, "listen_to", path)


def read_words(given: Any, info: ValidationInfo) -> Words:
    """Words, a file of them, or its content."""
    return Words.of(given, _files(info), str(info.field_name))


def number_within(
    low: float, high: float, *, percent: bool = True
) -> Callable[[Any, ValidationInfo], float]:
    """A finite number within limits, or its text (`rig.written_number`)."""

    def check(given: Any, info: ValidationInfo) -> float:
        number = number_of(given, percent=percent) if isinstance(given, str | Real) else nan
        if not low <= number <= high:
            raise ConfigError(
                f"{info.field_name} {quoted(given)} must be a number, {low:g} to {high:g}"
            )
        return number

    return check


def read_seed(given: Any) -> int:
    """A whole number up to `rig.limits.SEED`, or its text."""
    number = int(given) if isinstance(given, str) and given.strip().isdecimal() else given
    is_whole = isinstance(number, Integral) and not isinstance(number, bool)
    if not is_whole or not 0 <= int(number) <= limits.SEED:
        raise ConfigError(f"seed {quoted(given)} must be a whole number, 0 to 2**63 - 1")
    return int(number)


def read_life(given: Any) -> Life:
    """Factors as text or a mapping, ``on`` or ``off``."""
    from deitalk.postprocess.life.amounts import Life

    return Life.of(given)


def read_place(given: Any) -> tuple[float, float, float]:
    """Two angles with or without a distance, or their text."""
    from deitalk.postprocess.life.amounts import place_of

    return place_of(given)


def read_gains(given: Any) -> dict[str, float]:
    """Factors by control or region, of a mapping or text."""
    from rig.curves.edit import parse_gains

    return parse_gains(given or None)


def read_edit(given: Any, info: ValidationInfo) -> tuple[Layer, ...]:
    """Layers, files of them (a text may name several, with ``;`` between), or their content."""
    from rig.curves.layer_files import parse_layers, read_layers
    from rig.curves.layers import Layer

    if isinstance(given, Layer):
        return (given,)
    if isinstance(given, list | tuple):
        return tuple(layer for part in given for layer in read_edit(part, info))
    if isinstance(given, Mapping) or (isinstance(given, str) and given.lstrip()[:1] in ("[", "{")):
        return parse_layers(given)
    if not isinstance(given, str | Path):
        raise ConfigError(
            f"edit {quoted(given)} is a {type(given).__name__}; give a file, a Layer or a list"
        )
    names = [name.strip() for name in str(given).split(";") if name.strip()]
    files = [_file(name, _files(info), ConfigError) for name in names]
    return tuple(layer for path in files for layer in read_layers(path))


def written_edit(layers: tuple[Layer, ...]) -> str:
    """The text that `read_edit` reads."""
    return json.dumps([layer.tree() for layer in layers], ensure_ascii=False) if layers else ""


def written_gains(gains: Mapping[str, float]) -> str:
    """The text that `read_gains` reads."""
    return ",".join(f"{name}={factor:.9g}" for name, factor in gains.items())


def read_variant(given: Any) -> dict[str, float]:
    """Weights of named variants, of a mapping or text."""
    from deitalk.emotions.variants import parse_variant

    return parse_variant(given)


def written_variant_text(variant: Mapping[str, float]) -> str:
    """The text that `read_variant` reads."""
    from deitalk.emotions.variants import written_variant

    return written_variant(variant)


def written_place(place: tuple[float, float, float]) -> str:
    """The text that `read_place` reads, without the usual distance."""
    *angles, distance = place
    parts = angles if distance == NO_PLACE[2] else place
    return ",".join(f"{part:.9g}" for part in parts)
