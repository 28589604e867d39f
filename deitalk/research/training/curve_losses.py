"""Parts of the loss that trainings from the start have beside those of Eq. 8.

Letters: B batch, T frames, K lips-together controls.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

from deitalk.errors import ConfigError
from rig import ControlSet


def contact_loss(target: Tensor, predicted: Tensor, known: Tensor | None = None) -> Tensor:
    """Penalise lips that do not meet in bilabials.

    Not in the paper. Where the target's lips are closed (> 0.9), falling short of 0.95 costs the
    square of what is missing;
    everywhere, the prediction's side of one half is scored by a cross entropy, so that the curve
    is decided rather than blurred.

    Parameters
    ----------
    target, predicted : Tensor [shape=(B, T, K)]
        The lips-together controls.
    known : Tensor [shape=(B, K)] or None
        1 where the clip holds the control, else 0; None is 1 everywhere.
    """
    shut = F.relu(0.95 - predicted).square() * (target > 0.9)
    decided = F.binary_cross_entropy_with_logits(
        8 * (predicted - 0.5), target.clamp(0, 1), reduction="none"
    )
    cost = (shut + 0.1 * decided).mean(dim=1)
    known = torch.ones_like(cost) if known is None else known
    return (cost * known).sum() / known.sum().clamp(min=1)


def control_weights(weights: dict[str, float], controls: ControlSet) -> Tensor:
    """Weight of every control from names of controls and of subsets; later entries win.

    Raises
    ------
    ConfigError
        If a name is neither.
    """
    out = torch.ones(len(controls.names))
    for name, value in weights.items():
        if name in controls.names:
            out[controls.index(name)] = value
        elif name in controls.subset_names:
            out[torch.as_tensor(controls.subset(name).copy())] = value
        else:
            matching = [i for i, control in enumerate(controls.names) if name in control]
            if not matching:
                raise ConfigError(
                    f"loss.control_weights: {name!r} is no control, part of one, or subset; "
                    f"subsets are {', '.join(controls.subset_names)}"
                )
            out[matching] = value
    return out
