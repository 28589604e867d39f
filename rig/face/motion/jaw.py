"""The lower jaw: a rotation about a hinge in front of the ears, then a slide."""

import numpy as np

from rig.arrays import Float64
from rig.face.geometry.skin import Skin
from rig.face.geometry.topology import EYE_L, FILLER, MOUTH
from rig.face.motion.shapes import ShapeMaker

OPEN_DEGREES = 19.0
HINGE = np.array([0.0, -2.6, 0.6])
_SLIDE_OPEN, _SIDE, _FORWARD = -0.25, 0.60, 0.60
Inputs = dict[str, Float64]


class Jaw:
    """Rotates skin, lower teeth and tongue with the jaw."""

    def __init__(self, skin: Skin, weights: Float64) -> None:
        self.skin_weights = weights

    @staticmethod
    def weights(maker: ShapeMaker) -> Float64:
        """Weight (V,) of the jaw's motion at each skin vertex, 0..1.

        A thin plate between the skull (0) and the chin (1). On the lips the weights follow
        0.4 +- 0.6 sqrt(1 - u**2), which opens the mouth as an ellipse.
        """
        skin, v = maker.skin, maker.skin.vertices
        lips = (skin.kind == MOUTH) & (skin.ring >= -3) & (skin.ring <= 3)
        filler = skin.kind == FILLER
        chin_y = v[(v[:, 2] > 6) & filler][:, 1].min() + 1.2
        chin = filler & (np.hypot(v[:, 0], v[:, 1] - chin_y) < 1.7) & (v[:, 2] > 4.8)
        x, y, z = np.abs(v[:, 0]), v[:, 1], v[:, 2]
        skull = maker.still | (skin.kind >= EYE_L)
        skull |= filler & (
            ((y > -5.3) & (x < 3.2) & (z > 4)) | (y > -2.6) | ((y < -10) & (z < 2.6))
        )
        t = maker.lip_points(lips)
        skull &= ~chin & ~lips
        fixed = chin | skull | lips
        value = chin.astype(float)
        arch = np.sqrt(np.clip(1 - t.u**2, 0, 1))
        is_upper = t.upper >= 0.5
        value[lips] = 0.4 + np.where(is_upper, -0.4, 0.6) * arch
        bag = (skin.kind == MOUTH) & (skin.ring <= -9)
        fixed, value = fixed | bag, np.where(bag, 0.35, value)
        spread = maker.plate.spread(fixed, value[:, None])[:, 0]
        spread = 0.5 * (spread + spread[skin.mirror])
        return np.asarray(np.clip(spread, 0, 1))

    def pose(self, skin: Float64, inputs: Inputs) -> None:
        """Open the jaw in place on skin vertices (T, V, 3)."""
        moving = np.flatnonzero(self.skin_weights > 1e-4)
        skin[:, moving] = self.ride(skin[:, moving], inputs, self.skin_weights[moving])

    def ride(self, points: Float64, inputs: Inputs, share: Float64 | float = 1.0) -> Float64:
        """Points (T, n, 3) taken along by the jaw, each by its share of angle and slide."""
        angle, slide = self._motion(inputs)
        return np.asarray(_turned(points, angle * share) + slide * np.asarray(share)[..., None])

    def undo(self, points: Float64, inputs: Inputs) -> Float64:
        """Points (T, n, 3) of the world in the jaw's frame (the inverse of a full `ride`)."""
        angle, slide = self._motion(inputs)
        return _turned(points - slide, -angle)

    def _motion(self, inputs: Inputs) -> tuple[Float64, Float64]:
        open_ = np.clip(inputs["jaw.open"], 0, 1.35)
        zero = np.zeros_like(open_)
        slide = np.stack(
            [_SIDE * inputs["jaw.left"], zero,
             _FORWARD * inputs["jaw.forward"] + _SLIDE_OPEN * open_], -1
        )  # fmt: skip
        return np.radians(OPEN_DEGREES) * open_[:, None], slide[:, None]


def _turned(points: Float64, angle: Float64) -> Float64:
    """Rotate points (T, n, 3) downwards about the hinge's x axis by `angle` (T, n) or (T, 1)."""
    q = points - HINGE
    cos, sin = np.cos(angle), np.sin(angle)
    y, z = cos * q[..., 1] - sin * q[..., 2], sin * q[..., 1] + cos * q[..., 2]
    return np.asarray(np.stack(np.broadcast_arrays(q[..., 0], y, z), -1) + HINGE)
