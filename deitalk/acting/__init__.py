"""`Acting`: everything that a recording can be asked for, once.

Every way into the package takes these fields and no others: the command line, `deitalk.animate`,
the columns of a batch's manifest, the form and the messages of the service, the page, and the
settings in ``take.json``, which give the same take again. Each field has a text form, which is
parsed here and nowhere else.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    ValidationError,
    WithJsonSchema,
)

from deitalk.acting.fields import (
    AUTO,
    LONGEST_LISTENING,
    LONGEST_TEXT,
    MOST_INTENSITY,
    PHONES,
    WORDS_SUFFIXES,
    ActorReference,
    EmotionTrack,
    IntensityCurve,
    Life,
    Track,
    Words,
    neutral_track,
    number_within,
    read_curve,
    read_emotion,
    read_gains,
    read_life,
    read_place,
    read_seed,
    read_voice,
    read_words,
    written_gains,
    written_place,
)
from deitalk.errors import ConfigError, EmotionError
from rig import limits
from rig.errors import UserError, quoted

__all__ = [
    "AUTO", "LIVE_FIELDS", "LONGEST_TEXT", "OLD_NAMES", "PHONES", "WORDS_SUFFIXES", "Acting",
    "Words", "acted_as", "modern", "renamed", "user_error",
]  # fmt: skip


def _text(schema: str = "string", **more: Any) -> WithJsonSchema:
    return WithJsonSchema({"type": schema, **more})


_STR = PlainSerializer(str, return_type=str, when_used="unless-none")
_TEXT = _text(maxLength=LONGEST_TEXT)


def _extra(live: str = "", **default: str) -> dict[str, Any]:
    """More of a field's schema: when a voice takes it before it has ended, the default as text."""
    return ({"x-live": live} if live else {}) | default


class Acting(BaseModel):
    """How a recording is acted.

    Fields are given as themselves or as text; a field that is a file, as its path, its content or
    what it holds. `Acting.of` reports errors in one line.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    emotion: Annotated[Track, PlainValidator(read_emotion), _STR, _TEXT] = Field(
        default_factory=neutral_track,
        description="neutral, angry, happy, sad, surprised; weights such as "
        "happy=0.7,surprised=0.3; a track (.csv .json .yaml: time, emotion, strength); auto: "
        "suggested from the voice.",
        examples=["happy", "happy=0.7,surprised=0.3"],
        json_schema_extra=_extra("change", default="neutral"),
    )
    intensity: Annotated[
        float,
        PlainValidator(number_within(0.0, MOST_INTENSITY)),
        _text("number", minimum=0, maximum=MOST_INTENSITY),
    ] = Field(
        default=1.0,
        description="Factor on the intensity predicted from the voice, 0 (neutral reading) to 4.",
        json_schema_extra=_extra("change"),
    )
    intensity_curve: Annotated[IntensityCurve | None, PlainValidator(read_curve), _STR, _TEXT] = (
        Field(
            default=None,
            description="Intensity instead of the predicted one: time, intensity, such as a take's "
            "intensity.csv.",
        )
    )
    voice: Annotated[
        ActorReference | None,
        PlainValidator(read_voice),
        PlainSerializer(lambda voice: voice.content, return_type=dict, when_used="unless-none"),
        WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "object"}]}),
    ] = Field(
        default=None,
        description="Usual voice of the speaker, from which intensity counts: a file of `deitalk "
        "actor build`.",
    )
    style: Annotated[str | None, Field(max_length=100)] = Field(
        default=None,
        description="Whose style, of a model tuned on several actors; by default its first.",
        json_schema_extra=_extra("start"),
    )
    words: Annotated[Words | None, PlainValidator(read_words), _STR, _TEXT] = Field(
        default=None,
        description="Spoken words: text, .txt, .csv (start, end, word) or .TextGrid; or `phones:` "
        "and phones (ARPABET or IPA). Closures are met where the sound agrees.",
        examples=["My promise is big.", "phones: M AY | P R AA M AH S"],
    )
    language: Annotated[str, Field(pattern="^[A-Za-z0-9-]{2,32}$")] = Field(
        default="en-us",
        description="espeak-ng's voice for the words: en-us, en-gb, de, fr, es, cmn …",
    )
    life: Annotated[Life, PlainValidator(read_life), _STR, _text(maxLength=200)] = Field(
        default_factory=lambda: read_life("on"),
        description="Factors on blinks, gaze, brows and head, 0 to 2: brows=.8,head=1.2; or off.",
        examples=["brows=.8,head=1.2,blinks=1,gaze=.5", "off"],
        json_schema_extra=_extra("start", default="on"),
    )
    look_at: Annotated[
        tuple[float, float],
        PlainValidator(read_place),
        PlainSerializer(written_place, return_type=str),
        _text(maxLength=60),
    ] = Field(
        default=(0.0, 0.0),
        description="Place of the listener: degrees to the character's left and up, -35 to 35.",
        examples=["10,-5"],
        json_schema_extra=_extra("start", default="0,0"),
    )
    gain: Annotated[
        dict[str, float],
        PlainValidator(read_gains),
        PlainSerializer(written_gains, return_type=str),
        _text(maxLength=4096),
    ] = Field(
        default={},
        description="Factors on how far regions or controls go from rest: jaw=1.2,brow=.8.",
        examples=["jaw=1.2,brow=.8"],
        json_schema_extra=_extra("change", default=""),
    )
    listen: Annotated[
        float,
        PlainValidator(number_within(0.0, LONGEST_LISTENING)),
        _text("number", minimum=0, maximum=LONGEST_LISTENING),
    ] = Field(default=0.0, description="Seconds of silence with motion after the speech, 0 to 600.")
    rules: bool = Field(
        default=True,
        description="The model's rules after the network; without them the network alone.",
        json_schema_extra=_extra("change"),
    )
    seed: Annotated[
        int, PlainValidator(read_seed), _text("integer", minimum=0, maximum=limits.SEED)
    ] = Field(
        default=0,
        description="Another drawing of the motion above the mouth, 0 to 2**63 - 1.",
        json_schema_extra=_extra("start"),
    )

    @classmethod
    def of(
        cls,
        acting: "Acting | None" = None,
        /,
        *,
        files: Mapping[str, Path] | None = None,
        **fields: Any,
    ) -> Self:
        """An acting with these fields; those that are not given, or None, are `acting`'s.

        Parameters
        ----------
        acting : Acting, optional
            The defaults.
        files : mapping of str to Path, optional
            The only files that fields may name, by their names: for requests from elsewhere.
            Any file of this machine by default.
        **fields
            Of this class.

        Raises
        ------
        UserError
            One line: the field, the value, the rule.
        """
        given = {} if acting is None else {n: getattr(acting, n) for n in acting.model_fields_set}
        given |= {name: value for name, value in fields.items() if value is not None}
        try:
            return cls.model_validate(given, context=None if files is None else {"files": files})
        except ValidationError as error:
            raise user_error(error) from None

    @property
    def settings(self) -> dict[str, Any]:
        """Fields other than the defaults, as JSON; `of` them gives the same acting."""
        return self.model_dump(mode="json", exclude_defaults=True, include={*Acting.model_fields})

    @property
    def track(self) -> EmotionTrack:
        """Emotion over time.

        Raises
        ------
        EmotionError
            If it is to be suggested: that takes a whole recording.
        """
        if isinstance(self.emotion, str):
            raise EmotionError("emotion auto needs a whole recording; name an emotion")
        return self.emotion

    @property
    def motion(self) -> Life | None:
        """Motion above the mouth with the listener's place; None if it is off."""
        from deitalk.postprocess.life.amounts import Life

        parts: dict[str, Any] = {
            name: getattr(self.life, name) for name in ("blinks", "gaze", "brows", "head")
        }
        motion = Life(**parts, look_at=self.look_at)
        return None if motion.is_off else motion

    def check_live(self) -> Self:
        """Return this; refuse fields that need the whole recording.

        Raises
        ------
        ConfigError
            Names them.
        """
        whole = [name for name in self.settings if name not in LIVE_FIELDS]
        if whole or self.emotion == AUTO:
            raise ConfigError(
                f"{', '.join(whole) or 'emotion auto'} needs the whole recording; leave it out "
                "while somebody speaks"
            )
        return self


LIVE_FIELDS = {
    name: str(extra["x-live"])
    for name, made in Acting.model_fields.items()
    if isinstance(extra := made.json_schema_extra, dict) and "x-live" in extra
}
"""Fields that a voice takes before it has ended, and when: ``start`` or ``change``."""
OLD_NAMES = {
    "actor": "style",
    "transcript": "words",
    "phones": "words",
    "idle": "life",
    "raw": "rules",
}
"""Former names of fields."""


def renamed(name: str, value: Any) -> tuple[str, Any]:
    """The field, and its value, that a former name and value stand for."""
    if name == "phones":
        value = f"{PHONES} {value}"
    elif name == "idle":
        value = "off" if _is_false(value) else "on"
    elif name == "raw":
        value = _is_false(value)
    return OLD_NAMES[name], value


def modern(fields: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Fields under their names of today, and a note on each that had a former one.

    Raises
    ------
    ConfigError
        If one is given under both.
    """
    found, notes = dict(fields), []
    for name in OLD_NAMES.keys() & fields.keys():
        new, value = renamed(name, found.pop(name))
        if new in found:
            raise ConfigError(f"{name} is now {new}, which is given too; leave one out")
        found[new] = value
        notes.append(f"field {name} is now {new}")
    return found, notes


def _is_false(value: Any) -> bool:
    return str(value).strip().lower() in ("false", "0", "no", "off", "f", "n")


def user_error(error: ValidationError) -> UserError:
    """The first error of a validation, as one line."""
    first = error.errors(include_url=False)[0]
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, UserError):
        return cause
    name = ".".join(map(str, first["loc"]))
    if first["type"] != "extra_forbidden":
        return ConfigError(f"{name} {quoted(first['input'])}: {first['msg']}")
    if name in OLD_NAMES:
        new, value = renamed(name, first["input"])
        return ConfigError(f"{name} is now {new}: write {new}={quoted(value)}")
    return ConfigError(f"no field {quoted(name)}; known are {', '.join(Acting.model_fields)}")


def acted_as(emotion: Any, acting: Acting | None, fields: Mapping[str, Any]) -> Acting:
    """The acting of arguments; the emotion ``"neutral"`` leaves that of `acting`."""
    if acting is None or not (isinstance(emotion, str) and emotion == "neutral"):
        fields = {"emotion": emotion, **fields}
    return Acting.of(acting, **fields)
