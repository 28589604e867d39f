"""Shapes that do not come from the thin plate's left half: sideways lips and the neck."""

import numpy as np

from rig.arrays import Float64
from rig.face.geometry.mesh import smoothstep
from rig.face.geometry.skin import Skin
from rig.face.geometry.topology import MOUTH
from rig.face.motion.shapes import ShapeMaker

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
