"""What moves after the linear shapes: jaw, lids, tongue, and lips that meet teeth or lips."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rig.arrays import Float64, Int64
from rig.face.geometry import details, topology
from rig.face.geometry.mesh import smoothstep
from rig.face.geometry.skin import LID_SHARE, Skin
from rig.face.geometry.topology import EYE_L, EYE_R, FILLER, MOUTH

if TYPE_CHECKING:
    from rig.face.motion.shapes import ShapeMaker

# The lower jaw: a rotation about a hinge in front of the ears, then a slide.


OPEN_DEGREES = 19.0
HINGE = np.array([0.0, -2.6, 0.6])
_SLIDE_OPEN, _SIDE, _FORWARD = -0.25, 0.60, 0.60
Inputs = dict[str, Float64]


class Jaw:
    """Rotates skin, lower teeth and tongue with the jaw."""

    def __init__(self, skin: Skin, weights: Float64) -> None:
        self.skin_weights = weights

    @staticmethod
    def weights(maker: "ShapeMaker") -> Float64:
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


_MEET = 0.16
"""Where closed lids meet, as a share of the way from the lower to the upper rim."""
WIDEN, UPPER_UP, LOOK_UP = 0.24, 0.20, 0.28
"""Turn of the upper lid's rim by each full input, radians."""


@dataclass(frozen=True)
class _Eye:
    ids: Int64
    slot: Int64
    share: Float64
    center: Float64
    rim: Int64
    upper: Float64
    arch: Float64


class Lids:
    """Poses both eyes' lids; `turn` after a call holds each rim vertex's angle."""

    def __init__(self, skin: Skin) -> None:
        self._least = skin.anatomy.eye_radius + 0.012
        t = topology.angles(topology.EYE_COUNT)
        self._opposite = (topology.EYE_COUNT - np.arange(topology.EYE_COUNT)) % topology.EYE_COUNT
        self._eyes = {}
        for name, kind, side in (("L", EYE_L, 1), ("R", EYE_R, -1)):
            ids = np.flatnonzero(skin.kind == kind)
            ring = skin.ring[ids]
            share = np.where(ring < 0, 1.0, LID_SHARE[np.maximum(ring, 0)])
            self._eyes[name] = _Eye(
                ids, skin.slot[ids], share, skin.anatomy.eye * [side, 1, 1], skin.loop(kind, 0),
                (np.sin(t) > 1e-6).astype(float), np.abs(np.sin(t)),
            )  # fmt: skip

    def pose(self, vertices: Float64, inputs: Inputs) -> dict[str, Float64]:
        """Turn the lids in place (T, V, 3); returns each rim's turn (T, EYE_COUNT), radians."""
        return {name: self._pose_eye(vertices, inputs, name) for name in self._eyes}

    def _pose_eye(self, vertices: Float64, inputs: Inputs, name: str) -> Float64:
        eye = self._eyes[name]
        rim = vertices[:, eye.rim] - eye.center
        angle = np.arctan2(rim[..., 1], rim[..., 2])
        turn = self._rim_turn(angle, eye, inputs, name)
        around = vertices[:, eye.ids] - eye.center
        by = turn[:, eye.slot] * eye.share
        cos, sin = np.cos(by), np.sin(by)
        y, z = around[..., 1].copy(), around[..., 2].copy()
        around[..., 1], around[..., 2] = cos * y + sin * z, cos * z - sin * y
        length = np.sqrt((around**2).sum(-1, keepdims=True))
        vertices[:, eye.ids] = eye.center + around * np.maximum(self._least / length, 1)
        return turn

    def _rim_turn(self, angle: Float64, eye: _Eye, inputs: Inputs, name: str) -> Float64:
        """Upward turn of every rim vertex; opposite rims meet and never cross."""
        opposite = angle[:, self._opposite]
        gap = np.where(eye.upper > 0, angle - opposite, opposite - angle)
        gap = np.maximum(gap, 0)
        close, raise_ = _lid_shares(inputs, name)
        widen, dip, ride = (angle[:, None] * eye.arch for angle in _lid_angles(inputs, name))
        close = close + 0.30 * np.clip(inputs[f"lid.frown_{name}"], 0, 1)[:, None] * _inner(eye)
        up = -(1 - _MEET) * np.clip(close, 0, 1) * gap + widen - ride
        room = 1 - (1 - _MEET) * np.clip(close, 0, 1)
        low = np.minimum(np.clip(np.maximum(raise_, _MEET * (close >= 1)), 0, 1), room) * gap
        low = low - dip * (1 - np.clip(close, 0, 1)) - ride
        turn = np.where(eye.upper > 0, up, low)
        return turn * (eye.arch > 1e-6)


def _inner(eye: _Eye) -> Float64:
    """1 towards the nose, 0 at the outer corner: where a frown presses the lid."""
    t = topology.angles(topology.EYE_COUNT)
    return np.asarray(0.5 - 0.5 * np.cos(t))


def _lid_shares(inputs: Inputs, name: str) -> tuple[Float64, Float64]:
    """Shares (T, 1) of the opening that the upper lid closes and the lower lid rises."""
    get = {k: inputs[f"lid.{k}_{name}"] for k in ("close", "upper", "lower", "lookDown")}
    blink = np.clip(get["close"], 0, 1)
    open_ = 1 - blink
    upper = blink + open_ * (
        0.85 * np.clip(get["upper"], 0, 1) + 0.60 * np.clip(get["lookDown"], 0, 1)
    )
    lower = open_ * np.clip(get["lower"], 0, 1) * 0.8 + blink * _MEET
    return upper[:, None], lower[:, None]


def _lid_angles(inputs: Inputs, name: str) -> tuple[Float64, Float64, Float64]:
    """Extra turns (T,), radians: upper lid up, lower lid down, and both down with the gaze."""
    get = {k: np.clip(inputs[f"lid.{k}_{name}"], 0, 1)
           for k in ("widen", "upperUp", "lowerDown", "lookUp", "lookDown", "close")}  # fmt: skip
    open_ = 1 - get["close"]
    widen = (WIDEN * get["widen"] + UPPER_UP * get["upperUp"] + LOOK_UP * get["lookUp"]) * open_
    dip = 0.06 * get["widen"] + 0.16 * get["lowerDown"]
    ride = 0.30 * get["lookDown"] - 0.10 * get["lookUp"] * open_
    return np.minimum(widen, 0.36), np.minimum(dip, 0.26), ride


# The tongue: bent by its controls, stopped by palate, teeth and lips.


SINK_CM = 0.50
"""How far the tongue lowers in the open jaw, so that the lower teeth stay in sight."""


class Tongue:
    """Poses the tongue's vertices.

    Parameters
    ----------
    rest : ndarray [shape=(n, 3)]
        The tongue at rest, cm.
    place : ndarray [shape=(n,)]
        0 at the tip, 1 at the root.
    mouth_y, lip_z : float
        Where the lips meet.
    """

    def __init__(self, rest: Float64, place: Float64, mouth_y: float, lip_z: float) -> None:
        self._rest, self._s = rest, place
        rows = rest.reshape(details.TONGUE_ROWS, details.TONGUE_COLUMNS, 3)
        self._axis = np.repeat(rows.mean(1), details.TONGUE_COLUMNS, 0)
        half = np.abs(rows[..., 0]).max(1)
        self._across = rest[:, 0] / np.repeat(half, details.TONGUE_COLUMNS)
        self._upper_edge = mouth_y + details.UPPER_EDGE
        self._lower_edge = mouth_y + details.LOWER_EDGE
        self._teeth_z = lip_z - details.UPPER_BACK
        self._behind_z = lip_z - details.LOWER_BACK - 0.29
        self.jaw_share = 0.70 + 0.27 * (1 - place)

    def shape(self, inputs: Inputs) -> Float64:
        """The tongue bent by its own controls (T, n, 3), before the jaw takes it along."""
        get = {k: inputs[f"tongue.{k}"][:, None] for k in (
            "in", "out", "up", "left", "press", "wide", "bend", "twist", "roll", "tipUp",
            "tipLeft", "thick")}  # fmt: skip
        s = self._s
        front, tip = np.clip(1 - s, 0, 1), np.clip(1 - s / 0.5, 0, 1) ** 1.5
        body = np.sin(np.pi * np.clip(0.12 + 0.8 * s, 0, 1))
        offset = self._rest - self._axis
        wide = 1 + 0.26 * get["wide"] * (1 - 0.5 * s)
        thick = 1 + 0.35 * get["thick"] - 0.12 * get["wide"]
        turn = np.radians(28) * get["twist"] * front
        x = offset[:, 0] * wide
        y = offset[:, 1] * thick
        dx, dy = x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)
        x = self._axis[:, 0] + dx + 0.85 * get["left"] * front**0.8 + 0.75 * get["tipLeft"] * tip
        lift = 0.95 * get["up"] * body + 0.80 * get["press"] * body + 1.35 * get["tipUp"] * tip
        lift = lift + 0.75 * get["bend"] * (tip - 0.35 * body) + 0.60 * get["out"] * front**0.6
        sunk = np.clip(inputs["jaw.open"], 0, 1)[:, None] * np.clip(
            1 - get["out"] - get["tipUp"], 0, 1
        )
        lift = lift - SINK_CM * sunk * front**0.5
        y = self._axis[:, 1] + dy + lift + 0.42 * get["roll"] * self._across**2 * front
        reach = 2.5 * get["out"] * front**0.9 - 1.3 * get["in"] * front
        reach = reach - 0.22 * get["tipUp"] * tip - 0.30 * get["bend"] * tip
        z = self._axis[:, 2] + offset[:, 2] + reach
        return np.stack(np.broadcast_arrays(x, y, z), -1)

    def settle(
        self, points: Float64, lower_edge: Float64, lip_low: Float64, lip_high: Float64
    ) -> Float64:
        """Keep the tongue (T, n, 3) under palate and upper teeth, over lower teeth and lip.

        `lower_edge`, `lip_low` and `lip_high` (T, 2) are y and z of the lower incisors' edge and
        of the lips' rims in the middle, in the pose at hand. Contact is exact: a tongue that
        would pass through touches instead, and one that has no room stays behind the teeth.
        """
        points = points.copy()
        edge_y = lower_edge[:, :1]
        shut = self._upper_edge - edge_y < 0.16
        points[..., 2] = np.where(shut, np.minimum(points[..., 2], self._behind_z), points[..., 2])
        z, x = points[..., 2], points[..., 0]
        behind = np.maximum(self._teeth_z - 0.30 - z, 0)
        vault = np.interp(behind, [0, 0.12, 0.5, 1.6, 3.5, 5.5], [0, 0.32, 0.85, 1.35, 1.4, 1.1])
        ceiling = self._upper_edge - 0.02 + vault * np.clip(1 - 0.18 * x**2, 0.3, 1)
        past = smoothstep((z - self._behind_z) / 0.2)
        floor = edge_y + 0.02 - 3.0 * (1 - past)
        outside = smoothstep((z - (lip_low[:, 1:] - 0.75)) / 0.5)
        floor = floor + np.maximum(lip_low[:, :1] + 0.02 - floor, 0) * outside
        outside_high = smoothstep((z - (lip_high[:, 1:] - 0.6)) / 0.4)
        ceiling = ceiling - np.maximum(ceiling - lip_high[:, :1] + 0.02, 0) * outside_high
        y = np.minimum(points[..., 1], ceiling)
        y = np.where(floor < ceiling, np.maximum(y, floor), np.where(past > 0.5, ceiling, y))
        points[..., 1] = y
        return points


# Lips against teeth and lips against lips: the non-linear end of a pose.
#
# First every lip vertex that would sink into a dental arch is moved out of it. Last, the seal:
# opposing vertices of the rims are brought together by the controls' share, and never pass
# through one another. Full closure is exact, whatever jaw, purse or smile do.


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
        is_lower = (skin.kind[self.ids] == MOUTH) & (slot > topology.MOUTH_COUNT // 2)
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
        half = topology.MOUTH_COUNT // 2
        upper = np.arange(1, half)
        rows = [skin.loop(MOUTH, int(r)) for r in _SEAL_RINGS]
        self._upper = np.stack([row[upper] for row in rows])
        self._lower = np.stack([row[topology.MOUTH_COUNT - upper] for row in rows])
        self._rim = int(np.flatnonzero(_SEAL_RINGS == 0)[0])
        self._share = _SEAL_SHARE[:, None]
        self._u = np.cos(upper / topology.MOUTH_COUNT * 2 * np.pi)
        left = smoothstep(0.5 + self._u * topology.MOUTH_HALF_WIDTH / 1.3)
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
