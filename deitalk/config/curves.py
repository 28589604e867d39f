"""Settings of DEITalk, the model of 185 curves: network, loss, data and training."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from deitalk.config.frontends import (
    CausalWhisperConfig,
    MelConfig,
    Wav2VecConfig,
    WhisperConfig,
)
from deitalk.config.rules import Emotion, RulesConfig
from deitalk.config.section import (
    AboveZero,
    Dilation,
    Dropout,
    Odd,
    Optimisation,
    Pattern,
    Section,
    Share,
    Weight,
    Width,
)
from rig import limits

MODULE_CLASS = Pattern(r"[\w.]+:[\w.]+", "a module and a class, module:Class")


class ModelConfig(Section):
    """The network of DEITalk §3; defaults are §4.1's numbers."""

    frontend: MelConfig | CausalWhisperConfig | Wav2VecConfig | WhisperConfig = Field(
        default_factory=Wav2VecConfig, discriminator="kind"
    )
    control_set: str = "metahuman-185@mh4"
    """The board, or a file that describes another rig (see docs/finetuning.md)."""
    positions: bool = True
    """Dynamic positional encoding (Eq. 2-3)."""
    intensity: bool = True
    """Dynamic emotional intensity (Eq. 4-6)."""
    effort: bool = False
    """A linear readout of the speech features is the strength of the voice; not in the paper."""
    lips: bool = False
    """A readout of the speech features corrects contacts and width, of a tuned model those that
    captures do not show; not in the paper."""
    emotion_size: Width = 128
    """Width of S_emo and E_in."""
    saliency_frames: int | None = Field(default=None, ge=1, le=limits.SALIENCY_FRAMES)
    """Frames the embedding of Eq. 5 is pooled over; null: the whole clip."""
    style_size: Width = 16
    """Width of the emotional style embedding."""
    actors: tuple[Annotated[str, Field(min_length=1, max_length=100)], ...] = Field(
        default=(), max_length=limits.WIDTH
    )
    """Actors whose styles are added to the emotional one; not in the paper."""
    actor_layers: bool | Literal["offsets"] = False
    """A last layer of each actor, as a change of that of all, or an offset of each; not in the
    paper."""
    kept_controls: tuple[Annotated[str, Field(min_length=1, max_length=200)], ...] = Field(
        default=(), max_length=limits.CONTROLS
    )
    """Controls that a second decoder moves, the base's of a fine-tuned model; not in the paper."""
    captured_emotions: tuple[Emotion, ...] = ()
    """Emotions that captures show; in the others the curves change as the base's of a fine-tuned
    model. Empty: the decoder gives all emotions; not in the paper."""
    base_controls: int | None = Field(default=None, ge=0, le=limits.CONTROLS)
    """Controls of the base, where they are another rig's; 0: nothing carries them to this one, and
    emotions that captures lack pass as neutral."""
    kept_intensity: bool = False
    """A second projection of Eq. 4 guides the decoder of the kept controls, the base's of a
    fine-tuned model; not in the paper."""
    motion_channels: tuple[Width, ...] = Field(
        default=(384, 384, 768, 768), min_length=1, max_length=limits.MOTION_LAYERS
    )
    classifier_size: Width = 64
    decoder_channels: Width = 512
    decoder_dilations: tuple[Dilation, ...] = Field(
        default=(1, 2, 4, 8, 1, 2, 4, 8), min_length=1, max_length=limits.LAYERS
    )
    decoder_residual: bool = False
    """Carry every layer's input past it; not in the paper."""
    decoder_direct: bool = False
    """The last layer has the speech features too; not in the paper."""
    own_decoder: Annotated[str, Field(max_length=200), MODULE_CLASS] | None = None
    """A class of `deitalk.models.rig_decoder.RigDecoder`, ``module:Class``; not in the paper."""
    kernel_size: Odd = 3
    dropout: Dropout = 0.0

    @property
    def network(self) -> str:
        """Module and class of the network."""
        return "deitalk.models.curve_model:DEITalk"

    @field_validator("frontend", mode="before")
    @classmethod
    def _default_kind(cls, value: Any) -> Any:
        """A frontend without a kind is the paper's."""
        return {"kind": "wav2vec"} | value if isinstance(value, dict) else value

    @model_validator(mode="after")
    def _kept_intensity_guides_a_kept_decoder(self) -> "ModelConfig":
        """A second projection has a decoder to guide, and frames to compare with."""
        has_kept = self.kept_controls or self.captured_emotions
        if self.kept_intensity and not (has_kept and self.saliency_frames):
            raise ValueError(
                "kept_intensity needs saliency_frames, and kept_controls or captured_emotions"
            )
        return self

    @model_validator(mode="after")
    def _causal_ends_never(self) -> "ModelConfig":
        """Refuse settings that depend on the whole clip with a causal frontend."""
        if self.frontend.kind == "causal_whisper":
            if self.own_decoder is not None:
                raise ValueError("causal_whisper takes no own_decoder; set own_decoder: null")
            if self.positions:
                raise ValueError("causal_whisper takes no positions; set positions: false")
            if self.intensity and self.saliency_frames is None:
                raise ValueError("causal_whisper needs saliency_frames; 121 is 4 s")
        return self


class LossConfig(Section):
    """The four-part loss (DEITalk Eq. 8) and our additions."""

    contrast: Weight = 0.1
    """lambda_1."""
    classification: Weight = 0.1
    """lambda_2."""
    position: Weight = 1.0
    """lambda_3."""
    velocity: Weight = 4.0
    """lambda_4."""
    temperature: AboveZero = 0.07
    """Tau of Eq. 10."""
    intensity: Weight = 0.0
    """Weight of labelled intensity on the saliency; not in the paper."""


WindowFrames = Annotated[int, Field(ge=1, le=limits.TRAINING_FRAMES)]


class DataConfig(Section):
    """Settings by which clips are cut into windows (DEITalk §4.1)."""

    window_frames: WindowFrames = 128
    stride_frames: WindowFrames = 5
    augment: bool = False
    """deitalk.data.augment_waveform on every training window."""
    real_fraction: Share | None = None
    """Share of windows from recorded (not synthetic) speech."""
    cache_gigabytes: AboveZero = 1.0
    """Clips a loading process keeps in memory; 0.2 an hour."""


class TrainConfig(Optimisation):
    """Optimiser and schedule (DEITalk §4.1)."""

    optimizer: Literal["adam", "adamw"] = "adam"
    weight_decay: Weight = 0.0


class Config(Section):
    """Settings of a run: network, rules, loss, data and training."""

    product: ClassVar[str] = "curves"
    stored_kind: ClassVar[str] = "deitalk"
    """Kind of the configuration in a model folder, which has no settings of the training."""
    kind: Literal["deitalk"] = "deitalk"
    name: str = "deitalk"
    model: ModelConfig = ModelConfig()
    rules: RulesConfig = RulesConfig()
    loss: LossConfig = LossConfig()
    data: DataConfig = DataConfig()
    train: TrainConfig = TrainConfig()
