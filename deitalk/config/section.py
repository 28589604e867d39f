"""Types and limits of the fields of a configuration, and the YAML it is read from."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Protocol, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import core_schema

from deitalk.errors import ConfigError
from rig import limits
from rig.errors import quoted, shorten


@dataclass(frozen=True)
class Pattern:
    """The rule of a text: a regular expression for schemas, and in words for messages."""

    expression: str
    words: str

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return core_schema.no_info_after_validator_function(self._checked, handler(source))

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> Any:
        return handler(schema) | {"pattern": f"^{self.expression}$"}

    def _checked(self, text: str) -> str:
        if not re.fullmatch(self.expression, text):
            raise ValueError(f"must be {self.words}")
        return text


def _odd(value: int) -> int:
    if value % 2 == 0:
        raise ValueError("must be odd, so that it has a centre")
    return value


Width = Annotated[int, Field(ge=1, le=limits.WIDTH)]
"""Channels, features or units of a layer."""
Window = Annotated[int, Field(ge=1, le=limits.WINDOW_FRAMES)]
"""Spectra or frames of one window."""
Odd = Annotated[int, Field(ge=1, le=limits.KERNEL), AfterValidator(_odd)]
"""Frames of a kernel."""
Recurrent = Annotated[int, Field(ge=1, le=limits.RECURRENT_LAYERS)]
Dilation = Annotated[int, Field(ge=1, le=limits.DILATION)]
SpectrumSeconds = Annotated[float, Field(gt=0, le=limits.WINDOW_SECONDS)]
Tapers = Annotated[int, Field(ge=1, le=limits.TAPERS)]
"""Windows of a spectrum; 1: a Hann window (the paper)."""
SpectraRate = Annotated[float, Field(gt=1, le=limits.SPECTRA_PER_SECOND)]
Steps = Annotated[int, Field(ge=1, le=limits.TRAINING_STEPS)]
Seed = Annotated[int, Field(ge=0, le=limits.SEED)]
Workers = Annotated[int, Field(ge=0, le=limits.WORKERS)]
Positive = Annotated[int, Field(ge=1, le=limits.TRAINING_STEPS)]
Batch = Annotated[int, Field(ge=1, le=limits.BATCH)]
Passes = Annotated[float, Field(gt=0, le=limits.TRAINING_PASSES)]
"""Over all training data."""
MelBins = Annotated[int, Field(ge=4, le=limits.MEL_BINS)]
Weight = Annotated[float, Field(ge=0)]
AboveZero = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Inner = Annotated[float, Field(gt=0, lt=1)]
Dropout = Annotated[float, Field(ge=0, lt=1)]


_ENCODER_LIMITS: dict[str, int] = {
    "num_hidden_layers": limits.LAYERS,
    "num_attention_heads": limits.WIDTH,
    "conv_kernel": limits.KERNEL,
    "conv_stride": limits.KERNEL,
    "num_conv_pos_embeddings": limits.WINDOW_FRAMES,
    "num_conv_pos_embedding_groups": limits.WIDTH,
    "num_feat_extract_layers": limits.LAYERS,
}
"""Largest number of a key of transformers' Wav2Vec2Config; `limits.WIDTH` for all others."""
_ENCODER_VALUES = 1000


def check_encoder(shape: Mapping[str, Any]) -> None:
    """Check the shape of a wav2vec 2.0 encoder before anything is built from it.

    Parameters
    ----------
    shape : mapping
        Keys of transformers' ``Wav2Vec2Config``.

    Raises
    ------
    ValueError
        If a number, text or list is beyond its limit.
    """
    if len(shape) > _ENCODER_VALUES:
        raise ValueError(f"has {len(shape)} keys; at most {_ENCODER_VALUES} are read")
    for key, value in shape.items():
        values = value if isinstance(value, list | tuple) else [value]
        if len(values) > limits.LAYERS:
            raise ValueError(f"{quoted(key)} has {len(values)} values; at most {limits.LAYERS}")
        most = _ENCODER_LIMITS.get(key, limits.WIDTH)
        for item in values:
            if isinstance(item, int | float) and not abs(item) <= most:
                raise ValueError(f"{quoted(key)} is {quoted(item)}; at most {most}")
            if isinstance(item, str | list | tuple | dict) and len(item) > _ENCODER_VALUES:
                raise ValueError(f"{quoted(key)} is too long; at most {_ENCODER_VALUES}")


class Section(BaseModel):
    """A frozen group of settings; unknown keys are errors."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True
    )


S = TypeVar("S", bound=Section)
NO_SECTION = "must be a section, which has keys"
"""Rule of a group of settings."""
_PROBLEMS = 5
"""Largest number of problems in one message."""


def checked(model: type[S], tree: Any, where: object = "configuration") -> S:
    """Settings of a tree of a YAML file; `where` begins the message.

    Raises
    ------
    ConfigError
        With the key, the value and the rule of every problem, in one line.
    """
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        items = error.errors(include_url=False, include_context=False)
        problems = "; ".join(_problem(item, model) for item in items[:_PROBLEMS])
        if len(items) > _PROBLEMS:
            problems += f"; {len(items) - _PROBLEMS} more"
        raise ConfigError(f"{where}: {problems}") from None


def _problem(item: Any, model: type[BaseModel]) -> str:
    kinds = (
        "mel",
        "causal_whisper",
        "wav2vec",
        "whisper",
        "karras",
        "voca",
        "deitalk",
    )
    key = ".".join(str(part) for part in item["loc"] if part not in kinds)
    if item["type"] == "union_tag_invalid":
        key, item = f"{key}.kind".strip("."), item | {"input": item["input"]["kind"]}
    return f"{shorten(key, 100)}={quoted(item['input'])}: {rule(item, model)}"


def rule(item: Any, model: type[BaseModel] | None = None) -> str:
    """The rule that an error of pydantic states; of an unknown key what `model` knows there."""
    if item["type"] in ("model_type", "model_attributes_type"):
        return NO_SECTION
    if item["type"] != "extra_forbidden":
        return str(item["msg"]).removeprefix("Value error, ")
    sections = [] if model is None else [model]
    for part in item["loc"][:-1]:
        fields = [s.model_fields[part] for s in sections if part in s.model_fields]
        tagged = [s for s in sections if "kind" in s.model_fields]
        if fields:
            sections = [s for field in fields for s in _sections(field.annotation)]
        elif tagged:
            sections = [s for s in tagged if part in get_args(s.model_fields["kind"].annotation)]
    known = ", ".join(dict.fromkeys(key for section in sections for key in section.model_fields))
    return f"unknown key; known are {known}" if known else "unknown key"


def _sections(annotation: Any) -> list[type[BaseModel]]:
    """The groups of settings in a type."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [section for part in get_args(annotation) for section in _sections(part)]


class Optimisation(Section):
    """Settings of any training: steps, batches, learning rate and what is kept."""

    learning_rate: AboveZero = 1e-4
    schedule: Literal["constant", "one_cycle"] = "constant"
    batch_size: Batch = 32
    """Windows."""
    epochs: Passes = 300
    """Passes over all training data."""
    steps: Steps | None = None
    """Stop after this many steps instead."""
    gradient_clip: AboveZero | None = None
    """Largest norm of the gradient of all weights."""
    accumulate: Positive = 1
    """Batches whose gradients make one step, for batches beyond memory."""
    ema: Inner | None = None
    """Decay of the averaged weights."""
    evaluate_every: Steps = 500
    """Steps between evaluations and checkpoints."""
    patience: Annotated[int, Field(ge=1, le=limits.TRAINING_STEPS)] | None = None
    """End after so many evaluations without a better score."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """bfloat16: faster on GPUs and on CPUs with AMX, far slower elsewhere."""
    compile: bool = False
    """torch.compile: a slow start and faster steps on GPUs."""
    seed: Seed = 0
    workers: Workers = 0
    """Processes that prepare batches."""


class RunConfig(Protocol):
    """All settings of a training of any model."""

    @property
    def train(self) -> Optimisation:
        """Steps, batches and learning rate."""
        ...

    def model_dump(self, *, mode: str) -> dict[str, Any]:
        """All settings as a tree."""
        ...
