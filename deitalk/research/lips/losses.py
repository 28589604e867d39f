"""Losses of the lips of the embedded head, which curves move; not in the papers.

Letters: B batch, T frames, C controls.
"""

import torch
from torch import Tensor

from deitalk.research.lips.head_lips import HeadLips
from rig.face.head import build_head

LIP_SPREAD_CM = (0.45, 0.30, 0.22, 0.18, 0.38, 0.18)
"""Standard deviation of each lip measure of people who read aloud, on the embedded head."""


STILL = 0.1
"""Share of that deviation that counts as no movement."""


LIP_WEIGHTS = (1.5, 1.0, 1.0, 0.7, 1.2, 0.5)
"""Weights of `deitalk.research.lips.head_lips.MEASURES`."""


def lip_loss(target: Tensor, predicted: Tensor) -> Tensor:
    """Distance of lips: squared error, squared error of the velocity, and lack of correlation.

    Not in the paper, whose controls are equal in the loss whatever they move.

    Parameters
    ----------
    target, predicted : Tensor [shape=(B, T, 6)]
        Lip measures, cm.
    """
    spread, weights = target.new_tensor(LIP_SPREAD_CM), target.new_tensor(LIP_WEIGHTS)
    a, b = target / spread, predicted / spread
    square = (a - b).square().mean(dim=1)
    velocity = (a - b).diff(dim=1).square().mean(dim=1)
    a, b = a - a.mean(dim=1, keepdim=True), b - b.mean(dim=1, keepdim=True)
    norm = (a.square().sum(dim=1) * b.square().sum(dim=1) + 1e-3).sqrt()
    lack = 1 - (a * b).sum(dim=1) / norm
    return ((square + 2 * velocity + lack) * weights).sum(dim=-1).mean()


def range_loss(target: Tensor, predicted: Tensor) -> Tensor:
    """Squared logarithm of how much further, and how much faster, the lips move than the target's.

    Not in the paper. A mean of what may have been moves less than each of it: where the sound
    explains a share r^2 of the motion, the least squared error has r times its range.

    Parameters
    ----------
    target, predicted : Tensor [shape=(B, T, 6)]
        Lip measures, cm.

    Returns
    -------
    Tensor, scalar
        0 for equal ranges and speeds; .96 if all measures move twice as far, and so twice as fast.
    """
    spread = target.new_tensor(LIP_SPREAD_CM)
    weights = target.new_tensor(LIP_WEIGHTS)
    least = (STILL * spread).square()
    cost = torch.zeros_like(target[:, 0])
    for a, b in ((target, predicted), (target.diff(dim=1), predicted.diff(dim=1))):
        ratio = (b.var(dim=1) + least).log() - (a.var(dim=1) + least).log()
        cost = cost + (ratio / 2).square()
    return (cost * weights / weights.mean()).mean()


class LipLoss:
    """Parts of the loss that compare the lips of captured and predicted curves.

    Parameters
    ----------
    with_range : bool
        Whether `range_loss` is among them.
    device : torch.device
        Where batches are.
    """

    def __init__(self, with_range: bool, device: torch.device) -> None:
        self.with_range, self.head = with_range, HeadLips(build_head()).to(device)

    def __call__(self, curves: Tensor, predicted: Tensor) -> dict[str, Tensor]:
        """``lips`` and, if wanted, ``range`` of curves (B, T, C)."""
        moved = self.head(curves), self.head(predicted)
        return {"lips": lip_loss(*moved)} | (
            {"range": range_loss(*moved)} if self.with_range else {}
        )
