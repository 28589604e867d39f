"""`Acting` holds all options of how a recording is acted.

Every way into the package takes these fields and no others: the command line, `deitalk.animate`,
the columns of a batch's manifest, the form and the messages of the service, the page, and the
settings in ``take.json``, which give the same take again. Each field has a text form, which
`deitalk.acting_fields` parses and nothing else.
"""

from collections.abc import Callable, Mapping
from inspect import signature
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

from deitalk.acting_fields import (
    AUTO,
    LONGEST_LISTENING,
    LONGEST_TEXT,
    MOST_INTENSITY,
    VARIANT_NAMES,
    ActorReference,
    Edge,
    EmotionTrack,
    IntensityCurve,
    Layer,
    Life,
    OtherVoice,
    Track,
    Words,
    neutral_track,
    number_within,
    read_curve,
    read_edge,
    read_edit,
    read_emotion,
    read_gains,
    read_life,
    read_other,
    read_place,
    read_seed,
    read_variant,
    read_voice,
    read_words,
    written_edit,
    written_gains,
    written_place,
    written_variant_text,
)
from deitalk.config.section import Pattern, rule
from deitalk.errors import ConfigError, EmotionError
from deitalk.postprocess.life.listener import NO_PLACE
from rig import limits
from rig.emotions import COLORS, EMOTIONS, MOODS, PLAIN
from rig.errors import UserError, quoted


def _text(schema: str = "string", **more: Any) -> WithJsonSchema:
    return WithJsonSchema({"type": schema, **more})


_STR = PlainSerializer(str, return_type=str, when_used="unless-none")
_TEXT = _text(maxLength=LONGEST_TEXT)
_CONTENT = PlainSerializer(lambda given: given.content, return_type=dict, when_used="unless-none")
_TEXT_OR_OBJECT = WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "object"}]})


def _extra(live: str = "", panel: str = "", **default: str) -> dict[str, Any]:
    """Further entries of a field's schema: when a live voice takes it, its group, its default."""
    return ({"x-live": live} if live else {}) | ({"x-panel": panel} if panel else {}) | default


class Acting(BaseModel):
    """Options of how a recording is acted.

    Fields are given as themselves or as text; a field that is a file, as its path, its content or
    what it holds. `Acting.of` reports errors in one line.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    emotion: Annotated[Track, PlainValidator(read_emotion), _STR, _TEXT] = Field(
        default_factory=neutral_track,
        description=f"{', '.join(EMOTIONS)}; procedural: {', '.join(MOODS)}; weights such as "
        "happy=0.7,surprised=0.3; a track (.csv .json .yaml: time, emotion, strength); auto: "
        "suggested from the voice.",
        examples=["happy", "happy=0.7,surprised=0.3"],
        json_schema_extra=_extra("change", default="neutral")
        | {"x-colors": COLORS, "x-procedural": [*MOODS]},
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
            json_schema_extra=_extra(panel="Editing"),
        )
    )
    rest: Annotated[
        float,
        PlainValidator(number_within(0.0, 1.0)),
        _text("number", minimum=0, maximum=1),
    ] = Field(
        default=0.5,
        description="Share of the expression that stays in silence around the speech, 0 (neutral) "
        "to 1; an intensity curve and keyframes are shown as drawn.",
        json_schema_extra=_extra("change", panel="Performance"),
    )
    voice: Annotated[
        ActorReference | None, PlainValidator(read_voice), _CONTENT, _TEXT_OR_OBJECT
    ] = Field(
        default=None,
        description="Usual voice of the speaker, from which intensity counts: a file of `deitalk "
        "data voice`.",
        json_schema_extra=_extra(panel="Performance"),
    )
    style: Annotated[str | None, Field(max_length=100)] = Field(
        default=None,
        description="Whose style, of a model tuned on several actors; by default their mean.",
        json_schema_extra=_extra("start", panel="Performance"),
    )
    words: Annotated[Words | None, PlainValidator(read_words), _STR, _TEXT] = Field(
        default=None,
        description="Spoken words: text, or a .txt, .TextGrid, .srt or .vtt; closures are met "
        "where the sound agrees.",
        examples=["My promise is big."],
    )
    script: Annotated[Words | None, PlainValidator(read_words), _STR, _TEXT] = Field(
        default=None,
        description="Spoken words with how they are spoken, in place of words: tags in "
        "square brackets such as angrily or laughs, SSML, subtitles; text, or a .txt, .srt, .vtt "
        "or .ssml.",
        examples=["[whispers] Come here. [angrily] Now!"],
        json_schema_extra=_extra(panel="Performance"),
    )
    role: Annotated[str | None, Field(min_length=1, max_length=100)] = Field(
        default=None,
        description="Whose lines, of subtitles with speakers (ANNA: …, <v Anna>); those of others "
        "are silent.",
        examples=["anna"],
        json_schema_extra=_extra(panel="Performance"),
    )
    language: Annotated[
        str,
        Pattern("[A-Za-z0-9-]{2,32}", "a voice of espeak-ng, 2 to 32 of A to Z, a to z, 0 to 9, -"),
    ] = Field(
        default="en-us",
        description="espeak-ng's voice for the words: en-us, en-gb, de, fr, es, cmn …",
        json_schema_extra=_extra(panel="Performance"),
    )
    life: Annotated[Life, PlainValidator(read_life), _STR, _text(maxLength=200)] = Field(
        default_factory=lambda: read_life("on"),
        description="Factors on blinks, gaze, brows and head, 0 to 2: brows=.8,head=1.2; or off.",
        examples=["brows=.8,head=1.2,blinks=1,gaze=.5", "off"],
        json_schema_extra=_extra("start", panel="Performance", default="on"),
    )
    look_at: Annotated[
        tuple[float, float, float],
        PlainValidator(read_place),
        PlainSerializer(written_place, return_type=str),
        _text(maxLength=60),
    ] = Field(
        default=NO_PLACE,
        description="Place of the listener: degrees to the character's left and up, -35 to 35; and "
        "its distance, on which both eyes meet, 65 cm if it is not given.",
        examples=["10,-5", "10,-5,120"],
        json_schema_extra=_extra("change", panel="Performance", default="0,0"),
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
        json_schema_extra=_extra("change", panel="Editing", default=""),
    )
    edit: Annotated[
        tuple[Layer, ...],
        PlainValidator(read_edit),
        PlainSerializer(written_edit, return_type=str),
        _TEXT,
    ] = Field(
        default=(),
        description="Layers of edits by hand, in their order: .edit.json files of `deitalk diff` "
        "or the studio, or a take folder for its own.",
        examples=["fixes.edit.json"],
        json_schema_extra=_extra(panel="Editing", default="") | {"x-repeated": True},
    )
    listen: Annotated[
        float,
        PlainValidator(number_within(0.0, LONGEST_LISTENING, percent=False)),
        _text("number", minimum=0, maximum=LONGEST_LISTENING),
    ] = Field(
        default=0.0,
        description="Seconds of silence with motion after the speech, 0 to 600.",
        json_schema_extra=_extra(panel="Performance"),
    )
    listen_to: Annotated[
        OtherVoice | None, PlainValidator(read_other), _CONTENT, _TEXT_OR_OBJECT
    ] = Field(
        default=None,
        description="Recording of another one who speaks meanwhile, on the same clock: the face "
        "nods at the ends of its phrases, keeps its eyes there and mirrors a third of its feeling.",
        json_schema_extra=_extra(panel="Performance"),
    )
    after: Annotated[Edge | None, PlainValidator(read_edge), _CONTENT, _TEXT_OR_OBJECT] = Field(
        default=None,
        description="Take that comes before: begin in its last pose, at its speeds, as the same "
        "character; a take folder or a file of curves.",
        json_schema_extra=_extra(panel="Editing"),
    )
    into: Annotated[Edge | None, PlainValidator(read_edge), _CONTENT, _TEXT_OR_OBJECT] = Field(
        default=None,
        description="Take that comes next: end in its first pose, at its speeds.",
        json_schema_extra=_extra(panel="Editing"),
    )
    rules: bool = Field(
        default=True,
        description="The model's rules after the network; without them the network alone.",
        json_schema_extra=_extra("change", panel="Expert"),
    )
    variant: Annotated[
        dict[str, float],
        PlainValidator(read_variant),
        PlainSerializer(written_variant_text, return_type=str),
        _text(maxLength=400),
    ] = Field(
        default={},
        description=f"Way to show the emotion, {VARIANT_NAMES}; or a mixture such as "
        f"hot=.7,cold=.3, or {PLAIN}; by default drawn by the seed and the voice.",
        examples=["hot", "hot=.7,cold=.3"],
        json_schema_extra=_extra("start", panel="Performance", default=""),
    )
    seed: Annotated[
        int, PlainValidator(read_seed), _text("integer", minimum=0, maximum=limits.SEED)
    ] = Field(
        default=0,
        description="Another drawing of the variant of the emotion and of the motion above the "
        "mouth, 0 to 2**63 - 1.",
        json_schema_extra=_extra("start", panel="Performance"),
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
        if not isinstance(acting, Acting | None):
            raise ConfigError(
                f"acting {quoted(str(acting))} must be an Acting, such as Acting(emotion='happy')"
            )
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
    def emotion_track(self) -> EmotionTrack:
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
    def is_keyed(self) -> bool:
        """Whether the emotion has keyframes, which are shown in silence as drawn."""
        return len(self.emotion_track.times) > 1

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


def user_error(error: ValidationError) -> UserError:
    """The first error of a validation, as one line."""
    first = error.errors(include_url=False)[0]
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, UserError):
        return cause
    name = ".".join(map(str, first["loc"]))
    if first["type"] != "extra_forbidden":
        return ConfigError(f"{name} {quoted(first['input'])}: {rule(first)}")
    return ConfigError(f"no field {quoted(name)}; known are {', '.join(Acting.model_fields)}")


def acted_as(
    emotion: Any, acting: Acting | None, fields: Mapping[str, Any], of: Callable[..., Any]
) -> Acting:
    """The acting of arguments; the emotion ``"neutral"`` leaves that of `acting`.

    Raises
    ------
    ConfigError
        For a field that there is not; it names those there are, and the parameters of `of`.
    """
    for name in fields.keys() - Acting.model_fields.keys():
        own = [p.name for p in signature(of).parameters.values() if p.default is not p.empty]
        known = ", ".join(dict.fromkeys([*own, *Acting.model_fields]))
        raise ConfigError(f"no argument {quoted(name)}; known are {known}")
    if acting is None or not (isinstance(emotion, str) and emotion == "neutral"):
        fields = {"emotion": emotion, **fields}
    return Acting.of(acting, **fields)
