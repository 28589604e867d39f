"""Settings of fine-tuning a curve model on captures; the defaults are the recipe.

A recipe has no ``model`` section: the network is that of the base model.
"""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from deitalk.config.curves import Config, DataConfig, LossConfig, TrainConfig
from deitalk.config.rules import RulesConfig
from deitalk.config.section import Section
from rig import limits


class TuneConfig(Section):
    """What is tuned, and what holds the base model's abilities."""

    base: str = Field(default="default", description="model that is tuned: a name or a folder")
    part: Literal["head", "decoder", "adapters", "all"] = Field(
        default="decoder",
        description="the last layer; the decoder; changes of low rank of it; every weight",
    )
    start: Literal["base", "random"] = Field(
        default="base",
        description="weights before the first step: the base's, or random ones of the same "
        "network, all of which learn, to compare with",
    )
    rank: Annotated[int, Field(ge=1, le=limits.WIDTH)] = Field(
        default=8, description="of the changes that `adapters` learns"
    )
    hold: float = Field(
        default=1.0,
        ge=0,
        description="weight of the base's curves as the target of controls that a clip does not "
        "know",
    )
    keep: bool = Field(
        default=True,
        description="controls that no capture knows stay those of the base, by its own decoder; "
        "not where the frontend learns",
    )
    ranges: bool = Field(
        default=True,
        description="of another rig: a gain and an offset of every control for each actor",
    )
    rehearsal: float = Field(
        default=0.25,
        ge=0,
        le=1,
        description="share of windows shown in an emotion that no capture has: the captured "
        "curves, changed as the base's",
    )
    anonymous: float = Field(
        default=0.2,
        ge=0,
        le=1,
        description="share of windows shown without their actor: what a stranger gets is the mean "
        "of the actors",
    )
    contact_rules: Literal["auto", "base", "recipe"] = Field(
        default="auto",
        description="rules of lip contacts: the base's, or those of the section `rules`; auto is "
        "the base's where no capture knows the lips-together controls",
    )
    intensity: Literal["auto", "base", "captured"] = Field(
        default="auto",
        description="emotional intensity: the base's, or learnt from captured motion (DEITalk Eq. "
        "4-11) with the strength of the captured expressions; auto learns it where emotions differ "
        "from neutral in the captures",
    )
    corpus: str | None = Field(
        default=None, description="dataset folder whose speech the base's curves are learnt on"
    )
    leave_out: str | None = Field(
        default=None, description="take or actor that is tested on and never trained on"
    )


class FinetuneConfig(Config):
    """Settings of a fine-tuning: low rates, few steps, an end when nothing improves."""

    kind: Literal["finetune"] = "finetune"
    name: str = "finetune"
    rules: RulesConfig = RulesConfig.for_captures()
    loss: LossConfig = LossConfig(contrast=0, classification=0, velocity=2.0)
    data: DataConfig = DataConfig(real_fraction=0.7)
    train: TrainConfig = TrainConfig(
        learning_rate=3e-4,
        optimizer="adamw",
        weight_decay=0.05,
        schedule="one_cycle",
        batch_size=8,
        steps=200,
        gradient_clip=5.0,
        ema=0.98,
        evaluate_every=25,
        patience=3,
    )
    tune: TuneConfig = TuneConfig()

    @model_validator(mode="before")
    @classmethod
    def _over_the_recipe(cls, tree: dict[str, Any]) -> dict[str, Any]:
        """A section that names some settings leaves the others as the recipe has them."""
        recipe = {
            name: field.default.model_dump()
            for name, field in cls.model_fields.items()
            if isinstance(field.default, Section) and isinstance(tree.get(name), dict)
        }
        return tree | {name: settings | tree[name] for name, settings in recipe.items()}
