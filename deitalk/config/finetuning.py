"""Settings of fine-tuning a curve model on captures; the defaults are the recipe.

A recipe has no ``model`` section: the network is that of the base model.
"""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from deitalk.config.curves import Config, DataConfig, LossConfig, TrainConfig
from deitalk.config.rules import RulesConfig
from deitalk.config.section import (
    Section,
    Share,
    Weight,
)
from rig import limits


class TuneConfig(Section):
    """What is tuned, and what holds the base model's abilities."""

    base: str = "default"
    """Model that is tuned: a name or a folder."""
    part: Literal["head", "decoder", "all"] = "decoder"
    """What the steps change: the last layer, the decoder, or every weight."""
    range: Annotated[float, Field(gt=0, le=1)] | None = None
    """Share of the captured spread to which every control is raised about its mean, in every style,
    its timing unchanged: a regression moves less the less it knows. null: as regressed, with the
    least error."""
    hold: Weight = 1.0
    """Weight of the base's curves as the target of controls that a clip does not know."""
    keep: bool = True
    """Controls that no capture knows stay those of the base, by its own decoder; not where the
    frontend learns."""
    anonymous: Share = 0.2
    """Share of windows shown without their actor: what a stranger gets is the mean of the actors.
    """
    base_rules: bool = True
    """The rules of the base hold where captures do not teach what they do; false: those of the
    section `rules` alone."""
    intensity: Literal["auto", "base", "captured"] = "auto"
    """Emotional intensity: the base's, or learnt from captured motion (DEITalk Eq. 4-11) with the
    strength of the captured expressions; auto learns it where emotions differ from neutral in the
    captures."""
    map: str | None = None
    """Table of the curves of another rig to board, raw curves or ARKit, as of the import; with it
    emotions that captures lack are carried to the rig. Public rigs need none."""
    conventions: bool = True
    """Takes of an actor that relate the face to the sound otherwise than others have styles of
    their own, found by how well one predicts the other."""
    corpus: str | None = None
    """Dataset folder whose speech the base's curves are learnt on."""
    leave_out: str | None = None
    """Take or actor that is tested on and never trained on."""


class TuneTraining(TrainConfig):
    """Optimiser and schedule of a fine-tuning's steps."""

    steps: Annotated[int, Field(ge=0, le=limits.TRAINING_STEPS)] = 0
    """Steps after the regression; 0: none."""


class FinetuneConfig(Config):
    """Settings of a fine-tuning: a regression, then steps at low rates, if any."""

    kind: Literal["finetune"] = "finetune"  # type: ignore[assignment]
    name: str = "finetune"
    rules: RulesConfig = RulesConfig.for_captures()
    loss: LossConfig = LossConfig(contrast=0, classification=0, velocity=2.0)
    data: DataConfig = DataConfig(real_fraction=0.7)
    train: TuneTraining = TuneTraining(
        learning_rate=1e-4,
        optimizer="adamw",
        weight_decay=0.05,
        schedule="one_cycle",
        batch_size=8,
        gradient_clip=5.0,
        ema=0.98,
        evaluate_every=20,
        patience=3,
        workers=1,
    )
    tune: TuneConfig = TuneConfig()

    @model_validator(mode="before")
    @classmethod
    def _over_the_recipe(cls, tree: dict[str, Any]) -> dict[str, Any]:
        """A section that names some settings leaves the others as the recipe has them."""
        recipe = {
            name: field.default.model_dump()
            for name, field in cls.model_fields.items()
            if hasattr(field.default, "model_dump") and isinstance(tree.get(name), dict)
        }
        return tree | {name: settings | tree[name] for name, settings in recipe.items()}
