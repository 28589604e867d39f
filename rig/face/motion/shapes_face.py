"""Shapes of brows, nose, cheeks, eyes' surroundings and neck (cm at full strength, left side)."""

import numpy as np

from rig.arrays import Float64
from rig.face.geometry.mesh import smoothstep
from rig.face.geometry.skin import Skin
from rig.face.geometry.topology import MOUTH
from rig.face.motion.shapes import Shape, ShapeMaker
from rig.face.motion.shapes_mouth import NASOLABIAL

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
