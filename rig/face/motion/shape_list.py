"""Linear shapes of mouth, face and neck, by input."""

from collections.abc import Callable
from typing import Any

import numpy as np

from rig.arrays import Float64
from rig.face.geometry.mesh import smoothstep
from rig.face.geometry.skin import Skin
from rig.face.geometry.topology import MOUTH
from rig.face.motion.shapes import LipPoints, Shape, ShapeMaker, Triple
from rig.files.reading import rows_of

POINTS, CREASES = rows_of("face/motion/points.csv"), rows_of("face/motion/creases.csv")
"""Where points of the face go, and where the skin folds, by shape: as `Shape` has them."""


def _shape(name: str, lips: Callable[[LipPoints], Triple] | None = None, **options: Any) -> Shape:
    """A shape with its rows of both tables."""
    points = [
        tuple(float(row[column]) for column in ("x", "y", "dx", "dy", "dz"))
        for row in POINTS
        if row["shape"] == name
    ]
    creases = [
        (_line(row["line"]), float(row["depth"]), float(row["half_width"]))
        for row in CREASES
        if row["shape"] == name
    ]
    return Shape(name, lips, tuple(points), tuple(creases), **options)


def _line(text: str) -> tuple[tuple[float, ...], ...]:
    """Points ``x y|x y``."""
    return tuple(tuple(map(float, point.split())) for point in text.split("|"))


def _towards(side: str) -> int:
    """Sign of the way from this lip to the other one."""
    return -1 if side == "U" else 1


def _share(p: LipPoints, side: str) -> Float64:
    """1 on the lip meant, 0 on the other."""
    return p.upper if side == "U" else p.lower


def _corner_pull(p: LipPoints) -> Triple:
    pull = (0.55 * p.u**2 + 0.45 * p.u**3) * p.rings(r0=1, r2=1, r5=0.78, r7=0.6)
    dy = 0.80 * pull - 0.07 * p.bell
    thin = p.rings(m1=0.0, r0=0.0, r2=-0.10, r4=-0.06, r5=0.0) * p.bell
    return 0.66 * pull, dy + thin * (p.upper - p.lower), -0.50 * pull - 0.16 * p.bell


def _sharp_corner_pull(p: LipPoints) -> Triple:
    sharp = p.u**4
    return 0.50 * sharp, 0.85 * sharp, -0.40 * sharp


def _stretch(p: LipPoints) -> Triple:
    dy = -0.20 * p.corner - 0.05 * p.bell * p.upper + 0.04 * p.bell * p.lower
    return 0.78 * p.corner, dy, -0.46 * p.corner - 0.12 * p.bell


def _dimple(p: LipPoints) -> Triple:
    return 0.34 * p.corner, 0.06 * p.corner, -0.42 * p.corner - 0.05 * p.bell


def _corner_depress(p: LipPoints) -> Triple:
    return 0.10 * p.corner, -0.74 * p.corner + 0.03 * p.bell, -0.14 * p.corner


def _upper_lip_raise(p: LipPoints) -> Triple:
    lift = (1 - p.u**3) * p.upper
    return 0.06 * p.u * p.upper, 0.56 * lift, 0.12 * p.bell * p.upper * p.rings(r0=1, r4=0.3)


def _lower_lip_depress(p: LipPoints) -> Triple:
    drop = (1 - p.u**3) * p.lower
    return 0.10 * p.corner * p.lower, -0.62 * drop, 0.04 * p.bell * p.lower


def _funnel(side: str) -> Shape:
    def lips(p: LipPoints) -> Triple:
        m, s = _share(p, side), _towards(side)
        open_ = (0.24 if side == "U" else 0.40) * p.bell ** (0.6 if side == "U" else 0.5)
        if side == "U":
            open_ = open_ * p.rings(m1=1, r0=1, r2=0.95, r4=0.35, r6=0.08)
        else:  # the red gets lower towards its middle, which rounds the outline
            open_ = open_ * p.rings(m1=1, r0=1, r2=0.80, r3=0.62, r4=0.20, r6=0.05)
        out = (0.40 + 0.36 * p.bell) if side == "U" else (0.44 + 0.42 * p.bell)
        flare = p.rings(m1=0.74, r0=0.96, r2=1.02, r3=0.96, r5=0.64, r6=0.46)
        return -0.72 * p.u * m, -s * open_ * m, out * flare * m

    return _shape(f"funnel{side}", lips, reach=6)


def _purse(side: str) -> Shape:
    def lips(p: LipPoints) -> Triple:
        m, s = _share(p, side), _towards(side)
        close = (0.20 if side == "U" else 0.06) * p.bell**0.6  # the upper lip covers its teeth
        close = close * p.rings(m1=1, r0=1, r2=0.45, r3=0.15, r5=0)
        bunch = 0.0 if side == "U" else 0.30  # the red of the lower lip gathers to a round
        close = close + bunch * p.bell * p.rings(m1=0, r0=0, r2=0.5, r3=0.9, r4=1, r5=0.8, r6=0.3)
        out = (0.46 + 0.50 * p.bell) if side == "U" else (0.50 + 0.56 * p.bell)
        far = 0.26 if side == "U" else 0.42  # the nose is near
        curl = p.rings(m1=0.80, r0=0.98, r1=1.06, r2=1.02, r3=0.90, r5=0.25 + far, r6=0.05 + far)
        return -1.28 * p.u * p.rings(r0=1, r4=1, r6=0.72) * m, s * close * m, out * curl * m

    return _shape(f"purse{side}", lips, reach=6)


def _roll(side: str, *, is_in: bool) -> Shape:
    def lips(p: LipPoints) -> Triple:
        m, s, bell = _share(p, side), _towards(side), p.bell**0.5
        if is_in:
            dy = s * 0.14 * bell * p.rings(m1=0.0, r0=0.25, r2=1.7, r4=0.9, r5=0.4)
            return 0.0, dy * m, -0.42 * bell * p.rings(m1=1, r1=1, r3=0.7, r5=0.2) * m
        dy = -s * 0.13 * bell * p.rings(m1=1.3, r0=1.2, r2=1.0, r4=0.3, r5=0.1)
        return 0.0, dy * m, 0.24 * bell * p.rings(m1=1.0, r0=1.1, r2=0.6, r5=0.1) * m

    return _shape(f"roll{'In' if is_in else 'Out'}{side}", lips)


def _bite(side: str) -> Shape:
    def lips(p: LipPoints) -> Triple:
        m, s, bell = _share(p, side), _towards(side), p.bell**0.6
        dy = s * bell * p.rings(m1=-0.06, r0=0.02, r1=0.20, r2=0.34, r3=0.38, r4=0.30, r5=0.16)
        dz = -bell * p.rings(m1=0.56, r0=0.55, r1=0.50, r2=0.36, r3=0.26, r5=0.1)
        return -0.03 * p.u * m, dy * m, dz * m

    return _shape(f"bite{side}", lips)


def _press(side: str) -> Shape:
    def lips(p: LipPoints) -> Triple:
        m, s, bell = _share(p, side), _towards(side), p.bell**0.5
        dy = s * 0.12 * bell * p.rings(m1=0, r0=0.05, r2=1.2, r4=0.7, r5=0.3)
        return 0.04 * p.corner * m, dy * m, -0.15 * bell * m

    return _shape(f"press{side}", lips)


def _tighten(side: str) -> Shape:
    def lips(p: LipPoints) -> Triple:
        m, s, bell = _share(p, side), _towards(side), p.bell**0.5
        dy = s * 0.11 * bell * p.rings(m1=0, r0=0.0, r2=1.1, r4=0.5, r5=0.2)
        return -0.24 * p.u * m, dy * m, -0.06 * bell * m

    return _shape(f"tighten{side}", lips)


def _towards_other(side: str) -> Shape:
    def lips(p: LipPoints) -> Triple:
        m, s = _share(p, side), _towards(side)
        return 0.0, s * 0.22 * p.bell**0.6 * p.rings(r0=1, r5=0.5) * m, 0.03 * p.bell * m

    return _shape(f"towards{side}", lips)


def _towards_teeth(side: str) -> Shape:
    def lips(p: LipPoints) -> Triple:
        m = _share(p, side)
        return 0.0, 0.0, -0.28 * p.bell**0.5 * p.rings(r0=1, r5=0.5) * m

    return _shape(f"towardsTeeth{side}", lips)


def _push(side: str) -> Shape:
    def lips(p: LipPoints) -> Triple:
        m = _share(p, side)
        return -0.12 * p.u * m, 0.0, (0.12 + 0.30 * p.bell) * p.rings(r0=1, r5=0.6) * m

    return _shape(f"push{side}", lips)


def _thick(side: str) -> Shape:
    """The red of the lip grows outwards (the negative of it makes the lip thin)."""

    def lips(p: LipPoints) -> Triple:
        m, s, bell = _share(p, side), _towards(side), p.bell**0.5
        grow = p.rings(m1=0, r0=0, r1=0.5, r2=1.0, r3=0.9, r5=0.2) * bell
        return 0.0, -s * 0.16 * grow * m, 0.12 * grow * m

    return _shape(f"thick{side}", lips)


def _thick_inward(side: str) -> Shape:
    """The wet side of the lip grows towards the other lip."""

    def lips(p: LipPoints) -> Triple:
        m, s, bell = _share(p, side), _towards(side), p.bell**0.5
        grow = p.rings(m1=1, r0=1.0, r1=0.6, r2=0.2, r3=0) * bell
        return 0.0, s * 0.13 * grow * m, 0.05 * grow * m

    return _shape(f"thickInward{side}", lips)


def _corner_sharp(side: str) -> Shape:
    """The lip reaches the corner as a thin point (its negative rounds the corner)."""

    def lips(p: LipPoints) -> Triple:
        m, s = _share(p, side), _towards(side)
        near = 4 * p.u**6 * (1 - p.u**4)
        return 0.05 * p.u**8 * m, s * 0.14 * near * p.rings(m1=1, r0=1, r3=0.8, r5=0) * m, 0.0

    return _shape(f"cornerSharp{side}", lips)


def _lips_blow(p: LipPoints) -> Triple:
    dy = 0.10 * p.bell * (p.upper - p.lower) * p.rings(r0=0, r3=1, r5=1)
    return -0.05 * p.u, dy, 0.34 * p.bell**0.6 * p.rings(m1=0.8, r0=0.8, r3=1.0, r5=0.9)


PAIRED = (
    _funnel, _purse, _bite, _press, _tighten, _towards_other, _towards_teeth, _push, _thick,
    _thick_inward, _corner_sharp,
)  # fmt: skip
"""Shapes of the upper and of the lower lip."""

MOUTH_SHAPES = (
    _shape("cornerPull", _corner_pull),
    _shape("sharpCornerPull", _sharp_corner_pull),
    _shape("stretch", _stretch),
    _shape("dimple", _dimple),
    _shape("cornerDepress", _corner_depress),
    _shape("upperLipRaise", _upper_lip_raise),
    _shape("lowerLipDepress", _lower_lip_depress),
    *(make(side) for make in PAIRED for side in "UD"),
    *(_roll(side, is_in=is_in) for side in "UD" for is_in in (True, False)),
    _shape("cornerUp", lambda p: (0.0, 0.52 * p.corner, 0.0)),
    _shape("cornerWide", lambda p: (0.45 * p.corner, 0.0, -0.22 * p.corner)),
    _shape("mouthUp", lambda p: (0.0, 0.42, 0.06 * p.bell), is_split=False),
    _shape("mouthDown", lambda p: (0.0, -0.42, 0.0), is_split=False),
    _shape("chinRaiseU", lambda p: (0.0, 0.20 * p.bell * p.upper, 0.08 * p.bell * p.upper)),
    _shape(
        "chinRaiseD", lambda p: (0.0, (0.10 + 0.24 * p.bell) * p.lower, 0.24 * p.bell * p.lower)
    ),
    _shape("chinCompress", lambda p: (0.0, 0.08 * p.bell * p.lower, 0.04 * p.bell * p.lower)),
    _shape("cheekBlow", lambda p: (0.05 * p.u, 0.0, 0.05 * p.bell)),
    _shape("cheekSuck", lambda p: (-0.08 * p.u, 0.0, 0.0)),
    _shape("lipsBlow", _lips_blow),
)
"""Every lip shape that is symmetric; sideways ones are in `side_shapes`."""

# Shapes of brows, nose, cheeks, eyes' surroundings and neck (cm at full strength, left side).

FACE_SHAPES = (
    *map(_shape, ("browDown", "browLateral", "browRaiseIn", "browRaiseOut", "squintInner")),
    *map(_shape, ("cheekRaise", "scrunch", "lidPress")),
    _shape("noseWrinkle", lambda p: (0.0, 0.15 * p.bell * p.upper, 0.0)),
    _shape("noseWrinkleUpper"),
    _shape("nostrilDepress", lambda p: (0.0, 0.0, 0.0)),
    _shape("nostrilDilate", lambda p: (0.0, 0.0, 0.0)),
    _shape("nasolabialDeepen", lambda p: (0.0, 0.03 * p.bell * p.upper, 0.0)),
    _shape("jawClench"),
)
"""Shapes outside the lips."""


# Shapes that do not come from the thin plate's left half: sideways lips and the neck.

_LARYNX_Y = -13.0


def side_shapes(maker: ShapeMaker) -> dict[str, Float64]:
    """Mouth, upper lip and lower lip moved to the character's left by half a centimetre or so."""
    skin = maker.skin
    lips = (skin.kind == MOUTH) & (skin.ring <= 5)
    points = maker.lip_points(lips)
    fade = np.interp(-points.ring, [1, 3, 5], [1, 0.5, 0])
    share = {"mouthSide": np.ones(lips.sum()), "lipShiftU": points.upper, "lipShiftD": points.lower}
    reach = {"mouthSide": 0.75, "lipShiftU": 0.42, "lipShiftD": 0.42}
    fixed, shapes = maker.still | maker.lid | maker.nose | lips, {}
    for name, weight in share.items():
        values = np.zeros((len(skin.vertices), 3))
        values[lips, 0] = reach[name] * weight * fade
        whole = maker.plate.spread(fixed, values)
        shapes[name] = 0.5 * (whole + whole[skin.mirror] * [1, -1, -1])
    return shapes


def _near_line(skin: Skin, a: tuple[float, ...], b: tuple[float, ...], width: float) -> Float64:
    """1 on the segment a-b (left half, mirrored), falling to 0 over `width` cm."""
    p = skin.vertices
    start, axis = np.array(a), np.array(b) - np.array(a)
    h = np.clip(((p - start) @ axis) / (axis @ axis), 0, 1)
    distance = np.linalg.norm(p - start - h[:, None] * axis, axis=1)
    return np.asarray(np.exp(-((distance / width) ** 2)))


def neck_shapes(maker: ShapeMaker) -> dict[str, Float64]:
    """Cords, larynx and the floor of the mouth."""
    skin, normals = maker.skin, maker.normals
    y, z = skin.vertices[:, 1], skin.vertices[:, 2]
    keep = smoothstep((y + 15.5) / 1.2)[:, None]
    shapes = {}
    for suffix, side in (("L", 1), ("R", -1)):
        mastoid = _near_line(skin, (4.9 * side, -7.5, -2.0), (1.3 * side, -15.6, 2.0), 0.8)
        x = skin.vertices[:, 0] * side
        cords = np.exp(-(((x - 1.4) / 0.45) ** 2)) + np.exp(-(((x - 3.0) / 0.5) ** 2))
        cords = cords * (z > -1) * smoothstep((-11.3 - y) / 1.2)
        shapes[f"mastoid_{suffix}"] = 0.42 * mastoid[:, None] * normals * keep
        shapes[f"neckStretch_{suffix}"] = 0.45 * cords[:, None] * normals * keep
    front = np.where(z > 0, 1.0, 0.0)
    lump = front * np.exp(-((skin.vertices[:, 0] / 1.1) ** 2 + ((y - _LARYNX_Y) / 1.3) ** 2))
    lump_above = front * np.exp(
        -((skin.vertices[:, 0] / 1.1) ** 2 + ((y - _LARYNX_Y - 1.4) / 1.1) ** 2)
    )
    forward = np.array([0.0, 0.1, 1.0])
    rise = (0.55 * lump_above - 0.30 * lump)[:, None] * forward
    shapes["larynxUp"] = (rise + 0.5 * lump[:, None] * np.array([0, 1.0, 0])) * keep
    shapes["throatOut"] = 0.40 * lump[:, None] * normals * keep
    floor = np.exp(-((skin.vertices[:, 0] / 2.2) ** 2 + ((z - 4.2) / 1.6) ** 2)) * (y < -9.8)
    floor = floor * smoothstep((y + 14) / 2)
    shapes["floorDown"] = floor[:, None] * np.array([0, -0.5, 0.1])
    return shapes
