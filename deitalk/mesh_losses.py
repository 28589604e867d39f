"""The loss of SDFA: values and differences of both branches, weighed automatically (§4.2).

Letters: M pairs of adjacent frames, D numbers of a frame.
"""

import torch
from torch import Tensor, nn

from deitalk.deformation_decoder import Deformation

TERMS = ("stretch_value", "stretch_difference", "rotation_value", "rotation_difference")


def value_loss(predicted: Tensor, target: Tensor, weights: Tensor) -> Tensor:
    """Mean square of the weighted error (Eq. 7).

    Parameters
    ----------
    predicted, target : Tensor [shape=(M, 2, D)]
        Pairs of adjacent frames: t - 1, then t.
    weights : Tensor [shape=(D,)]
        Root of each number's triangle area, over its mean.

    Notes
    -----
    Deviation: the paper weighs every triangle alike; small dense ones on the rims of lips and lids
    would then count most and show least. A mean stands for the sum: its scale is taken out below.
    """
    return ((predicted - target) * weights).square().mean()


def difference_loss(predicted: Tensor, target: Tensor, weights: Tensor) -> Tensor:
    """Mean square of the weighted error of x_t - x_(t-1) (Eq. 8); arguments as `value_loss`."""
    error = (predicted - target) * weights
    return (error[:, 1] - error[:, 0]).square().mean()


def mesh_terms(
    predicted: Deformation, target: Deformation, weights: tuple[Tensor, Tensor]
) -> dict[str, Tensor]:
    """The four terms of §4.2 under their names in `TERMS`.

    Parameters
    ----------
    predicted, target : Deformation
        s [shape=(M, 2, 6 N)] and r [shape=(M, 2, 3 N)].
    weights : (Tensor, Tensor)
        Of s [shape=(6 N,)] and of r [shape=(3 N,)].
    """
    parts: dict[str, Tensor] = {}
    for name, given, wanted, weight in zip(
        ("stretch", "rotation"), predicted, target, weights, strict=True
    ):
        parts[f"{name}_value"] = value_loss(given, wanted, weight)
        parts[f"{name}_difference"] = difference_loss(given, wanted, weight)
    return parts


class AutomaticWeights(nn.Module):
    """Scale every term by how large it has lately been (the dynamic scalars of Karras et al. 2017).

    The form used, for every term l of step t::

        v_t = decay v_(t-1) + (1 - decay) l_t^2        v_0 = 0
        scaled = l_t / (sqrt(v_t / (1 - decay^t)) + epsilon)

    as Adam scales gradients by their second moment. v is no part of the gradient. The total is the
    sum of the scaled terms, so that each weighs about 1 whatever its unit, and keeps that weight
    as it falls.

    Parameters
    ----------
    names : sequence of str
        Terms that `forward` will be given.
    decay : float
        Karras et al.'s beta_2.
    epsilon : float
        Keeps a term of zero finite.
    """

    second_moment: Tensor
    steps: Tensor

    def __init__(
        self, names: tuple[str, ...] = TERMS, decay: float = 0.99, epsilon: float = 1e-8
    ) -> None:
        super().__init__()
        self.names, self.decay, self.epsilon = names, decay, epsilon
        self.register_buffer("second_moment", torch.zeros(len(names), dtype=torch.float64))
        self.register_buffer("steps", torch.zeros((), dtype=torch.int64))

    def forward(self, parts: dict[str, Tensor]) -> Tensor:
        """Sum of the scaled terms; when training, the means move on first.

        A step whose terms are not finite leaves the means as they were.
        """
        terms = torch.stack([parts[name] for name in self.names])
        if self.training and bool(terms.isfinite().all()):
            squared = terms.detach().double().square().to(self.second_moment.device)
            self.second_moment.lerp_(squared, 1 - self.decay)
            self.steps += 1
        return (terms * self.weights().to(terms.dtype)).sum()

    def weights(self) -> Tensor:
        """Factor of every term now; 1 before the first step."""
        if not int(self.steps):
            return torch.ones_like(self.second_moment)
        moment = self.second_moment / (1 - self.decay ** int(self.steps))
        return 1 / (moment.sqrt() + self.epsilon)
