"""Linear shapes of mouth, face and neck, by input."""

import numpy as np

from rig.arrays import Float64
from rig.face.geometry.mesh import smoothstep
from rig.face.geometry.skin import Skin
from rig.face.geometry.topology import MOUTH
from rig.face.motion.shapes import LipPoints, Shape, ShapeMaker, Triple

NASOLABIAL = ((1.62, -3.9), (2.15, -4.9), (2.9, -5.9), (3.45, -7.2), (3.5, -8.0))
"""The fold from the wing of the nose around the corner of the mouth (cheek on its left)."""


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

    chin = ((0, -10.4, 0, 0.09, -0.02),) if side == "D" else ()
    return Shape(f"funnel{side}", lips, chin, reach=6)


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

    chin = ((0, -10.4, 0, 0, -0.06),) if side == "D" else ()
    return Shape(f"purse{side}", lips, chin, reach=6)


def _roll(side: str, *, is_in: bool) -> Shape:
    def lips(p: LipPoints) -> Triple:
        m, s, bell = _share(p, side), _towards(side), p.bell**0.5
        if is_in:
            dy = s * 0.14 * bell * p.rings(m1=0.0, r0=0.25, r2=1.7, r4=0.9, r5=0.4)
            return 0.0 * p.u, dy * m, -0.42 * bell * p.rings(m1=1, r1=1, r3=0.7, r5=0.2) * m
        dy = -s * 0.13 * bell * p.rings(m1=1.3, r0=1.2, r2=1.0, r4=0.3, r5=0.1)
        return 0.0 * p.u, dy * m, 0.24 * bell * p.rings(m1=1.0, r0=1.1, r2=0.6, r5=0.1) * m

    return Shape(f"roll{'In' if is_in else 'Out'}{side}", lips)


def _bite(side: str) -> Shape:
    def lips(p: LipPoints) -> Triple:
        m, s, bell = _share(p, side), _towards(side), p.bell**0.6
        dy = s * bell * p.rings(m1=-0.06, r0=0.02, r1=0.20, r2=0.34, r3=0.38, r4=0.30, r5=0.16)
        dz = -bell * p.rings(m1=0.56, r0=0.55, r1=0.50, r2=0.36, r3=0.26, r5=0.1)
        return -0.03 * p.u * m, dy * m, dz * m

    return Shape(f"bite{side}", lips)


def _press(side: str) -> Shape:
    def lips(p: LipPoints) -> Triple:
        m, s, bell = _share(p, side), _towards(side), p.bell**0.5
        dy = s * 0.12 * bell * p.rings(m1=0, r0=0.05, r2=1.2, r4=0.7, r5=0.3)
        return 0.04 * p.corner * m, dy * m, -0.15 * bell * m

    return Shape(f"press{side}", lips)


def _tighten(side: str) -> Shape:
    def lips(p: LipPoints) -> Triple:
        m, s, bell = _share(p, side), _towards(side), p.bell**0.5
        dy = s * 0.11 * bell * p.rings(m1=0, r0=0.0, r2=1.1, r4=0.5, r5=0.2)
        return -0.24 * p.u * m, dy * m, -0.06 * bell * m

    return Shape(f"tighten{side}", lips)


def _towards_other(side: str) -> Shape:
    def lips(p: LipPoints) -> Triple:
        m, s = _share(p, side), _towards(side)
        return 0.0 * p.u, s * 0.22 * p.bell**0.6 * p.rings(r0=1, r5=0.5) * m, 0.03 * p.bell * m

    return Shape(f"towards{side}", lips)


def _towards_teeth(side: str) -> Shape:
    def lips(p: LipPoints) -> Triple:
        m = _share(p, side)
        return 0.0 * p.u, 0.0 * p.u, -0.28 * p.bell**0.5 * p.rings(r0=1, r5=0.5) * m

    return Shape(f"towardsTeeth{side}", lips)


def _push(side: str) -> Shape:
    def lips(p: LipPoints) -> Triple:
        m = _share(p, side)
        return -0.12 * p.u * m, 0.0 * p.u, (0.12 + 0.30 * p.bell) * p.rings(r0=1, r5=0.6) * m

    return Shape(f"push{side}", lips)


def _thick(side: str) -> Shape:
    """The red of the lip grows outwards (the negative of it makes the lip thin)."""

    def lips(p: LipPoints) -> Triple:
        m, s, bell = _share(p, side), _towards(side), p.bell**0.5
        grow = p.rings(m1=0, r0=0, r1=0.5, r2=1.0, r3=0.9, r5=0.2) * bell
        return 0.0 * p.u, -s * 0.16 * grow * m, 0.12 * grow * m

    return Shape(f"thick{side}", lips)


def _thick_inward(side: str) -> Shape:
    """The wet side of the lip grows towards the other lip."""

    def lips(p: LipPoints) -> Triple:
        m, s, bell = _share(p, side), _towards(side), p.bell**0.5
        grow = p.rings(m1=1, r0=1.0, r1=0.6, r2=0.2, r3=0) * bell
        return 0.0 * p.u, s * 0.13 * grow * m, 0.05 * grow * m

    return Shape(f"thickInward{side}", lips)


def _corner_sharp(side: str) -> Shape:
    """The lip reaches the corner as a thin point (its negative rounds the corner)."""

    def lips(p: LipPoints) -> Triple:
        m, s = _share(p, side), _towards(side)
        near = 4 * p.u**6 * (1 - p.u**4)
        return 0.05 * p.u**8 * m, s * 0.14 * near * p.rings(m1=1, r0=1, r3=0.8, r5=0) * m, 0.0 * p.u

    return Shape(f"cornerSharp{side}", lips)


PAIRED = tuple(
    make(side)
    for make in (
        _funnel,
        _purse,
        _bite,
        _press,
        _tighten,
        _towards_other,
        _towards_teeth,
        _push,
        _thick,
        _thick_inward,
        _corner_sharp,
    )
    for side in "UD"
)

MOUTH_SHAPES: tuple[Shape, ...] = (
    Shape(
        "cornerPull",
        _corner_pull,
        (
            (3.9, -2.9, 0.10, 0.55, 0.50),
            (2.7, -4.6, 0.30, 0.40, 0.34),
            (4.0, -4.5, 0.30, 0.42, 0.50),
            (4.3, -5.6, 0.42, 0.34, 0.30),
            (0, -10.4, 0, -0.24, -0.10),
        ),
        ((NASOLABIAL, 0.20, 0.40),),
    ),
    Shape(
        "sharpCornerPull",
        _sharp_corner_pull,
        (
            (3.9, -2.9, 0.06, 0.30, 0.14),
            (2.7, -4.6, 0.18, 0.34, 0.22),
            (4.2, -5.8, 0.30, 0.30, 0.12),
        ),
        ((NASOLABIAL[:4], 0.16, 0.40),),
    ),
    Shape("stretch", _stretch, ((4.1, -7.0, 0.36, -0.05, 0.0), (3.0, -9.6, 0.12, -0.14, 0.0))),
    Shape(
        "dimple",
        _dimple,
        ((4.0, -6.9, 0.20, 0.04, 0.12),),
        ((((3.25, -6.3), (3.42, -7.0), (3.3, -7.8)), 0.20, 0.24),),
    ),
    Shape(
        "cornerDepress",
        _corner_depress,
        ((1.7, -9.7, 0.04, -0.06, 0.10), (4.2, -6.0, 0.0, -0.16, -0.02)),
        ((((2.6, -8.9), (3.1, -8.2), (3.05, -7.4)), 0.08, 0.34),),
    ),
    Shape(
        "upperLipRaise",
        _upper_lip_raise,
        ((1.25, -4.4, 0.05, 0.14, 0.0), (2.3, -4.9, 0.08, 0.32, 0.16)),
        ((NASOLABIAL[:3], 0.10, 0.28),),
    ),
    Shape("lowerLipDepress", _lower_lip_depress, ((0, -10.1, 0, -0.06, 0),)),
    *PAIRED,
    *(_roll(side, is_in=is_in) for side in "UD" for is_in in (True, False)),
    Shape("cornerUp", lambda p: (0.0 * p.u, 0.52 * p.corner, 0.0 * p.u)),
    Shape("cornerWide", lambda p: (0.45 * p.corner, 0.0 * p.u, -0.22 * p.corner)),
    Shape(
        "mouthUp",
        lambda p: (0.0 * p.u, 0.42 + 0 * p.u, 0.06 * p.bell),
        ((0, -9.9, 0, 0.34, 0.06),),
        is_split=False,
    ),
    Shape(
        "mouthDown",
        lambda p: (0.0 * p.u, -0.42 + 0 * p.u, 0.0 * p.u),
        ((0, -9.9, 0, -0.16, 0.04),),
        is_split=False,
    ),
    Shape("chinRaiseU", lambda p: (0.0 * p.u, 0.20 * p.bell * p.upper, 0.08 * p.bell * p.upper)),
    Shape(
        "chinRaiseD",
        lambda p: (0.0 * p.u, (0.10 + 0.24 * p.bell) * p.lower, 0.24 * p.bell * p.lower),
        ((0, -9.9, 0, 0.46, 0.06), (1.2, -9.8, 0, 0.38, 0.04)),
        ((((2.4, -9.1), (1.2, -8.75), (0, -8.7)), -0.10, 0.26),),
    ),
    Shape(
        "chinCompress",
        lambda p: (0.0 * p.u, 0.08 * p.bell * p.lower, 0.04 * p.bell * p.lower),
        ((0, -9.9, 0, 0.22, 0.10), (0.9, -10.2, 0.05, 0.16, 0.08)),
        ((((1.6, -9.6), (0.8, -9.35), (0, -9.3)), -0.08, 0.22),),
    ),
    Shape(
        "cheekBlow",
        lambda p: (0.05 * p.u, 0.0 * p.u, 0.05 * p.bell),
        ((4.6, -5.9, 1.0, 0.0, 0.55), (3.7, -7.6, 0.55, -0.05, 0.5), (5.2, -7.0, 0.75, 0, 0.2)),
    ),
    Shape(
        "cheekSuck",
        lambda p: (-0.08 * p.u, 0.0 * p.u, 0.0 * p.u),
        ((4.6, -5.9, -0.55, 0.0, -0.40), (5.2, -7.0, -0.40, 0, -0.15)),
    ),
    Shape(
        "lipsBlow",
        lambda p: (
            -0.05 * p.u,
            0.10 * p.bell * (p.upper - p.lower) * p.rings(r0=0, r3=1, r5=1),
            0.34 * p.bell**0.6 * p.rings(m1=0.8, r0=0.8, r3=1.0, r5=0.9),
        ),
        ((1.6, -5.9, 0.03, 0.02, 0.30), (1.8, -9.0, 0.03, -0.02, 0.22)),
    ),
)
"""Every lip shape that is symmetric; sideways ones are in `shapes_side`."""

# Shapes of brows, nose, cheeks, eyes' surroundings and neck (cm at full strength, left side).


_FOREHEAD_IN = tuple((((1.9, y + 0.1), (1.0, y), (0.0, y - 0.1)), 0.08, 0.28) for y in (3.7, 4.8))
_FOREHEAD_OUT = tuple((((4.6, y - 0.4), (3.6, y), (2.4, y)), 0.07, 0.30) for y in (3.9, 5.1))
_FROWN = (((0.62, 2.7), (0.52, 1.9), (0.60, 1.1)), 0.16, 0.24)
_PROCERUS = (((0.95, 0.85), (0.45, 0.72), (0.0, 0.70)), 0.12, 0.22)
_LOWER_LID = (((4.7, -1.15), (3.2, -1.75), (1.7, -1.35)), 0.10, 0.24)
_NOSE_SIDE = (((1.35, -1.75), (0.9, -0.9), (0.55, -0.1)), 0.12, 0.22)
_CROW = (((5.5, -0.9), (5.0, -0.1), (5.6, 0.6)), 0.06, 0.22)

FACE_SHAPES: tuple[Shape, ...] = (
    Shape(
        "browDown",
        None,
        (
            (0.7, 1.7, -0.20, -0.60, 0.20),
            (1.6, 1.75, -0.20, -0.66, 0.24),
            (2.7, 1.95, -0.12, -0.52, 0.16),
            (3.9, 2.0, 0.0, -0.26, 0.04),
            (4.9, 1.6, 0.0, -0.04, 0.0),
            (0, 1.9, 0, -0.42, 0.14),
            (1.4, 4.0, -0.05, -0.22, 0.0),
            (2.0, 1.15, -0.06, -0.42, 0.20),
        ),
        (_FROWN, _PROCERUS),
    ),
    Shape(
        "browLateral",
        None,
        (
            (0.7, 1.8, -0.26, -0.06, 0.10),
            (1.6, 1.9, -0.26, -0.10, 0.10),
            (2.8, 2.1, -0.14, -0.08, 0.04),
            (4.4, 1.9, 0.0, 0.0, 0.0),
        ),
        (_FROWN,),
    ),
    Shape(
        "browRaiseIn",
        None,
        (
            (0.7, 1.8, 0, 1.06, 0.02),
            (1.6, 1.9, 0, 0.94, 0.0),
            (2.7, 2.2, 0, 0.38, 0.0),
            (4.6, 1.8, 0, -0.04, 0),
            (0, 2.0, 0, 0.68, 0.0),
            (1.3, 3.9, 0, 0.60, 0),
            (1.9, 1.2, 0, 0.26, 0.0),
        ),
        _FOREHEAD_IN,
    ),
    Shape(
        "browRaiseOut",
        None,
        (
            (0.7, 1.8, 0, 0.05, 0),
            (1.6, 1.9, 0, 0.12, 0),
            (2.7, 2.2, 0, 0.62, 0),
            (3.8, 2.2, 0.02, 1.00, 0.02),
            (4.8, 1.7, 0.04, 0.78, 0),
            (3.6, 4.1, 0, 0.58, 0),
            (3.4, 1.4, 0, 0.32, 0.0),
        ),
        _FOREHEAD_OUT,
    ),
    Shape(
        "squintInner",
        None,
        (
            (3.1, -1.9, -0.05, 0.16, 0.10),
            (2.2, -1.7, -0.02, 0.16, 0.08),
            (4.2, -1.7, -0.06, 0.14, 0.06),
        ),
        (_LOWER_LID,),
    ),
    Shape(
        "cheekRaise",
        None,
        (
            (3.7, -2.5, 0.02, 0.58, 0.58),
            (4.8, -2.2, 0.04, 0.38, 0.26),
            (2.6, -2.6, 0.0, 0.28, 0.26),
            (3.4, -1.75, 0, 0.38, 0.26),
            (5.3, 0.2, 0.0, -0.04, 0.02),
        ),
        (_LOWER_LID, _CROW),
    ),
    Shape(
        "scrunch",
        None,
        (
            (3.7, -2.5, -0.06, 0.34, 0.24),
            (1.6, 1.75, -0.12, -0.40, 0.18),
            (3.2, 2.0, -0.06, -0.36, 0.12),
            (4.9, 1.3, -0.10, -0.16, 0.0),
            (0.9, -1.2, 0.0, 0.14, 0.08),
        ),
        (_LOWER_LID, _CROW, _NOSE_SIDE),
    ),
    Shape("lidPress", None, ((3.1, -1.8, 0, 0.08, 0.05), (3.1, 1.5, 0, -0.08, 0.05))),
    Shape(
        "noseWrinkle",
        lambda p: (0.0 * p.u, 0.15 * p.bell * p.upper, 0.0 * p.u),
        (
            (1.25, -4.3, 0.10, 0.32, 0.02),
            (0, -3.9, 0, 0.10, 0),
            (0.9, -1.3, 0.0, 0.20, 0.14),
            (2.4, -4.5, 0.10, 0.40, 0.20),
            (2.4, -2.2, 0, 0.18, 0.10),
        ),
        (_NOSE_SIDE, (NASOLABIAL[:3], 0.16, 0.26)),
    ),
    Shape(
        "noseWrinkleUpper",
        None,
        (
            (0, 1.6, 0, -0.22, 0.06),
            (0.8, 1.7, -0.10, -0.28, 0.12),
            (2.0, 1.8, -0.04, -0.18, 0.06),
            (4.0, 2.0, 0, 0, 0),
        ),
        (_PROCERUS,),
    ),
    Shape(
        "nostrilDepress",
        lambda p: (0.0 * p.u, 0.0 * p.u, 0.0 * p.u),
        ((1.3, -4.3, -0.03, -0.20, 0.0), (0, -4.3, 0, -0.20, 0.0)),
    ),
    Shape(
        "nostrilDilate",
        lambda p: (0.0 * p.u, 0.0 * p.u, 0.0 * p.u),
        ((1.45, -4.3, 0.26, 0.05, 0.02), (0, -4.3, 0, 0.0, 0.0)),
    ),
    Shape(
        "nasolabialDeepen",
        lambda p: (0.0 * p.u, 0.03 * p.bell * p.upper, 0.0 * p.u),
        ((2.9, -4.4, 0.02, 0.10, 0.14),),
        ((NASOLABIAL, 0.20, 0.28),),
    ),
    Shape("jawClench", None, ((5.3, -5.6, 0.24, 0.0, 0.12), (5.0, -7.0, 0.20, 0.0, 0.14))),
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
