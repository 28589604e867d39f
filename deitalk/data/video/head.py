"""Measures of a face that landmarks show, as a differentiable function of the 185 curves.

Widens the lips of `deitalk.data.lips.head` by each side of the mouth, brows and lids; lids turn
about the eyeball as in `rig.face.motion.lids`.

Letters: T frames, C controls, K inputs of the head, N points, P pairs of the rims, M measures.
"""

import numpy as np
import torch
from torch import Tensor

from deitalk.data.lips.head import CENTRAL, HeadLips
from rig.arrays import Float64
from rig.face.head import Head
from rig.face.web_export import head_arrays
from rig.retarget.source_head import head_landmarks

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

    halves: Tensor
    eye_centers: Tensor

    def __init__(self, head: Head) -> None:
        marks = head_landmarks(head)
        brows = [_brow_vertex(head, s, place) for s in SIDES for place in BROW_PLACES.values()]
        lids = [marks[f"eye_{part}_{s}"] for s in ("left", "right") for part in ("upper", "lower")]
        edges = [marks["upper_lip_top"], marks["lower_lip_bottom"]]
        super().__init__(head, (*edges, *brows, *lids))
        arrays, facts = head_arrays(head)
        left = np.asarray(arrays["seal.left"], np.float64)
        central = np.abs(arrays["seal.u"]) <= CENTRAL
        halves = np.stack([central * left, central * (1 - left)])
        self._keep("halves", halves / halves.sum(axis=1, keepdims=True))
        eye = np.asarray(facts["eye"])
        self._keep("eye_centers", np.stack([eye, eye * [-1, 1, 1]]))
        self._least, self._meet = float(facts["lidLeast"]), float(facts["lidMeet"])
        outer, inner = (head.skin.vertices[marks[f"eye_{k}_left"]] for k in ("outer", "inner"))
        self.eye_width = float(np.linalg.norm(outer - inner))
        self.iris_radius = float(facts["eyeRadius"])

    def forward(self, curves: Tensor) -> Tensor:
        """Measure curves (..., C) as `HeadLips.forward`, by `MEASURES` of this module (..., M)."""
        inputs = self.inputs(curves)
        upper, lower, others = self.points(inputs)
        left, right, chin, nose, top, bottom = others[..., :6, :].unbind(-2)
        brows = others[..., 6:12, :].reshape(*curves.shape[:-1], 2, 3, 3)
        rims = [(rim[..., 1] @ self.halves.T) for rim in (upper, lower)]
        middle = [(rim * self.central[:, None]).sum(-2) for rim in (upper, lower)]
        below = nose[..., 1, None]
        corners = torch.stack((left, right), dim=-2)
        signs = curves.new_tensor([1.0, -1.0])
        lids = others[..., 12:16, :].reshape(*curves.shape[:-1], 2, 2, 3)
        gap, low = self._lids(lids, inputs)
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

    def _lids(self, lids: Tensor, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Gap and height of the lower lid (..., 2) of both eyes; `lids` (..., 2 eyes, 2, 3)."""
        height, depth = ((lids - self.eye_centers[:, None])[..., axis] for axis in (1, 2))
        angle = torch.atan2(height, depth)
        far = (height.square() + depth.square()).sqrt().clamp(min=self._least)
        gap = (angle[..., 0] - angle[..., 1]).clamp(min=0)
        up, low = self._turns(gap, inputs)
        turned = far * torch.sin(angle + torch.stack((up, low), dim=-1))
        return turned[..., 0] - turned[..., 1], turned[..., 1]

    def _turns(self, gap: Tensor, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Upward turns (..., 2) of the upper and the lower lids' middles, radians."""
        get = {
            kind: torch.stack(
                [inputs[..., self._inputs[f"lid.{kind}_{s}"]] for s in SIDES], dim=-1
            ).clamp(0, 1)
            for kind in (
                "close", "upper", "lower", "lookUp", "lookDown", "widen", "upperUp", "lowerDown",
                "frown",
            )
        }  # fmt: skip
        blink = get["close"]
        open_ = 1 - blink
        close = blink + open_ * (0.85 * get["upper"] + 0.60 * get["lookDown"])
        close = (close + 0.15 * get["frown"]).clamp(0, 1)
        rise = (open_ * 0.8 * get["lower"] + blink * self._meet).clamp(0, 1)
        widen = (0.24 * get["widen"] + 0.20 * get["upperUp"] + 0.24 * get["lookUp"]) * open_
        dip = (0.06 * get["widen"] + 0.16 * get["lowerDown"]).clamp(max=0.26)
        ride = 0.30 * get["lookDown"] - 0.10 * get["lookUp"] * open_
        room = 1 - (1 - self._meet) * close
        up = -(1 - self._meet) * close * gap + widen.clamp(max=0.36) - ride
        return up, torch.minimum(rise, room) * gap - dip * (1 - close) - ride


def _brow_vertex(head: Head, side: str, place: float) -> int:
    """Vertex of the skin under a place of a brow."""
    brow: Float64 = head.parts[f"brow_{side}"].vertices
    along = np.abs(brow[:, 0])
    wanted = along.min() + place * np.ptp(along)
    near = brow[np.abs(along - wanted) <= 0.08 * np.ptp(along)].mean(axis=0)
    return int(np.argmin(np.linalg.norm(head.skin.vertices - near, axis=1)))
