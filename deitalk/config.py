"""Configuration of a model and of its training: frozen, one class a stage.

The defaults are the numbers the two papers print; a YAML file in ``configs/`` holds only what
differs. An unknown key is an error. Modules take plain numbers; only the builders in
`deitalk.models` and `deitalk.train` read these classes.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from deitalk.config_fields import (
    Dilation,
    Odd,
    Phases,
    Positive,
    Recurrent,
    Section,
    Seed,
    SpectraRate,
    SpectrumSeconds,
    Steps,
    Width,
    Window,
    Workers,
    check_encoder,
)
from deitalk.errors import ConfigError
from deitalk.yaml_text import load_yaml, read_yaml
from rig import limits
from rig.errors import quoted, shorten


class MelConfig(Section):
    """Mel spectrogram, Spec-BiLSTM, Time-BiLSTM and temporal attention (SDFA §3.1-3.3, §4.4)."""

    kind: Literal["mel"] = "mel"
    window_seconds: SpectrumSeconds = Field(
        default=0.064, description="length of one spectrum (FFT_win)"
    )
    frame_rate: SpectraRate = Field(default=125.0, description="spectra per second; 1 / FFT_hop")
    n_mels: int = Field(default=128, ge=4, le=limits.MEL_BINS, description="mel bins (F)")
    conv_channels: tuple[Width, Width, Width] = (32, 64, 64)
    spec_hidden: Width = Field(default=32, description="Spec-BiLSTM units per direction")
    spectral_size: Width = Field(default=256, description="features of one spectrum (C_spec)")
    time_stack: Window = Field(default=1, description="spectra joined before the Time-BiLSTM")
    time_hidden: Width = Field(default=256, description="Time-BiLSTM units per direction")
    time_layers: Recurrent = 2
    window_frames: Window = Field(default=64, description="spectra the attention sees (L)")
    query_frames: Odd = Field(default=7, description="K_qry; Paper silent")
    attention_size: Width = Field(default=128, description="C_att; Paper silent")
    recurrence: Literal["window", "segment"] = Field(
        default="window", description="Time-BiLSTM once per window (the paper) or along the clip"
    )
    weight_norm: bool = Field(
        default=True, description="weight normalisation on every weight (§4.4)"
    )
    centre: bool = Field(
        default=False,
        description="add the window's own centre to what it attends to, and normalise",
    )
    rig_layers: int = Field(
        default=0,
        ge=0,
        le=limits.RECURRENT_LAYERS,
        description="BiLSTMs along rig frames behind the attention; not in SDFA",
    )
    phases: Phases = Field(
        default=1,
        description="times a whole clip is heard, parts of a spectrum apart; features are the mean",
    )
    dropout: float = Field(default=0.0, ge=0, lt=1)

    @field_validator("recurrence")
    @classmethod
    def _stack_fits(cls, value: str, info: ValidationInfo) -> str:
        if value == "window" and info.data.get("time_stack", 1) > 1:
            raise ValueError("'window' takes no time_stack; use recurrence: segment")
        return value

    @field_validator("query_frames")
    @classmethod
    def _query_fits(cls, value: int, info: ValidationInfo) -> int:
        if value > info.data.get("window_frames", value):
            raise ValueError("must not be longer than window_frames")
        return value


class Wav2VecConfig(Section):
    """wav2vec 2.0 (DEITalk §3.2): a published checkpoint, or a compact encoder of one's own."""

    kind: Literal["wav2vec"] = "wav2vec"
    checkpoint: str | None = Field(
        default="facebook/wav2vec2-base-960h",
        description="hub name or folder; null builds `encoder`",
    )
    encoder: dict[str, Any] = Field(
        default_factory=dict, description="transformers' Wav2Vec2Config keys, without checkpoint"
    )
    freeze_stem: bool = Field(default=True, description="keep the convolutional stem fixed (§4.1)")

    @field_validator("encoder")
    @classmethod
    def _shape_fits(cls, value: dict[str, Any]) -> dict[str, Any]:
        check_encoder(value)
        return value


class ConformerConfig(Section):
    """Mel spectrogram and conformer blocks; not in the papers."""

    kind: Literal["conformer"] = "conformer"
    window_seconds: SpectrumSeconds = Field(default=0.032, description="length of one spectrum")
    n_mels: int = Field(default=80, ge=4, le=limits.MEL_BINS, description="mel bins (F)")
    stem_channels: Width = 256
    hidden_size: Width = Field(default=384, description="width of a block")
    layers: int = Field(default=2, ge=1, le=limits.LAYERS)
    heads: Width = 4
    intermediate_size: Width = Field(default=512, description="width within a block")
    kernel_size: Odd = Field(default=15, description="rig frames a block's convolution sees")
    phases: Phases = Field(
        default=1,
        description="times a whole clip is heard, parts of a spectrum apart; features are the mean",
    )
    dropout: float = Field(default=0.1, ge=0, lt=1)


class ModelConfig(Section):
    """The network of DEITalk §3; defaults are §4.1's numbers."""

    frontend: MelConfig | Wav2VecConfig | ConformerConfig = Field(
        default_factory=Wav2VecConfig, discriminator="kind"
    )
    control_set: str = "metahuman-185@mh4"
    positions: bool = Field(default=True, description="dynamic positional encoding (Eq. 2-3)")
    intensity: bool = Field(default=True, description="dynamic emotional intensity (Eq. 4-6)")
    emotion_size: Width = Field(default=128, description="width of S_emo and E_in")
    saliency_frames: int | None = Field(
        default=None,
        ge=1,
        le=limits.SALIENCY_FRAMES,
        description="frames the embedding of Eq. 5 is pooled over; null: the whole clip",
    )
    style_size: Width = Field(default=16, description="width of the emotional style embedding")
    motion_channels: tuple[Width, ...] = Field(
        default=(384, 384, 768, 768), min_length=1, max_length=limits.MOTION_LAYERS
    )
    classifier_size: Width = 64
    decoder_channels: Width = 512
    decoder_dilations: tuple[Dilation, ...] = Field(
        default=(1, 2, 4, 8, 1, 2, 4, 8), min_length=1, max_length=limits.LAYERS
    )
    decoder_residual: bool = Field(
        default=False, description="carry every layer's input past it; not in the paper"
    )
    kernel_size: Odd = 3
    dropout: float = Field(default=0.0, ge=0, lt=1)


class LossConfig(Section):
    """The four-part loss (DEITalk Eq. 8) and what we add to it."""

    contrast: float = Field(default=0.1, ge=0, description="lambda_1")
    classification: float = Field(default=0.1, ge=0, description="lambda_2")
    position: float = Field(default=1.0, ge=0, description="lambda_3")
    velocity: float = Field(default=4.0, ge=0, description="lambda_4")
    temperature: float = Field(default=0.07, gt=0, description="tau of Eq. 10")
    intensity: float = Field(
        default=0.0,
        ge=0,
        description="weight of labelled intensity on the saliency; not in the paper",
    )
    contact: float = Field(
        default=0.0, ge=0, description="weight of the lip-contact loss; not in the paper"
    )
    distillation: float = Field(
        default=1.0,
        ge=0,
        description="weight of the distance to the features of train.teacher; not in the paper",
    )
    control_weights: dict[str, Annotated[float, Field(ge=0)]] = Field(
        default_factory=dict, description="weight of a control or subset in Eq. 12-13 (default 1)"
    )


class DataConfig(Section):
    """How clips become windows (DEITalk §4.1)."""

    window_frames: int = Field(default=128, ge=1, le=limits.TRAINING_FRAMES)
    stride_frames: int = Field(default=5, ge=1, le=limits.TRAINING_FRAMES)
    augment: bool = Field(default=False, description="deitalk.augment on every training window")
    noise_folder: str | None = Field(default=None, description="recordings of noise to mix in")
    room_folder: str | None = Field(default=None, description="room impulse responses")
    real_fraction: float | None = Field(
        default=None,
        ge=0,
        le=1,
        description="share of windows from recorded (not synthetic) speech",
    )
    cache_gigabytes: float = Field(
        default=1.0, gt=0, description="clips a loading process keeps in memory; 0.2 an hour"
    )


class TrainConfig(Section):
    """Optimiser and schedule (DEITalk §4.1)."""

    learning_rate: float = Field(default=1e-4, gt=0)
    optimizer: Literal["adam", "adamw"] = "adam"
    weight_decay: float = Field(default=0.0, ge=0)
    schedule: Literal["constant", "one_cycle"] = "constant"
    batch_size: int = Field(default=32, ge=1, le=limits.BATCH)
    epochs: float = Field(
        default=300, gt=0, le=limits.TRAINING_PASSES, description="passes over all training windows"
    )
    steps: Steps | None = Field(default=None, description="stop after this many steps instead")
    gradient_clip: float | None = Field(default=None, gt=0)
    ema: float | None = Field(default=None, gt=0, lt=1, description="decay of the averaged weights")
    frozen_frontend: str | None = Field(
        default=None, description="model whose frontend is taken and does not learn"
    )
    evaluate_every: Steps = Field(
        default=500, description="steps between evaluations and checkpoints"
    )
    precision: Literal["float32", "bfloat16"] = Field(
        default="float32",
        description="bfloat16: faster on GPUs and on CPUs with AMX, far slower elsewhere",
    )
    seed: Seed = 0
    workers: Workers = Field(default=0, description="processes that prepare windows")
    teacher: str | None = Field(
        default=None,
        description="model (name or folder) whose speech features are learnt; not in the paper",
    )

    @field_validator("teacher")
    @classmethod
    def _there_is_someone_to_teach(cls, value: str | None, info: ValidationInfo) -> str | None:
        if value is not None and info.data.get("frozen_frontend") is not None:
            raise ValueError("a frozen frontend learns nothing; set one of the two to null")
        return value


class Config(Section):
    """Everything a run needs besides its data."""

    name: str = "deitalk"
    model: ModelConfig = ModelConfig()
    loss: LossConfig = LossConfig()
    data: DataConfig = DataConfig()
    train: TrainConfig = TrainConfig()


class SDFAMelConfig(MelConfig):
    """SDFA's encoder, and its two ablations (SDFA §5.2.2)."""

    gathering: Literal["bilstm", "convolution"] = Field(
        default="bilstm", description="what gathers a spectrum: Spec-BiLSTM, or convolutions"
    )
    summary: Literal["attention", "convolution"] = Field(
        default="attention", description="what sums up a window: attention, or convolutions"
    )

    @field_validator("time_stack")
    @classmethod
    def _every_spectrum(cls, value: int) -> int:
        if value != 1:
            raise ValueError("SDFA hears every spectrum; leave it at 1")
        return value

    @field_validator("rig_layers")
    @classmethod
    def _no_rig(cls, value: int) -> int:
        if value != 0:
            raise ValueError("SDFA has no rig frames to go along; leave it at 0")
        return value


class KarrasConfig(Section):
    """Convolutions over frequency, then over time (in the way of Karras et al. 2017)."""

    kind: Literal["karras"] = "karras"
    window_seconds: SpectrumSeconds = Field(default=0.016, description="length of one spectrum")
    frame_rate: SpectraRate = Field(default=125.0, description="spectra per second")
    lags: int = Field(default=32, ge=8, le=limits.MEL_BINS, description="autocorrelation numbers")
    window_frames: Window = Field(default=64, ge=2, description="spectra a frame")
    formant_channels: tuple[Width, ...] = Field(
        default=(72, 108, 162, 243, 256), min_length=1, max_length=limits.LAYERS
    )
    articulation_channels: tuple[Width, ...] = Field(
        default=(256,) * 5, min_length=1, max_length=limits.LAYERS
    )


class VocaConfig(Section):
    """Convolutions over a window of speech features (in the way of Cudeiro et al. 2019)."""

    kind: Literal["voca"] = "voca"
    window_seconds: SpectrumSeconds = Field(default=0.032, description="length of one spectrum")
    frame_rate: SpectraRate = Field(default=60.0, description="feature rows per second")
    n_mels: int = Field(default=40, ge=8, le=limits.MEL_BINS, description="mel bins before the DCT")
    n_mfcc: int = Field(default=26, ge=2, le=limits.MEL_BINS, description="cepstral coefficients")
    window_frames: Window = Field(default=16, ge=2, description="rows a frame")
    channels: tuple[Width, ...] = Field(
        default=(32, 32, 64, 64), min_length=1, max_length=limits.LAYERS
    )


class DEITalkFeaturesConfig(Section):
    """What a trained DEITalk model has made of speech and emotion; the model stays as it is."""

    kind: Literal["deitalk"] = "deitalk"
    model: str = Field(default="default", description="name or folder of the DEITalk model")


class SDFAModelConfig(Section):
    """A speech encoder and the decoder of SDFA §3.4; defaults are Tables 1-3."""

    frontend: SDFAMelConfig | KarrasConfig | VocaConfig | DEITalkFeaturesConfig = Field(
        default_factory=SDFAMelConfig, discriminator="kind"
    )
    motion: Literal["gradients", "offsets"] = Field(
        default="gradients", description="what is predicted: deformation gradients, vertex offsets"
    )
    shared_size: Width | None = Field(
        default=512, description="width of z_dec; null: the encoder's output goes on as it is"
    )
    branch_sizes: tuple[Width, ...] = Field(default=(512, 256), max_length=limits.LAYERS)
    weight_norm: bool = Field(default=True, description="in the decoder, but on no frozen layer")
    seal_mm: float = Field(
        default=0.0,
        ge=0,
        description="embedded heads: lips no further apart are brought together; not in the paper",
    )


class MeshDataConfig(Section):
    """Mesh sequences and the bases of their gradients (SDFA §4.1, §4.3, §4.4)."""

    fps: float = Field(default=60.0, gt=0, le=240, description="frames per second of the meshes")
    identities: tuple[Annotated[int, Field(ge=0, le=limits.SEED)], ...] = Field(
        default=(0, 1, 2, 3, 4, 5, 6, 7),
        min_length=1,
        max_length=limits.SPEAKERS,
        description="embedded heads that act a dataset folder's curves",
    )
    emotions: tuple[str, ...] | None = Field(
        default=None, description="emotions of such a folder that are acted; null: all"
    )
    clips: Positive | None = Field(
        default=None, description="clips taken of its training split, evenly spread; null: all"
    )
    validation_clips: Positive = Field(
        default=24, description="clips taken of its validation split; its test split stays unseen"
    )
    augment: bool = Field(default=True, description="all of §4.3")
    basis_error_mm: float = Field(
        default=0.5, gt=0, description="what the bases may cost where the face moves most"
    )
    basis_frames: int = Field(
        default=400,
        ge=2,
        le=limits.TRAINING_FRAMES,
        description="frames that the bases are fitted to",
    )


class MeshTrainConfig(Section):
    """Adam at a constant rate on pairs of adjacent frames (SDFA §4.4), and what a CPU needs."""

    learning_rate: float = Field(default=1e-4, gt=0)
    schedule: Literal["constant", "one_cycle"] = "constant"
    segment_frames: int = Field(
        default=2,
        ge=2,
        le=limits.BATCH,
        description="adjacent frames drawn together; 2: the paper's pairs",
    )
    batch_size: int = Field(
        default=100, ge=2, le=limits.BATCH, description="frames; a multiple of segment_frames"
    )
    epochs: float = Field(
        default=50, gt=0, le=limits.TRAINING_PASSES, description="passes over all training frames"
    )
    steps: Steps | None = Field(default=None, description="stop after this many steps instead")
    gradient_clip: float | None = Field(default=None, gt=0)
    ema: float | None = Field(default=None, gt=0, lt=1, description="decay of the averaged weights")
    loss_decay: float = Field(
        default=0.99, gt=0, lt=1, description="of the loss terms' second moments"
    )
    start_encoder: str | None = Field(
        default=None,
        description="DEITalk model whose mel encoder is the start; it then learns at a third of "
        "the rate; not in the paper",
    )
    start_new: tuple[Literal["spectral", "recurrent", "attention"], ...] = Field(
        default=(),
        description="parts of the encoder that are not copied from it: what an ablation replaces",
    )
    lip_weight: float = Field(
        default=0.0, ge=0, description="weight of the lips' rims; not in the paper"
    )
    precision: Literal["float32", "bfloat16"] = Field(
        default="float32", description="bfloat16: faster on CPUs with AMX, far slower elsewhere"
    )
    evaluate_every: Steps = Field(
        default=500, description="steps between evaluations and checkpoints"
    )
    seed: Seed = 0
    workers: Workers = Field(default=0, description="processes that prepare segments")

    @field_validator("batch_size")
    @classmethod
    def _whole_segments(cls, value: int, info: ValidationInfo) -> int:
        segment = info.data.get("segment_frames", 1)
        if value % segment:
            raise ValueError(f"must be a multiple of segment_frames, {segment}")
        return value


class SDFAConfig(Section):
    """Everything a run of SDFA needs besides its data; ``kind: sdfa`` chooses it."""

    kind: Literal["sdfa"]
    name: str = "sdfa"
    model: SDFAModelConfig = SDFAModelConfig()
    data: MeshDataConfig = MeshDataConfig()
    train: MeshTrainConfig = MeshTrainConfig()

    @model_validator(mode="after")
    def _features_are_computed_once(self) -> "SDFAConfig":
        if self.model.frontend.kind != "deitalk":
            return self
        if self.data.fps != 30 or self.data.augment or self.train.start_encoder is not None:
            raise ValueError(
                "model.frontend.kind=deitalk needs data.fps=30, data.augment=false and no "
                "train.start_encoder: its features are computed once, 30 a second"
            )
        return self


AnyConfig = Config | SDFAConfig


_PROBLEMS = 5
"""Problems that are named in one message."""


def parse_config(tree: dict[str, Any]) -> AnyConfig:
    """Check a tree of settings; one with ``kind: sdfa`` gives an `SDFAConfig`.

    Parameters
    ----------
    tree : dict
        As a YAML file holds it; what is missing takes its default.

    Raises
    ------
    ConfigError
        Naming the key, the value and the rule, all problems in one line.
    """
    try:
        kind = SDFAConfig if tree.get("kind") == "sdfa" else Config
        return kind.model_validate(tree)
    except ValidationError as error:
        items = error.errors(include_url=False, include_context=False)
        problems = "; ".join(_problem(item) for item in items[:_PROBLEMS])
        if len(items) > _PROBLEMS:
            problems += f"; {len(items) - _PROBLEMS} more"
        raise ConfigError(f"configuration: {problems}") from None


def _problem(item: Any) -> str:
    kinds = ("mel", "wav2vec", "karras", "voca", "deitalk")
    key = ".".join(str(part) for part in item["loc"] if part not in kinds)
    rule = item["msg"].removeprefix("Value error, ")
    if item["type"] == "extra_forbidden":
        rule = "unknown key"
    return f"{shorten(key, 100)}={quoted(item['input'])}: {rule}"


def load_config(path: Path | str, overrides: Sequence[str] = ()) -> AnyConfig:
    """Read a YAML file and apply overrides such as ``train.batch_size=8``.

    Parameters
    ----------
    path : path
        YAML; an empty file is the paper's configuration.
    overrides : sequence of str
        ``section.key=value``, the value in YAML; later ones win.

    Raises
    ------
    ConfigError
        If the file is missing, is no YAML mapping, or holds an unknown key or a bad value.
    """
    path = Path(path)
    tree = read_yaml(path) or {}
    if not isinstance(tree, dict):
        raise ConfigError(f"{path}: holds a {type(tree).__name__}; a configuration is a mapping")
    for override in overrides:
        _override(tree, override)
    return parse_config(tree)


def _override(tree: dict[str, Any], override: str) -> None:
    key, equals, value = override.partition("=")
    if not equals:
        raise ConfigError(f"override {quoted(override)} has no '='; write train.batch_size=8")
    *parents, leaf = key.split(".")
    if len(parents) >= limits.NESTING:
        raise ConfigError(f"override {quoted(override)} nests {len(parents)} levels; name a key")
    for parent in parents:
        tree = tree.setdefault(parent, {})
        if not isinstance(tree, dict):
            raise ConfigError(
                f"override {quoted(override)}: {quoted(parent)} is a value, not a section"
            )
    tree[leaf] = load_yaml(value, f"override {quoted(override)}")
