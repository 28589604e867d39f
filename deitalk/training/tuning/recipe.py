"""Settings of a fine-tuning by base model and captures; a mix of the weights before and after."""

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from deitalk.config.curves import Config
from deitalk.config.finetuning import FinetuneConfig
from deitalk.config.hub import pinned
from deitalk.config.load import load_model_config, named, parse_config, read_tree
from deitalk.config.rig_file import read_controls
from deitalk.config.rules import RulesConfig, SharpenContacts
from deitalk.config.section import NO_SECTION
from deitalk.data.captures.columns import read_mapping
from deitalk.data.clips import Clip
from deitalk.emotions import EMOTIONS
from deitalk.errors import ConfigError
from deitalk.models.checkpoint import check_kind
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import RIG_FILE, model_folder
from deitalk.models.lip_readout import CONTACTS
from deitalk.postprocess.control_groups import LIVELY
from deitalk.postprocess.life.motion import ADDED_CONTROLS
from deitalk.training.tuning.carry import carry_matrix
from deitalk.training.tuning.ridge import MANY
from rig import ControlSet
from rig.arrays import Bool, Float64
from rig.errors import quoted

INTENSITY_LOSS = {"contrast": 0.1, "classification": 0.1, "intensity": 20.0}
"""Weights of Eq. 8 where intensity is learnt: those of the paper, and of the base's training."""


def read_recipe(
    recipe: Path | None, overrides: Sequence[str] = (), *, base: str | None = None
) -> FinetuneConfig:
    """Settings of a recipe, with the network of the base model.

    Where the frontend learns too, windows are augmented unless the recipe says otherwise.

    Parameters
    ----------
    recipe : Path or None
        YAML; None is the default recipe.
    overrides : sequence of str
        As for `load_config`.
    base : str or None
        Instead of the recipe's ``tune.base``.

    Raises
    ------
    ConfigError
        If the recipe is of another kind, or as for `load_config`.
    CheckpointError
        If there is no such base model.
    """
    tree, where = read_tree(recipe, overrides), named(recipe, overrides)
    if (kind := tree.setdefault("kind", "finetune")) != "finetune":
        raise ConfigError(f"{where}: kind={quoted(kind)}: a recipe is of the kind finetune")
    for name in ("tune", "model", "data"):
        if not isinstance(section := tree.get(name) or {}, dict):
            raise ConfigError(f"{where}: {name}={quoted(section)}: {NO_SECTION}")
        tree[name] = dict(section)
    tune = tree["tune"]
    if base is not None:
        tune["base"] = base
    tune["base"] = pinned(str(tune.get("base", "default")))
    folder = model_folder(tune["base"])
    of_base = load_model_config(folder)
    check_kind(tune["base"], of_base, DEITalk)
    if of_base.kind != "deitalk":
        raise ConfigError(
            f"tune.base: {tune['base']!r} has a decoder for comparison; fine-tune a model such as "
            "default"
        )
    network = of_base.model.model_dump(mode="json")
    network["lips"] = False  # but for what `with_base_parts` keeps
    if network.get("control_set") == RIG_FILE:
        network["control_set"] = str(folder / RIG_FILE)
    tree["model"] = network | tree["model"]
    if tune.get("part") == "all":  # a frontend of minutes of one voice needs many voices
        tree["data"] = {"augment": True} | tree["data"]
    return cast("FinetuneConfig", parse_config(tree, where))


def with_styles(
    config: FinetuneConfig, clips: Sequence[Clip], before: tuple[str, ...]
) -> FinetuneConfig:
    """The configuration with a style, and a last layer with the speech features, of every actor.

    Speakers of captures are actors after those `before` where that makes several. Many have offsets
    alone, unless the base has layers of its own actors.
    """
    speakers = {clip.speaker for clip in clips}
    every = (*before, *sorted(speakers - {*before}))
    actors = every if len(every) > 1 else before
    own: bool | str = bool(actors)
    if len(speakers) >= MANY:
        given = is_same_rig(config) and _base_config(config).model.actor_layers
        own = True if given is True else "offsets"
    layers = {"actors": actors, "decoder_direct": True, "actor_layers": own}
    return config.model_copy(update={"model": config.model.model_copy(update=layers)})


def _base_config(config: FinetuneConfig) -> Config:
    """Configuration of the base model."""
    return cast("Config", load_model_config(model_folder(config.tune.base)))


def is_same_rig(config: FinetuneConfig) -> bool:
    """Whether the captures are of the base's controls."""
    return base_controls(config).names == read_controls(config.model.control_set).names


def with_base_parts(
    config: FinetuneConfig,
    controls: ControlSet,
    learnt: Bool,
    captured: Bool,
    emotions: Collection[str],
) -> FinetuneConfig:
    """The configuration with what stays of the base: rules, controls and emotions.

    Parameters
    ----------
    config : FinetuneConfig
        A recipe with the network of the base.
    controls : ControlSet
        Of the captures.
    learnt : array [shape=(C,)]
        From `learnt_controls`.
    captured : array [shape=(C,)]
        Those of them that a capture shows.
    emotions : collection of str
        Those of the captures.

    Raises
    ------
    ConfigError
        If the base has controls of an earlier base and is to be tuned where these cannot stay.
    """
    base, same_rig = _base_config(config), is_same_rig(config)
    shown = tuple(emotion for emotion in EMOTIONS if emotion in emotions)
    size = base.model.base_controls
    if not same_rig:
        size = 0 if carried(config, controls) is None else len(base_controls(config))
    changes: dict[str, Any] = {"captured_emotions": shown, "base_controls": size}
    model = config.model.model_copy(update=changes | {"kept_controls": (), "kept_intensity": False})
    config = config.model_copy(update={"model": model})
    if same_rig and size != 0:  # else the start of the decoder has what captures lack
        config = _with_kept_controls(config, controls, learnt, captured)
    if config.tune.base_rules:
        lips = any(
            shows and any(part in name for part in LIVELY)
            for name, shows in zip(controls.names, captured, strict=True)
        )
        of_base, corrects = base.rules, config.model.lips
        if base.model.lips and (not corrects or (captured & contact_controls(controls)).any()):
            # The base's numbers are for contacts that the readout corrects.
            of_base = of_base.model_copy(update={"sharpen_contacts": SharpenContacts()})
        rules = config.rules.taught(of_base, shown, lips=lips, other_rig=not same_rig)
        config = config.model_copy(update={"rules": rules})
    return config


def contact_controls(controls: ControlSet) -> Bool:
    """Whether each control is of a contact of the lips [shape=(C,)]."""
    return np.array([any(part in name for part in CONTACTS) for name in controls.names])


def base_controls(config: FinetuneConfig) -> ControlSet:
    """Controls of the base."""
    name = _base_config(config).model.control_set
    return read_controls(str(model_folder(config.tune.base) / name) if name == RIG_FILE else name)


def carried(config: FinetuneConfig, controls: ControlSet) -> Float64 | None:
    """Shares of the base's controls in those of the captures; None where nothing relates them.

    Raises
    ------
    DataError
        If the table of ``tune.map`` cannot be read, or names other curves.
    """
    mapping = None if config.tune.map is None else read_mapping(Path(config.tune.map))
    return carry_matrix(base_controls(config), controls, mapping)


def _with_kept_controls(
    config: FinetuneConfig, controls: ControlSet, learnt: Bool, captured: Bool
) -> FinetuneConfig:
    """The controls that the base's own decoder is to move.

    Of a base that was tuned so itself, its first decoder stays for those that are still not shown.
    """
    base = _base_config(config).model
    if not config.tune.keep or config.tune.part == "all":
        if base.kept_controls:
            raise ConfigError(
                f"tune.part={config.tune.part}, tune.keep={config.tune.keep}: {config.tune.base} "
                "has controls of an earlier base, which need the same frontend; tune that base"
            )
        return config
    if captured[learnt].all() and not base.kept_controls:
        return config
    kept = set(base.kept_controls or controls.names)
    names = tuple(
        name
        for name, shown in zip(controls.names, captured, strict=True)
        if name in kept and not shown
    )
    model = config.model.model_copy(update={"kept_controls": names, "lips": base.lips})
    return config.model_copy(update={"model": model})


def with_captured_intensity(config: FinetuneConfig) -> FinetuneConfig:
    """The configuration that learns intensity: its losses, and the base's for what it still moves.

    Weights of Eq. 8 that the recipe has are kept; those that are 0 become `INTENSITY_LOSS`.
    """
    weights = {
        name: getattr(config.loss, name) or weight for name, weight in INTENSITY_LOSS.items()
    }
    kept = {"kept_intensity": config.model.base_controls != 0}
    return config.model_copy(
        update={
            "loss": config.loss.model_copy(update=weights),
            "model": config.model.model_copy(update=kept),
        }
    )


def can_learn_intensity(config: FinetuneConfig) -> bool:
    """Whether the network has an intensity, and can keep the base's beside it."""
    model = config.model
    if not model.intensity or config.tune.intensity == "base":
        return False
    return model.saliency_frames is not None and model.frontend.kind != "causal_whisper"


def learnt_controls(rules: RulesConfig, controls: ControlSet) -> Bool:
    """Controls to train [shape=(C,)]: no blinks and gaze where a rule adds them."""
    is_added = rules.idle is not None
    names = controls.names
    return np.array([not (is_added and any(p in n for p in ADDED_CONTROLS)) for n in names], bool)
