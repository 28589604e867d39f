"""Settings that trainings and comparisons have beside those of the product."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from deitalk.config.curves import Config, DataConfig, LossConfig, ModelConfig, TrainConfig
from deitalk.config.frontends import DEITalkFeaturesConfig, SDFAMelConfig
from deitalk.config.load import AnyConfig, named, parse_config, read_tree
from deitalk.config.mesh import SDFAConfig, SDFAModelConfig
from deitalk.config.section import (
    AboveZero,
    Inner,
    Optimisation,
    Passes,
    Positive,
    Section,
    Share,
    SpectraRate,
    SpectrumSeconds,
    Weight,
    Width,
    Window,
)
from rig import limits


class TrainingLossConfig(LossConfig):
    """The loss, with the lips of the embedded head and the features of a teacher."""

    lips: Weight = 0.0
    """Weight of the lips of the embedded head, which the curves move; not in the paper."""
    range: Weight = 0.0
    """Weight of how far and how fast these lips move, against the target's; not in the paper."""
    contact: Weight = 0.0
    """Weight of the lip-contact loss; not in the paper."""
    control_weights: dict[str, Weight] = Field(default_factory=dict)
    """Weight of a control or subset in Eq. 12-13 (default 1)."""
    distillation: Weight = 1.0
    """Weight of the distance to the features of train.teacher; not in the paper."""


class TrainingDataConfig(DataConfig):
    """How clips become windows, or windows of features."""

    noise_folder: str | None = None
    """Recordings of noise to mix in."""
    room_folder: str | None = None
    """Room impulse responses."""
    measured_fraction: Share | None = None
    """Share of windows from clips whose lips were measured, their speakers alike."""
    clips: Positive | None = None
    """Clips taken of the training split, evenly spread; null: all."""
    encoded_passes: int = Field(default=0, ge=0, le=100)
    """Times that every recording is encoded before training, all but the first changed in speed,
    room and noise; needs a frontend that does not learn."""


class TaughtTrainConfig(TrainConfig):
    """Optimiser and schedule, with a teacher."""

    frozen_frontend: str | None = None
    """Model whose frontend is taken and does not learn."""
    teacher: str | None = None
    """Model (name or folder) whose speech features are learnt; not in the paper."""

    @field_validator("teacher")
    @classmethod
    def _teaching_needs_a_trained_frontend(
        cls, value: str | None, info: ValidationInfo
    ) -> str | None:
        if value is not None and info.data.get("frozen_frontend") is not None:
            raise ValueError("a frozen frontend cannot be taught; set one of the two to null")
        return value


class TrainingConfig(Config):
    """Settings of a training from the start."""

    kind: Literal["training"] = "training"  # type: ignore[assignment]
    loss: TrainingLossConfig = TrainingLossConfig()
    data: TrainingDataConfig = TrainingDataConfig()
    train: TaughtTrainConfig = TaughtTrainConfig()


class ComparedModelConfig(ModelConfig):
    """DEITalk's frontend with the decoder of FaceFormer or EmoTalk."""

    positions: bool = False
    intensity: bool = False
    decoder: Literal["faceformer", "emotalk"] = "faceformer"
    decoder_heads: Width = 4
    decoder_period: Window = 30
    """Frames of a period."""
    decoder_labelled: bool = True
    """emotalk: the emotion is given; false: it is the voice's only."""

    @property
    def network(self) -> str:
        """Module and class of the network."""
        return "deitalk.research.comparison:" + {"emotalk": "EmoTalk"}.get(
            self.decoder, "FaceFormer"
        )

    @model_validator(mode="after")
    def _decoders_stand_alone(self) -> "ComparedModelConfig":
        """Decoders of other papers have their own positions and their own emotion."""
        if self.decoder != "emotalk" and not self.decoder_labelled:
            raise ValueError("decoder_labelled: false is for decoder: emotalk")
        if self.positions or self.intensity:
            raise ValueError(f"decoder: {self.decoder} takes positions: false and intensity: false")
        is_causal = self.frontend.kind == "causal_whisper"
        kept = self.kept_controls or self.captured_emotions
        added = bool(kept) or self.actor_layers or self.own_decoder is not None
        if is_causal or added or self.decoder_direct:
            raise ValueError(
                f"decoder: {self.decoder} takes no causal frontend, kept_controls, "
                "captured_emotions, actor_layers, own_decoder or decoder_direct"
            )
        if self.decoder_channels % self.decoder_heads:
            raise ValueError("decoder_channels must be a multiple of decoder_heads")
        return self


class ComparedConfig(TrainingConfig):
    """Settings of a training of a decoder of another paper."""

    stored_kind: ClassVar[str] = "compared"
    kind: Literal["compared"] = "compared"  # type: ignore[assignment]
    model: ComparedModelConfig = ComparedModelConfig()


class AblatedMelConfig(SDFAMelConfig):
    """SDFA's encoder without one of its parts (SDFA §5.2.2)."""

    kind: Literal["mel_ablated"] = "mel_ablated"  # type: ignore[assignment]
    gathering: Literal["bilstm", "convolution"] = "bilstm"
    """What gathers a spectrum: Spec-BiLSTM, or convolutions."""
    summary: Literal["attention", "convolution"] = "attention"
    """What sums up a window: attention, or convolutions."""

    @property
    def encoder(self) -> str:
        """Module and class of the encoder."""
        return "deitalk.research.comparison.sdfa_parts:AblatedEncoder"


class KarrasConfig(Section):
    """Convolutions over frequency, then over time (after Karras et al. 2017)."""

    kind: Literal["karras"] = "karras"
    window_seconds: SpectrumSeconds = 0.016
    """Length of one spectrum."""
    frame_rate: SpectraRate = 125.0
    """Spectra per second."""
    lags: int = Field(default=32, ge=8, le=limits.MEL_BINS)
    """Autocorrelation numbers."""
    window_frames: Window = Field(default=64, ge=2)
    """Spectra a frame."""
    formant_channels: tuple[Width, ...] = Field(
        default=(72, 108, 162, 243, 256), min_length=1, max_length=limits.LAYERS
    )
    articulation_channels: tuple[Width, ...] = Field(
        default=(256,) * 5, min_length=1, max_length=limits.LAYERS
    )

    @property
    def encoder(self) -> str:
        """Module and class of the encoder."""
        return "deitalk.research.comparison.karras:KarrasEncoder"


class VocaConfig(Section):
    """Convolutions over a window of speech features (after Cudeiro et al. 2019)."""

    kind: Literal["voca"] = "voca"
    window_seconds: SpectrumSeconds = 0.032
    """Length of one spectrum."""
    frame_rate: SpectraRate = 60.0
    """Feature rows per second."""
    n_mels: int = Field(default=40, ge=8, le=limits.MEL_BINS)
    """Mel bins before the DCT."""
    n_mfcc: int = Field(default=26, ge=2, le=limits.MEL_BINS)
    """Cepstral coefficients."""
    window_frames: Window = Field(default=16, ge=2)
    """Rows a frame."""
    channels: tuple[Width, ...] = Field(
        default=(32, 32, 64, 64), min_length=1, max_length=limits.LAYERS
    )

    @property
    def encoder(self) -> str:
        """Module and class of the encoder."""
        return "deitalk.research.comparison.voca:VocaEncoder"


class MeshDataConfig(Section):
    """Mesh sequences and the bases of their gradients (SDFA §4.1, §4.3, §4.4)."""

    fps: float = Field(default=60.0, gt=0, le=240)
    """Frames per second of the meshes."""
    identities: tuple[Annotated[int, Field(ge=0, le=limits.SEED)], ...] = Field(
        default=(0, 1, 2, 3), min_length=1, max_length=limits.SPEAKERS
    )
    """Embedded heads that act a dataset folder's curves."""
    emotions: tuple[str, ...] | None = None
    """Emotions of such a folder that are acted; null: all."""
    clips: Positive | None = None
    """Clips taken of its training split, evenly spread; null: all."""
    validation_clips: Positive = 24
    """Clips taken of its validation split; its test split stays unseen."""
    augment: bool = True
    """All of §4.3."""
    basis_error_mm: AboveZero = 0.5
    """What the bases may cost where the face moves most."""
    basis_variance: float | None = Field(default=None, gt=0, le=1)
    """Share of the variance that the bases keep, .97 in §4.4; null: the fewest components within
    basis_error_mm."""
    weigh_triangles: bool = True
    """Count triangles by their area in the bases and the loss; false: all alike, as Eq. 5-8 are
    printed."""
    basis_frames: int = Field(default=400, ge=2, le=limits.TRAINING_FRAMES)
    """Frames that the bases are fitted to."""


class MeshTrainConfig(Optimisation):
    """Adam at a constant rate on pairs of adjacent frames (SDFA §4.4), and our additions."""

    batch_size: int = Field(default=100, ge=2, le=limits.BATCH)
    """frames; a multiple of segment_frames."""
    epochs: Passes = 50
    """Passes over all training frames."""
    segment_frames: int = Field(default=2, ge=2, le=limits.BATCH)
    """Adjacent frames drawn together; 2: the paper's pairs."""
    loss_decay: Inner = 0.99
    """Decay of the loss terms' second moments."""
    start_encoder: str | None = None
    """DEITalk model whose mel encoder is the start; it then learns at a third of the rate; not in
    the paper."""
    start_new: tuple[Literal["spectral", "recurrent", "attention"], ...] = ()
    """Parts of the encoder that are not copied from it: what an ablation replaces."""
    lip_weight: Weight = 0.0
    """Weight of the lips' rims; not in the paper."""

    @field_validator("segment_frames")
    @classmethod
    def _whole_segments(cls, value: int, info: ValidationInfo) -> int:
        batch = info.data.get("batch_size", value)
        if batch % value:
            raise ValueError(f"must divide batch_size, {batch}")
        return value


class MeshTrainingConfig(SDFAConfig):
    """Settings of a training of SDFA or a mesh head."""

    kind: Literal["sdfa_training"]  # type: ignore[assignment]
    data: MeshDataConfig = MeshDataConfig()
    train: MeshTrainConfig = MeshTrainConfig()

    @model_validator(mode="after")
    def _features_are_computed_once(self) -> "MeshTrainingConfig":
        if self.model.frontend.kind != "deitalk":
            return self
        if self.data.fps != 30 or self.data.augment or self.train.start_encoder is not None:
            raise ValueError(
                "model.frontend.kind=deitalk needs data.fps=30, data.augment=false and no "
                "train.start_encoder: its features are computed once, 30 a second"
            )
        return self


class ComparedSDFAModelConfig(SDFAModelConfig):
    """SDFA's decoder behind any encoder."""

    frontend: (
        SDFAMelConfig | AblatedMelConfig | KarrasConfig | VocaConfig | DEITalkFeaturesConfig
    ) = Field(default_factory=SDFAMelConfig, discriminator="kind")  # type: ignore[assignment]


class ComparedSDFAConfig(MeshTrainingConfig):
    """Settings of a run of a mesh model that SDFA is compared with."""

    stored_kind: ClassVar[str] = "sdfa_compared"
    kind: Literal["sdfa_compared"]  # type: ignore[assignment]
    model: ComparedSDFAModelConfig = ComparedSDFAModelConfig()


def read_training(path: Path | str, overrides: Sequence[str] = ()) -> AnyConfig:
    """Read the configuration of a training; one of curves is a `TrainingConfig`.

    Parameters and errors are those of `deitalk.config.load.load_config`.
    """
    tree = read_tree(path, overrides)
    if tree.get("kind", "deitalk") == "deitalk":
        tree["kind"] = "training"
    return parse_config(tree, named(path, overrides))
