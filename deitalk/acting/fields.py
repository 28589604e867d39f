"""Text forms of the fields of an acting, parsed once, and the files that they may name."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import ValidationInfo

from deitalk.errors import ConfigError, DataError, EmotionError
from rig import limits
from rig.errors import UserError, quoted

if TYPE_CHECKING:
    from deitalk.emotions import ActorReference, EmotionTrack, IntensityCurve
    from deitalk.postprocess.life.amounts import Life

    Track = EmotionTrack | Literal["auto"]
else:  # their modules need numpy, which a command line does without until it works
    ActorReference = EmotionTrack = IntensityCurve = Life = Track = Any

AUTO = "auto"
"""Emotion that stands for the one that the voice suggests."""
LONGEST_LISTENING = 600.0
"""Seconds."""
MOST_INTENSITY = 4.0
LONGEST_TEXT = 1 << 20
"""Letters of a text that comes from elsewhere."""
PHONES = "phones:"
"""Before words that are written as phones."""
WORDS_SUFFIXES = (".txt", ".csv", ".tsv", ".textgrid")
_KINDS = {".csv": "table", ".tsv": "table", ".textgrid": "grid"}


@dataclass(frozen=True)
class Words:
    """What is said: text, a table of words and their times, or a TextGrid.

    Attributes
    ----------
    text : str
        The words themselves, or the content of the file.
    are_phones : bool
        Whether they are written as phones, ARPABET or IPA.
    kind : str
        ``text``, ``table`` (columns start, end, word or phone) or ``grid``.
    source : str
        Name of the file; empty of a text.
    """

    text: str
    are_phones: bool = False
    kind: str = "text"
    source: str = field(default="", compare=False)

    @classmethod
    def of(cls, given: "str | Path | Words", files: Mapping[str, Path] | None = None) -> "Words":
        """Read words, or the file that is named; ``phones:`` before them marks phones.

        Raises
        ------
        DataError
            If it is neither text nor path, or the file cannot be read.
        """
        if isinstance(given, Words):
            return given
        if not isinstance(given, str | Path):
            raise DataError(f"words {quoted(given)} must be a text or a path")
        text = str(given)
        are_phones = text.lower().startswith(PHONES)
        text = text[len(PHONES) :] if are_phones else text
        if isinstance(given, Path) or _names_words(text):
            path = _file(text.strip(), files, DataError)
            suffix = path.suffix.lower()
            if suffix not in WORDS_SUFFIXES:
                known = ", ".join(WORDS_SUFFIXES)
                raise DataError(f"{path}: suffix {quoted(suffix)} is none of {known}")
            from rig.files.reading import read_text

            content = read_text(path, limits.TRANSCRIPT_BYTES, error=DataError)
            return cls(content, are_phones, _KINDS.get(suffix, "text"), path.name)
        if len(text) > limits.TRANSCRIPT_BYTES:
            raise DataError(f"the words have more than {limits.TRANSCRIPT_BYTES} characters")
        return cls(text if "\n" in text else text.strip(), are_phones, _kind(text))

    def __str__(self) -> str:
        return f"{PHONES} {self.text}" if self.are_phones else self.text


def _names_words(text: str) -> bool:
    return "\n" not in text.strip() and text.strip().lower().endswith(WORDS_SUFFIXES)


def _kind(text: str) -> str:
    if "ooTextFile" in text[:200]:
        return "grid"
    header = {cell.strip().lower() for cell in _cells(text.lstrip().partition("\n")[0])}
    return "table" if "\n" in text and {"start", "end"} <= header else "text"


def _cells(line: str) -> list[str]:
    return line.split(max(",;\t", key=line.count))


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
    if isinstance(given, str) and given.lstrip().startswith("{"):
        return parse_actor(given.encode(errors="replace"), "voice")
    return read_actor(_file(str(given).strip(), _files(info)))


def read_words(given: Any, info: ValidationInfo) -> Words:
    """Words, a file of them, or its content."""
    return Words.of(given, _files(info))


def number_within(low: float, high: float) -> Callable[[Any, ValidationInfo], float]:
    """A finite number within limits, or its text with a decimal point or comma."""

    def check(given: Any, info: ValidationInfo) -> float:
        number = given
        if isinstance(given, str):
            try:
                number = float(given.strip().replace(",", "."))
            except ValueError:
                number = None
        is_number = isinstance(number, Real) and not isinstance(number, bool)
        if not is_number or not low <= float(number) <= high:
            raise ConfigError(
                f"{info.field_name} {quoted(given)} must be a number, {low:g} to {high:g}"
            )
        return float(number)

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


def read_place(given: Any) -> tuple[float, float]:
    """Two angles, or their text."""
    from deitalk.postprocess.life.amounts import place_of

    return place_of(given)


def read_gains(given: Any) -> dict[str, float]:
    """Factors by control or region, of a mapping or text."""
    from rig.curves.edit import parse_gains

    return parse_gains(given or None)


def written_gains(gains: Mapping[str, float]) -> str:
    """The text that `read_gains` reads."""
    return ",".join(f"{name}={factor:.9g}" for name, factor in gains.items())


def written_place(place: tuple[float, float]) -> str:
    """The text that `read_place` reads."""
    return ",".join(f"{part:.9g}" for part in place)
