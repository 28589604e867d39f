"""Lips against teeth and lips against lips: the non-linear end of a pose.

First every lip vertex that would sink into a dental arch is moved out of it. Last, the seal:
opposing vertices of the rims are brought together by the controls' share, and never pass
through one another. Full closure is exact, whatever jaw, purse or smile do.
"""

import numpy as np

from rig.arrays import Float64
from rig.face.geometry import loops
from rig.face.geometry.mesh import smoothstep
from rig.face.geometry.skin import Skin
from rig.face.geometry.topology import FILLER, MOUTH

Inputs = dict[str, Float64]
_SEAL_RINGS = np.arange(-2, 10)
_SEAL_SHARE = np.array([0.75, 1.0, 1.0, 0.93, 0.80, 0.62, 0.42, 0.27, 0.17, 0.10, 0.05, 0.02])
UPPER_PART = 0.38
"""The upper lip covers this share of the gap, the lower lip the rest."""
_TUCK = 0.13
"""How much closer than elsewhere the lower lip's rim comes to the upper teeth, cm."""


class Arch:
    """One dental arch as an elliptic cylinder that keeps flesh outside.

    Parameters
    ----------
    width, depth, center_z : float
        Half axes and centre of the teeth's middle line, cm.
    edge_y : float
        Height of the biting edge.
    up : int
        1 where the teeth stand above their edge, -1 below.
    """

    def __init__(self, skin: Skin, width: float, depth: float, center_z: float, edge_y: float,
                 up: int) -> None:  # fmt: skip
        v, ring = skin.vertices, skin.ring
        near = (np.abs(v[:, 1] - skin.anatomy.mouth_y) < 3.2) & (v[:, 2] > 4.0)
        lips = (skin.kind == MOUTH) & (ring >= -2)
        self.ids = np.flatnonzero(lips | ((skin.kind == FILLER) & near))
        is_lip = skin.kind[self.ids] == MOUTH
        flesh = np.where(is_lip, np.interp(ring[self.ids], [-2, 0, 2, 9], [0, 0, 0.12, 0.35]), 0.35)
        clearance = 0.30 + flesh - (_TUCK * self._is_under(skin) if up > 0 else 0)
        self._axes = width + clearance, depth + clearance
        self._center_z, self._edge_y, self._up = center_z, edge_y, up
        self._least = np.minimum(self._ratio(v[self.ids]), 1.0)

    def _is_under(self, skin: Skin) -> Float64:
        """1 at the rim of the lower lip, which F tucks under the upper teeth; 0 past its red."""
        ring, slot = skin.ring[self.ids], skin.slot[self.ids]
        is_lower = (skin.kind[self.ids] == MOUTH) & (slot > loops.MOUTH_COUNT // 2)
        return np.asarray(is_lower * np.interp(ring, [-2, 0, 2, 4], [1, 1, 0.6, 0]))

    def _ratio(self, points: Float64) -> Float64:
        a, b = self._axes
        z = points[..., 2] - self._center_z
        return np.asarray(np.sqrt((points[..., 0] / a) ** 2 + (np.maximum(z, 0) / b) ** 2 + 1e-9))

    def push(self, points: Float64) -> Float64:
        """Displacement (T, n, 3) that brings `points` (at `ids`) in front of the teeth."""
        grow = np.maximum(self._least / self._ratio(points) - 1, 0)
        beyond = self._up * (points[..., 1] - self._edge_y)
        grow = grow * smoothstep((beyond + 0.40) / 0.40) * (points[..., 2] > self._center_z)
        out = np.zeros_like(points)
        out[..., 0] = points[..., 0] * grow
        out[..., 2] = (points[..., 2] - self._center_z) * grow
        return out


class Seal:
    """Brings the rims of the lips together."""

    def __init__(self, skin: Skin) -> None:
        half = loops.MOUTH_COUNT // 2
        upper = np.arange(1, half)
        rows = [skin.loop(MOUTH, int(r)) for r in _SEAL_RINGS]
        self._upper = np.stack([row[upper] for row in rows])
        self._lower = np.stack([row[loops.MOUTH_COUNT - upper] for row in rows])
        self._rim = int(np.flatnonzero(_SEAL_RINGS == 0)[0])
        self._share = _SEAL_SHARE[:, None]
        self._u = np.cos(upper / loops.MOUTH_COUNT * 2 * np.pi)
        left = smoothstep(0.5 + self._u * loops.MOUTH_HALF_WIDTH / 1.3)
        self._sides = {"L": left, "R": 1 - left}

    def amounts(self, inputs: Inputs) -> tuple[Float64, Float64]:
        """Shares (T, n) of their part of the gap that upper and lower lip move, 0..1."""
        far = np.abs(self._u)
        center, inner = np.exp(-((far / 0.35) ** 2)), np.exp(-(((far - 0.45) / 0.28) ** 2))
        outer = smoothstep((far - 0.55) / 0.3)
        total = []
        for lip in ("Upper", "Lower"):
            amount = inputs[f"seal.center{lip}"][:, None] * center
            for s, side in self._sides.items():
                amount = amount + side * (
                    inputs[f"seal.{lip.lower()}_{s}"][:, None]
                    + inputs[f"seal.inner{lip}_{s}"][:, None] * inner
                    + inputs[f"seal.outer{lip}_{s}"][:, None] * outer
                    + smoothstep((inputs[f"seal.zip_{s}"][:, None] * 1.25 - 1 + far) / 0.25)
                )
            total.append(np.clip(amount, 0, 1))
        return total[0], total[1]

    def pose(self, vertices: Float64, inputs: Inputs) -> None:
        """Close the lips in place (T, V, 3)."""
        amount_u, amount_l = self.amounts(inputs)
        gap = vertices[:, self._lower[self._rim]] - vertices[:, self._upper[self._rim]]
        crossed = np.maximum(gap[..., 1], 0)
        part_u, part_l = UPPER_PART * amount_u, (1 - UPPER_PART) * amount_l
        move_u, move_l = gap * part_u[..., None], gap * part_l[..., None]
        left_over = crossed * (1 - part_u - part_l)
        move_u[..., 1] += 0.5 * left_over
        move_l[..., 1] += 0.5 * left_over
        vertices[:, self._upper] += move_u[:, None] * self._share[..., None]
        vertices[:, self._lower] -= move_l[:, None] * self._share[..., None]
