"""Settings of a fine-tuning by base model and captures; a mix of the weights before and after."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from deitalk.config.curves import Config, FinetuneConfig
from deitalk.config.hub import pinned
from deitalk.config.load import load_config, parse_config, read_tree
from deitalk.config.rules import SharpenContacts
from deitalk.data.clips import Clip
from deitalk.errors import CheckpointError, ConfigError
from deitalk.evaluation.validation import knows_contact
from deitalk.models.checkpoint import check_kind
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import LIP_WEIGHTS, RIG_FILE, model_folder
from deitalk.postprocess.life.motion import ADDED_CONTROLS
from rig import ControlSet
from rig.arrays import Bool
from rig.errors import quoted

CONTACT_RULES = ("sharpen_contacts", "keep_contacts", "limit_contact_speed")
"""Rules of a model that act on its lip contacts."""

NO_TEACHER: dict[str, Any] = {"part": "all", "hold": 0.0, "rehearsal": 0.0}
"""Settings of `TuneConfig` where weights begin as random ones."""

INTENSITY_LOSS = {"contrast": 0.1, "classification": 0.1, "intensity": 20.0}
"""Weights of Eq. 8 where intensity is learnt: those of the paper, and of the base's training."""


def read_recipe(
    recipe: Path | None, overrides: Sequence[str] = (), *, base: str | None = None
) -> FinetuneConfig:
    """Settings of a recipe, with the network of the base model.

    Where the frontend learns too, windows are augmented unless the recipe says otherwise. With
    random weights at the start all learn, and the base is no teacher, unless the recipe says so.

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
        If the recipe is of another kind, a part of random weights is to be tuned, or as for
        `load_config`.
    CheckpointError
        If there is no such base model.
    """
    tree = read_tree(recipe, overrides) | {"kind": "finetune"}
    tune = tree.setdefault("tune", {})
    if base is not None:
        tune["base"] = base
    if tune.get("start") == "random":
        tune |= NO_TEACHER | tune
        if tune["part"] != "all":
            raise ConfigError(f"tune.part={tune['part']}: random weights all learn; leave it out")
    tune["base"] = pinned(str(tune.get("base", "default")))
    folder = model_folder(tune["base"])
    of_base = load_config(folder / "config.yaml")
    check_kind(tune["base"], of_base, DEITalk)
    network = of_base.model.model_dump(mode="json")
    network["lips"] = False  # what an actor shows is not corrected
    if network.get("control_set") == RIG_FILE:
        network["control_set"] = str(folder / RIG_FILE)
    tree["model"] = network | (tree.get("model") or {})
    if tune.get("part") == "all":  # a frontend of minutes of one voice needs many voices
        tree["data"] = {"augment": True} | (tree.get("data") or {})
    return cast("FinetuneConfig", parse_config(tree))


def with_actors(config: FinetuneConfig, clips: Sequence[Clip]) -> FinetuneConfig:
    """The configuration with the speakers of captures as actors, if there are several."""
    before = config.model.actors
    speakers = sorted({clip.speaker for clip in clips} - {*before})
    if len(speakers) + len(before) < 2:
        return config
    model = config.model.model_copy(update={"actors": (*before, *speakers)})
    return config.model_copy(update={"model": model})


def with_direct_layers(config: FinetuneConfig) -> FinetuneConfig:
    """The configuration whose last layers have the speech features, and one of each actor.

    Not from random weights, which are for comparison.
    """
    if config.tune.start != "base":
        return config
    layers = {"decoder_direct": True, "actor_layers": bool(config.model.actors)}
    return config.model_copy(update={"model": config.model.model_copy(update=layers)})


def _base_config(config: FinetuneConfig) -> Config:
    """Configuration of the base model."""
    return cast("Config", load_config(model_folder(config.tune.base) / "config.yaml"))


def is_same_rig(config: FinetuneConfig) -> bool:
    """Whether the captures are of the base's controls."""
    return _base_config(config).model.control_set == config.model.control_set


def with_base_parts(
    config: FinetuneConfig, controls: ControlSet, learnt: Bool, captured: Bool
) -> FinetuneConfig:
    """The configuration with what stays of the base: rules of contacts, and controls it moves.

    Parameters
    ----------
    config : FinetuneConfig
        A recipe with the network of the base.
    controls : ControlSet
        Of captures and base.
    learnt : array [shape=(C,)]
        From `learnt_controls`.
    captured : array [shape=(C,)]
        Those of them that a capture shows.

    Raises
    ------
    ConfigError
        If the base has controls of an earlier base and is to be tuned where these cannot stay.
    """
    return _with_kept_controls(
        _with_contact_rules(config, controls, captured), controls, learnt, captured
    )


def _with_contact_rules(
    config: FinetuneConfig, controls: ControlSet, captured: Bool
) -> FinetuneConfig:
    """`CONTACT_RULES` as the base has them, where the recipe has none.

    A network predicts a mean: its contacts, the base's and those learnt from captures, are seldom
    full, and without rules few of the found closures are held.
    """
    wanted = config.tune.contact_rules
    if wanted == "recipe" or (wanted == "auto" and knows_contact(captured, controls)):
        return config
    whole = _base_config(config)
    base = whole.rules
    if whole.model.lips:  # its numbers are for contacts that the readout corrects
        base = base.model_copy(update={"sharpen_contacts": SharpenContacts()})
    rules = {name: getattr(config.rules, name) or getattr(base, name) for name in CONTACT_RULES}
    return config.model_copy(update={"rules": config.rules.model_copy(update=rules)})


def _with_kept_controls(
    config: FinetuneConfig, controls: ControlSet, learnt: Bool, captured: Bool
) -> FinetuneConfig:
    """The controls that the base's own decoder is to move.

    Of a base that was tuned so itself, its first decoder stays for those that are still not shown.
    """
    base = _base_config(config).model
    if not config.tune.keep or config.tune.part == "all" or base.frontend.kind == "causal_whisper":
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
    model = config.model.model_copy(update={"kept_controls": names})
    return config.model_copy(update={"model": model})


def with_captured_intensity(config: FinetuneConfig) -> FinetuneConfig:
    """The configuration that learns intensity: its losses, and the base's for what it still moves.

    Weights of Eq. 8 that the recipe has are kept; those that are 0 become `INTENSITY_LOSS`.
    """
    weights = {
        name: getattr(config.loss, name) or weight for name, weight in INTENSITY_LOSS.items()
    }
    kept = {"kept_intensity": bool(config.model.kept_controls)}
    return config.model_copy(
        update={
            "loss": config.loss.model_copy(update=weights),
            "model": config.model.model_copy(update=kept),
        }
    )


def can_learn_intensity(config: FinetuneConfig) -> bool:
    """Whether the network has an intensity, and can keep the base's beside it where it must."""
    model = config.model
    if not model.intensity or config.tune.intensity == "base":
        return False
    return not model.kept_controls or model.saliency_frames is not None


def learnt_controls(config: FinetuneConfig, controls: ControlSet) -> Bool:
    """Controls to train [shape=(C,)]: no blinks and gaze where a rule adds them."""
    is_added = config.rules.idle is not None
    names = controls.names
    return np.array([not (is_added and any(p in n for p in ADDED_CONTROLS)) for n in names], bool)


# Weights between those of a model before and after a training.
#
# A model that was tuned on little data follows it closely and forgets some of what it knew. Between
# the two sets of weights both change smoothly, so that a share of the training can be kept.


LAST, ACTORS = "decoder.output.weight", ("decoder.actor_layers.", "decoder.actors.")
KEPT = ("decoder.kept.", "intensity.kept.")
"""Parts of a tuned model that are those of its base, and did not learn."""


def mix_models(before: DEITalk, after: DEITalk, share: float) -> DEITalk:
    """Return a model whose weights are ``(1 - share) * before + share * after``.

    Parameters
    ----------
    before, after : DEITalk
        Two networks of one shape, usually the base of a tuning and its result; not changed.
    share : float
        Of the weights of `after`, 0 to 1.

    Returns
    -------
    DEITalk
        In evaluation mode, on the device of `after`, with its controls and actors.

    Raises
    ------
    CheckpointError
        If the share is beyond 0 to 1, or the networks or their controls differ.
    """
    if not 0 <= share <= 1:
        raise CheckpointError(f"share {quoted(share)} is beyond 0 to 1")
    if before.controls.names != after.controls.names:
        raise CheckpointError("the models have different controls; mix models of one rig")
    if type(before.frontend) is not type(after.frontend):
        raise CheckpointError(
            f"the networks differ: {type(before.frontend).__name__} and "
            f"{type(after.frontend).__name__}; mix a model with one that was tuned from it"
        )
    new = after.state_dict()
    old = _widened(before.state_dict(), new)
    _check_shapes(old, new)
    model = deepcopy(after).eval()
    model.load_state_dict({
        name: torch.lerp(old[name].to(value), value, share) if value.is_floating_point() else value
        for name, value in new.items()
    })  # fmt: skip
    return model


def _widened(
    old: Mapping[str, torch.Tensor], new: Mapping[str, torch.Tensor]
) -> dict[str, torch.Tensor]:
    """The weights before, with what a tuning adds: inputs and actors at 0, parts of the base."""
    wide = dict(old)
    for name, value in new.items():
        if name.startswith(ACTORS):
            wide.setdefault(name, torch.zeros_like(value))
        elif name.startswith(KEPT):
            wide.setdefault(name, value)
        elif name == LAST and name in old and old[name].shape[1] < value.shape[1]:
            wide[name] = torch.zeros_like(value)
            wide[name][:, : old[name].shape[1]] = old[name]
    return {k: v for k, v in wide.items() if k in new or not k.startswith(LIP_WEIGHTS)}


def _check_shapes(old: Mapping[str, torch.Tensor], new: Mapping[str, torch.Tensor]) -> None:
    shapes = [
        {name: tuple(value.shape) for name, value in weights.items()} for weights in (old, new)
    ]
    for name in sorted(shapes[0].keys() | shapes[1].keys()):
        if (a := shapes[0].get(name)) != (b := shapes[1].get(name)):
            raise CheckpointError(
                f"the networks differ: {name} is {a or 'absent'} in one and {b or 'absent'} in the "
                "other; mix a model with one that was tuned from it, of the same actors"
            )
