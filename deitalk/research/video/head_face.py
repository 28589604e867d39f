"""Measures of a face that landmarks show, as a differentiable function of the 185 curves.

Widens the lips of `HeadLips` by each side of the mouth, brows and lids.

Letters: T frames, C controls, N points, P columns of the rims, M measures.
"""

import numpy as np
import torch
from torch import Tensor

from deitalk.research.lips.head_lips import CENTRAL, HeadLips
from rig.arrays import Float32, Int64
from rig.face.head import Head

SIDES = ("L", "R")
MOUTH = (
    "opening", "jaw", "jaw_side", "upper_edge", "lower_edge",
    *(f"{name}_{s}" for name in ("corner_out", "corner", "upper", "lower") for s in SIDES),
)  # fmt: skip
UPPER = tuple(
    f"{name}_{s}"
    for name in ("brow_in", "brow_mid", "brow_out", "brow_squeeze", "lid", "lower_lid")
    for s in SIDES
)
MEASURES = MOUTH + UPPER
"""Gap of the rims, chin to nose base, chin to the left, thickness of both lips; corners from the
middle, and corners and rims below the nose base; brows above the eyes at three places, inner ends
of the brows from the middle, gap of the lids, height of the lower lid. L is the person's left."""
BROW_PLACES = {"in": 0.12, "mid": 0.5, "out": 0.85}
"""Along a brow from its inner end."""


class HeadFace(HeadLips):
    """Curves to measures of one head's face.

    Parameters
    ----------
    head : Head
        An embedded head.

    Attributes
    ----------
    eye_width, iris_radius : float
        Between the corners of one eye, and of the iris's centre about the eye's, cm.
    """

    sides: Tensor

    def __init__(self, head: Head) -> None:
        marks = head.landmarks
        brows = [_brow_place(head, s, place) for s in SIDES for place in BROW_PLACES.values()]
        lids = [marks[f"eye_{part}_{s}"] for s in ("left", "right") for part in ("upper", "lower")]
        edges = [marks["upper_lip_top"], marks["lower_lip_bottom"]]
        super().__init__(head, (*edges, *brows, *lids))
        along = np.linspace(-1, 1, self.n_pairs)
        central = np.abs(along) <= CENTRAL
        sides = np.stack([central * (along > 0), central * (along < 0)])
        self._keep("sides", sides / sides.sum(axis=1, keepdims=True))
        outer, inner = (head.skin.vertices[marks[f"eye_{k}_left"]] for k in ("outer", "inner"))
        self.eye_width = float(np.linalg.norm(outer - inner))
        self.iris_radius = float(head.eyes[0, 3])

    def forward(self, curves: Tensor) -> Tensor:
        """Measure curves (..., C) as `HeadLips.forward`, by `MEASURES` of this module (..., M)."""
        upper, lower, others = self.points(curves)
        left, right, chin, nose, top, bottom = others[..., :6, :].unbind(-2)
        brows = others[..., 6:12, :].reshape(*curves.shape[:-1], 2, 3, 3)
        rims = [(rim[..., 1] @ self.sides.T) for rim in (upper, lower)]
        middle = [(rim * self.central[:, None]).sum(-2) for rim in (upper, lower)]
        below = nose[..., 1, None]
        corners = torch.stack((left, right), dim=-2)
        signs = curves.new_tensor([1.0, -1.0])
        lids = others[..., 12:16, :].reshape(*curves.shape[:-1], 2, 2, 3)
        gap, low = lids[..., 0, 1] - lids[..., 1, 1], lids[..., 1, 1]
        measures = (
            torch.stack(
                (
                    (middle[0] - middle[1])[..., 1],
                    (nose - chin)[..., 1],
                    (chin - nose)[..., 0],
                    (top - middle[0])[..., 1],
                    (middle[1] - bottom)[..., 1],
                ),
                dim=-1,
            ),
            (corners[..., 0] - nose[..., 0, None]) * signs,
            below - corners[..., 1],
            below - rims[0],
            below - rims[1],
            *brows[..., 1].unbind(-1),
            brows[..., 0, 0] * signs,
            gap,
            low,
        )
        return torch.cat(measures, dim=-1)


def _brow_place(head: Head, side: str, place: float) -> tuple[Int64, Float32]:
    """The skin that a place of a brow follows: vertices and their weights."""
    part = head.slices[f"brow_{side}"]
    along = np.abs(head.mesh.vertices[part, 0])
    wanted = along.min() + place * np.ptp(along)
    near = part.start + np.flatnonzero(np.abs(along - wanted) <= 0.08 * np.ptp(along))
    rows = np.searchsorted(head.follow, near)
    weights = head.near_weight[rows] / np.float32(len(rows))
    return head.near[rows].ravel(), weights.ravel()
