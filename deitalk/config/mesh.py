"""Settings of SDFA and of the mesh head, the networks of a mesh."""

from typing import ClassVar, Literal

from pydantic import Field

from deitalk.config.frontends import DEITalkFeaturesConfig, SDFAMelConfig
from deitalk.config.section import Section, Weight, Width
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


class SDFAConfig(Section):
    """What describes a model of SDFA or a mesh head; chosen by ``kind: sdfa``."""

    product: ClassVar[str] = "mesh"
    stored_kind: ClassVar[str] = "sdfa"
    kind: Literal["sdfa"]
    name: str = "sdfa"
    model: SDFAModelConfig = SDFAModelConfig()
