"""Lip measures of an embedded head as a differentiable function of the 185 curves.

The measures are those that video and articulographs take of people: opening, jaw, width, and the
heights of the lips and of the corners. Curves can be compared with measured lips and be fitted to
them.

The rims of the lips, the corners, the chin and the base of the nose move as in
`rig.face.head.Head.pose`: linear shapes, rotation of the jaw, seal of the lips. Left out is the
clearance between lips and teeth, which moves the lips mostly forward.

Letters: T frames, C controls, K inputs of the head, N points, P pairs of the rims, M measures.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from rig.arrays import Float32, Float64, Int64
from rig.face.geometry.mesh import smoothstep
from rig.face.head import Head
from rig.face.motion.rigid import UPPER_PART
from rig.face.web_export import head_arrays
from rig.retarget.morph_head import head_landmarks

MEASURES = ("opening", "jaw", "width", "upper_lip", "lower_lip", "corner")
"""Mean gap of the rims, chin to nose base, distance of the corners; upper rim, lower rim and
corners below the nose base."""
CENTRAL = 0.5
"""Rims are averaged up to this share of the mouth's half width from its middle."""
_POINTS = ("mouth_corner_left", "mouth_corner_right", "chin", "nose_base")


class HeadLips(nn.Module):
    """Curves to lip measures of one head.

    Parameters
    ----------
    head : Head
        An embedded head.
    more : sequence of int
        Vertices of its skin that `points` moves too.

    Attributes
    ----------
    eye_distance : float
        Between the outer corners of the eyes, cm.
    """

    gains: Tensor
    shapes: Tensor
    neutral: Tensor
    share: Tensor
    seals: Tensor
    zips: Tensor
    central: Tensor
    rest: Tensor

    def __init__(self, head: Head, more: Sequence[int] = ()) -> None:
        super().__init__()
        arrays, facts = head_arrays(head)
        marks = head_landmarks(head)
        rim = int(facts["sealRim"])
        self.n_pairs = arrays["seal.upper"].shape[1]
        points = [*arrays["seal.upper"][rim], *arrays["seal.lower"][rim]]
        points += [*(marks[name] for name in _POINTS), *more]
        self._inputs = {name: k for k, name in enumerate(facts["inputs"])}
        gains = np.zeros((2 * len(facts["controls"]), len(self._inputs)))
        gains[arrays["bind.control"], arrays["bind.input"]] = arrays["bind.gain"]
        self._keep("gains", gains)
        self._keep("shapes", self._point_shapes(arrays, facts, np.array(points)))
        self._keep("rest", facts["rest"])
        self._keep("neutral", head.skin.vertices[points])
        self._keep("share", arrays["jaw.weight"][points])
        along = arrays["seal.u"]
        self._keep("seals", self._seal_gains(along, arrays["seal.left"]))
        self._keep("zips", np.stack([arrays["seal.left"], 1 - arrays["seal.left"], np.abs(along)]))
        central = np.abs(along) <= CENTRAL
        self._keep("central", central / central.sum())
        self._hinge, self._slide = tuple(facts["hinge"]), tuple(facts["slide"])
        self._radians = float(np.radians(facts["openDegrees"]))
        eyes = head.skin.vertices[[marks["eye_outer_left"], marks["eye_outer_right"]]]
        self.eye_distance = float(np.linalg.norm(eyes[0] - eyes[1]))

    def _keep(self, name: str, values: NDArray[Any]) -> None:
        self.register_buffer(name, torch.from_numpy(np.asarray(values, np.float32)))

    def _point_shapes(
        self, arrays: dict[str, NDArray[Any]], facts: dict[str, Any], points: Int64
    ) -> Float64:
        """Displacements (K, 3 N) of the points by the inputs that are linear shapes."""
        start, place = arrays["shape.start"], {int(v): n for n, v in enumerate(points)}
        out = np.zeros((len(self._inputs), len(points), 3))
        for k, name in enumerate(facts["shapes"]):
            if name not in self._inputs:
                continue  # wrinkles and swallowing, away from the mouth
            for entry in range(start[k], start[k + 1]):
                vertex = int(arrays["shape.vertex"][entry])
                if vertex in place:
                    delta = arrays["shape.delta"][entry] * float(arrays["shape.scale"][k])
                    out[self._inputs[name], place[vertex]] = delta
        return out.reshape(len(out), -1)

    def _seal_gains(self, along: Float32, left: Float32) -> Float64:
        """Closing (2, K, P) of upper and lower lip by the inputs that seal linearly."""
        far = np.abs(along)
        spread = {
            "": np.ones_like(far),
            "inner": np.exp(-(((far - 0.45) / 0.28) ** 2)),
            "outer": smoothstep((far - 0.55) / 0.3),
        }
        out = np.zeros((2, len(self._inputs), len(far)))
        for i, lip in enumerate(("Upper", "Lower")):
            out[i, self._inputs[f"seal.center{lip}"]] = np.exp(-((far / 0.35) ** 2))
            for side, weight in (("L", left), ("R", 1 - left)):
                for kind, shape in spread.items():
                    name = f"seal.{kind}{lip}_{side}" if kind else f"seal.{lip.lower()}_{side}"
                    out[i, self._inputs[name]] = weight * shape
        return out

    def forward(self, curves: Tensor) -> Tensor:
        """Measure curves.

        Parameters
        ----------
        curves : Tensor [shape=(..., C)]
            Values of the default controls.

        Returns
        -------
        Tensor [shape=(..., M), cm]
            `MEASURES`.
        """
        upper, lower, others = self.points(self.inputs(curves))
        left, right, chin, nose = others.unbind(-2)
        upper = (upper * self.central[:, None]).sum(-2)
        lower = (lower * self.central[:, None]).sum(-2)
        measures = (
            (upper - lower)[..., 1],
            _distance(chin, nose),
            _distance(left, right),
            (nose - upper)[..., 1],
            (nose - lower)[..., 1],
            (nose - (left + right) / 2)[..., 1],
        )
        return torch.stack(measures, dim=-1)

    def inputs(self, curves: Tensor) -> Tensor:
        """Inputs of the head [shape=(..., K)]; arguments as `forward`."""
        both = torch.cat((curves.clamp(min=0), (-curves).clamp(min=0)), dim=-1)
        return both @ self.gains

    def points(self, inputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Upper and lower rim (..., P, 3), and corners, chin, nose base and `more` (..., N, 3)."""
        moved = self.neutral + (inputs @ self.shapes).reshape(*inputs.shape[:-1], -1, 3)
        moved = self._open(moved, inputs)
        upper, lower = moved[..., : self.n_pairs, :], moved[..., self.n_pairs : 2 * self.n_pairs, :]
        return *self._seal(upper, lower, inputs), moved[..., 2 * self.n_pairs :, :]

    def displacements(self, curves: Tensor) -> Tensor:
        """Measures less those of the face at rest [shape=(..., M), cm]; arguments as `forward`."""
        measures: Tensor = self(curves) - self(self.rest)
        return measures

    def _open(self, points: Tensor, inputs: Tensor) -> Tensor:
        """Rotate and slide the points (..., N, 3) with the jaw (`rig.face.motion.rigid`)."""
        opening = inputs[..., self._inputs["jaw.open"]].clamp(0, 1.35).unsqueeze(-1)
        angle = self._radians * opening * self.share
        hinge = points.new_tensor(self._hinge)
        x, y, z = (points - hinge).unbind(-1)
        cos, sin = angle.cos(), angle.sin()
        turned = torch.stack((x, cos * y - sin * z, sin * y + cos * z), dim=-1) + hinge
        back, side, forward = self._slide
        aside = side * inputs[..., self._inputs["jaw.left"]]
        ahead = forward * inputs[..., self._inputs["jaw.forward"]] + back * opening.squeeze(-1)
        slide = torch.stack((aside, torch.zeros_like(aside), ahead), dim=-1)
        return turned + slide.unsqueeze(-2) * self.share[:, None]

    def _seal(self, upper: Tensor, lower: Tensor, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Bring the rims (..., P, 3) together (`rig.face.motion.rigid.Seal`)."""
        left, right, far = self.zips
        zipped = torch.zeros_like(upper[..., 0])
        for side, name in ((left, "seal.zip_L"), (right, "seal.zip_R")):
            ramp = ((inputs[..., self._inputs[name], None] * 1.25 - 1 + far) / 0.25).clamp(0, 1)
            zipped = zipped + side * ramp * ramp * (3 - 2 * ramp)
        part_u = UPPER_PART * (inputs @ self.seals[0] + zipped).clamp(0, 1)
        part_l = (1 - UPPER_PART) * (inputs @ self.seals[1] + zipped).clamp(0, 1)
        gap = lower - upper
        rest = gap[..., 1].clamp(min=0) * (1 - part_u - part_l) / 2
        rise = torch.stack((torch.zeros_like(rest), rest, torch.zeros_like(rest)), dim=-1)
        return upper + gap * part_u[..., None] + rise, lower - gap * part_l[..., None] - rise


def _distance(a: Tensor, b: Tensor) -> Tensor:
    return (a - b).square().sum(-1).clamp(min=1e-12).sqrt()
