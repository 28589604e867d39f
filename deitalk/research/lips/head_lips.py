"""Lip measures of an embedded head as a differentiable function of the 185 curves.

The measures are those that video and articulographs take of people: opening, jaw, width, and the
heights of the lips and of the corners. Curves can be compared with measured lips and be fitted to
them.

The rims of the lips, the corners, the chin and the base of the nose move as in
`rig.face.head.Head.pose`: linear shapes, then the seal of the rims.

Letters: T frames, C controls, H halves of controls, K shapes, N points, P columns of the rims, M
measures.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from deitalk.postprocess.torch_columns import smoothstep
from rig.arrays import Float32, Int64
from rig.controls import default_controls
from rig.face.head import FINISH, UPPER_PART, Head

MEASURES = ("opening", "jaw", "width", "upper_lip", "lower_lip", "corner")
"""Mean gap of the rims, chin to nose base, distance of the corners; upper rim, lower rim and
corners below the nose base."""
CENTRAL = 0.5
"""Rims are averaged up to this share of the mouth's half width from its middle."""
Place = int | tuple[Int64, Float32]
_POINTS = ("mouth_corner_left", "mouth_corner_right", "chin", "nose_base")


class HeadLips(nn.Module):
    """Curves to lip measures of one head.

    Parameters
    ----------
    head : Head
        An embedded head.
    more : sequence of int or of (ids, weights)
        Vertices of its skin, or means of some, that `points` moves too.

    Attributes
    ----------
    eye_distance : float
        Between the outer corners of the eyes, cm.
    """

    rest: Tensor
    reach: Tensor
    drivers: Tensor
    peaks: Tensor
    shapes: Tensor
    neutral: Tensor
    seals: Tensor
    fade: Tensor
    central: Tensor

    def __init__(self, head: Head, more: Sequence[Place] = ()) -> None:
        super().__init__()
        motion, marks, controls = head.motion, head.landmarks, default_controls()
        mean = np.zeros((len(_POINTS) + len(more), head.slices["skin"].stop), np.float32)
        for row, place in zip(mean, (*(marks[name] for name in _POINTS), *more), strict=True):
            if isinstance(place, int):
                row[place] = 1
            else:
                np.add.at(row, *place)
        used = np.flatnonzero(mean.any(axis=0))
        mean = mean[:, used]
        dense = np.zeros((len(motion.names), len(head.straight), 3), np.float32)
        for k, shape in enumerate(dense):
            vertex, delta = motion.shape(k)
            shape[vertex] = delta

        def moved(values: NDArray[Any]) -> NDArray[Any]:
            """Columns of the upper and the lower rim, and points (..., 2 P + N, 3)."""
            rims = [lip.weight @ values[..., lip.rim, :] for lip in motion.lips]
            return np.concatenate([*rims, mean @ values[..., used, :]], axis=-2)

        shapes = moved(dense) * motion.gain[:, None, None]
        kept = np.flatnonzero(np.abs(shapes).max((1, 2)) > 1e-5)
        self.n_pairs = len(motion.fade)
        self._keep("rest", controls.rest)
        self._keep("reach", np.stack([controls.maximum, controls.minimum]) - controls.rest)
        self.register_buffer("drivers", torch.from_numpy(motion.drivers[kept].copy()))
        self._keep("peaks", motion.is_peak[kept])
        self._keep("shapes", shapes[kept].reshape(len(kept), -1))
        self._keep("neutral", moved(head.straight))
        parts = (UPPER_PART, 1 - UPPER_PART)
        self._keep("seals", np.stack([motion.bind @ profile for profile in motion.profiles]))
        self._parts = parts
        self._keep("fade", motion.fade)
        along = np.linspace(-1, 1, self.n_pairs)
        central = np.abs(along) <= CENTRAL
        self._keep("central", central / central.sum())
        eyes = head.skin.vertices[[marks["eye_outer_left"], marks["eye_outer_right"]]]
        self.eye_distance = float(np.linalg.norm(eyes[0] - eyes[1]))

    def _keep(self, name: str, values: NDArray[Any]) -> None:
        self.register_buffer(name, torch.from_numpy(np.array(values, np.float32)))

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
        upper, lower, others = self.points(curves)
        left, right, chin, nose = others[..., : len(_POINTS), :].unbind(-2)
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

    def halves(self, curves: Tensor) -> Tensor:
        """Travel of each half of each control [shape=(..., H)]; arguments as `forward`."""
        far = torch.where(self.reach == 0, torch.inf, self.reach)
        moved = (curves - self.rest).unsqueeze(-2) / far
        both = moved.clamp(0, 1).flatten(-2)
        return torch.cat((both, torch.ones_like(both[..., :1])), dim=-1)

    def points(self, curves: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Upper and lower rim (..., P, 3), and corners, chin, nose base and `more` (..., N, 3)."""
        halves = self.halves(curves)
        weights = halves[..., self.drivers].amin(-1).prod(-1)
        weights = torch.where(self.peaks > 0, 1 - (2 * weights - 1).abs(), weights)
        moved = self.neutral + (weights @ self.shapes).reshape(*weights.shape[:-1], -1, 3)
        upper, lower = moved[..., : self.n_pairs, :], moved[..., self.n_pairs : 2 * self.n_pairs, :]
        return *self._seal(upper, lower, halves), moved[..., 2 * self.n_pairs :, :]

    def displacements(self, curves: Tensor) -> Tensor:
        """Measures less those of the face at rest [shape=(..., M), cm]; arguments as `forward`."""
        measures: Tensor = self(curves) - self(self.rest)
        return measures

    def _seal(self, upper: Tensor, lower: Tensor, halves: Tensor) -> tuple[Tensor, Tensor]:
        """Bring the rims (..., P, 3) together (`rig.face.head.seal_lips`)."""
        sealed = [(halves @ seal).clamp(0, 1) for seal in self.seals]
        first, last = FINISH
        finished = [smoothstep((s - first) / (last - first)) for s in sealed]
        fade = self.fade[:, None]
        for amounts in (sealed, finished, [0 * s for s in sealed]):
            part_u, part_l = (part * s for part, s in zip(self._parts, amounts, strict=True))
            gap = upper - lower
            crossed = gap[..., 1].clamp(max=0) * (1 - part_u - part_l) / 2
            rise = torch.stack((0 * crossed, crossed, 0 * crossed), dim=-1)
            upper = upper - fade * (gap * part_u[..., None] + rise)
            lower = lower + fade * (gap * part_l[..., None] + rise)
        return upper, lower


def _distance(a: Tensor, b: Tensor) -> Tensor:
    return (a - b).square().sum(-1).clamp(min=1e-12).sqrt()
