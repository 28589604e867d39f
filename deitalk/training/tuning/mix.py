"""Weights between those of a model before and after a training.

A model that was tuned on little data follows it closely and forgets some of what it knew.
Between the two sets of weights both change smoothly, so that a share of the training can be
kept.
"""

from collections.abc import Mapping
from copy import deepcopy

import torch

from deitalk.errors import CheckpointError
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import LIP_WEIGHTS
from rig.errors import quoted

LAST, ACTORS = "decoder.output.weight", ("decoder.actor_layers.", "decoder.actors.")
KEPT = ("decoder.kept.", "decoder.change.", "intensity.kept.")
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
    shapes = [
        {name: tuple(value.shape) for name, value in weights.items()} for weights in (old, new)
    ]
    for name in sorted(shapes[0].keys() | shapes[1].keys()):
        if (a := shapes[0].get(name)) != (b := shapes[1].get(name)):
            raise CheckpointError(
                f"the networks differ: {name} is {a or 'absent'} in one and {b or 'absent'} in the "
                "other; mix a model with one that was tuned from it, of the same actors"
            )
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
