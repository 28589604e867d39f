"""Settings of SDFA and of the mesh head, the models of a mesh: network, data and training."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from deitalk.config.frontends import DEITalkFeaturesConfig, SDFAMelConfig
from deitalk.config.section import (
    AboveZero,
    Inner,
    Optimisation,
    Passes,
    Positive,
    Section,
    Weight,
    Width,
)
from rig import limits


class SDFAModelConfig(Section):
    """A speech encoder and the decoder of SDFA §3.4; defaults are Tables 1-3."""

    frontend: SDFAMelConfig | DEITalkFeaturesConfig = Field(
        default_factory=SDFAMelConfig, discriminator="kind"
    )
    motion: Literal["gradients", "offsets"] = "gradients"
    """What is predicted: deformation gradients, vertex offsets."""
    shared_size: Width | None = 512
    """Width of z_dec; null: the encoder's output goes on as it is."""
    branch_sizes: tuple[Width, ...] = Field(default=(512, 256), max_length=limits.LAYERS)
    weight_norm: bool = True
    """Weight normalisation in the decoder, but on no frozen layer."""
    seal_mm: Weight = 0.0
    """Embedded heads: lips no further apart are brought together; not in the paper."""


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


class SDFAConfig(Section):
    """Settings of a run of SDFA or a mesh head; chosen by ``kind: sdfa``."""

    product: ClassVar[str] = "mesh"
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
