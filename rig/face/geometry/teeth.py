"""Teeth, gums and tongue."""

import numpy as np

from rig.arrays import Float64
from rig.face.geometry.mesh import Mesh, grid_faces, join, mirrored, painted

TOOTH = np.array([0.83, 0.77, 0.71])
GUM = np.array([0.66, 0.33, 0.33])
UPPER_WIDTHS = np.array([0.76, 0.60, 0.66, 0.60, 0.58, 0.74])
LOWER_WIDTHS = np.array([0.50, 0.54, 0.60, 0.60, 0.62, 0.76])
UPPER_HEIGHTS = np.array([0.50, 0.44, 0.49, 0.40, 0.38, 0.34])
LOWER_HEIGHTS = np.array([0.42, 0.42, 0.43, 0.42, 0.41, 0.40])
UPPER_BACK, LOWER_BACK = 0.58, 0.95
"""How far the middle of the front teeth lies behind the lips' rim, cm."""
UPPER_EDGE, LOWER_EDGE = -0.22, -0.24
"""Height of the incisors' biting edges below the line where the lips meet, cm."""
LIP_BACK, LIP_EDGE = 0.80, -0.36
"""The surface in front of the lower teeth that the lower lip rests on, stated likewise."""


def arch_point(s: Float64, lip_z: float, *, is_upper: bool) -> tuple[Float64, Float64]:
    """Find x and z of the dental arch at s in -1..1 (0 between the front teeth)."""
    width, depth = (2.06, 4.2) if is_upper else (1.84, 4.1)
    front = lip_z - (UPPER_BACK if is_upper else LOWER_BACK)
    return width * np.sin(s * 1.35), front - depth * (1 - np.cos(s * 1.35))


def _tooth(width: float, height: float, thickness: float) -> Mesh:
    """A rounded block around the origin, slightly narrower at the gum."""
    polar, turn = np.linspace(0.02, np.pi - 0.02, 9), np.arange(12) / 12 * 2 * np.pi
    ring = np.sin(polar)[:, None]
    ball = np.stack(
        [ring * np.cos(turn), np.cos(polar)[:, None] * np.ones(12), ring * np.sin(turn)], -1
    ).reshape(-1, 3)
    box = np.sign(ball) * np.abs(ball) ** 0.55 * [width / 2, height, thickness]
    return painted(box, grid_faces(9, 12), TOOTH, 0.55)


def dental_arch(mouth_y: float, lip_z: float, *, is_upper: bool) -> Mesh:
    """Twelve teeth and their gum, in place for a head whose lips meet at `mouth_y`, `lip_z`."""
    widths = UPPER_WIDTHS if is_upper else LOWER_WIDTHS
    heights = UPPER_HEIGHTS if is_upper else LOWER_HEIGHTS
    edge = mouth_y + (UPPER_EDGE if is_upper else LOWER_EDGE)
    up = 1 if is_upper else -1
    centers = (np.cumsum(widths) - widths / 2) / widths.sum() * 0.93
    parts = []
    for s, width, height in zip(centers, widths, heights, strict=True):
        tooth = _tooth(width * 1.02, height, 0.2 + 0.32 * s)
        x, z = arch_point(s, lip_z, is_upper=is_upper)
        x2, z2 = arch_point(s + 0.02, lip_z, is_upper=is_upper)
        yaw = np.arctan2(-(z2 - z), x2 - x)
        turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
        place = np.array([x, edge + up * height, z])
        vertices = tooth.vertices @ turn.T + place
        shade = _lip_shadow(vertices, edge, up, lip_z) * (1.0 if is_upper else 0.8)
        tooth = Mesh(vertices, tooth.faces, tooth.colors * shade[:, None], tooth.gloss)
        parts += [tooth, mirrored(tooth)]
    parts.append(_gum(edge + up * 0.98, lip_z, is_upper=is_upper))
    return join(parts)


def _lip_shadow(vertices: Float64, edge: float, up: int, lip_z: float) -> Float64:
    """Light (V,) that lips and cheeks leave to the teeth: least at the gums and at the back."""
    from_edge, behind = up * (vertices[:, 1] - edge), lip_z - vertices[:, 2]
    back = np.interp(behind, [0.6, 1.4, 2.8, 4.2], [1.0, 0.8, 0.45, 0.25])
    return np.asarray(back * np.interp(from_edge, [0.1, 0.8], [1.0, 0.72]))


def _gum(y: float, lip_z: float, *, is_upper: bool) -> Mesh:
    """A band that the teeth stand in, scalloped between them."""
    s, turn = np.linspace(-1.02, 1.02, 61), np.arange(10) / 10 * 2 * np.pi
    x, z = arch_point(s, lip_z, is_upper=is_upper)
    up = 1 if is_upper else -1
    height = y + 0.40 * np.sin(turn)[None] + up * 0.05 * np.cos(s * 19)[:, None] ** 2
    band = np.stack(
        [x[:, None] + 0 * turn, height, z[:, None] - 0.06 + 0.25 * np.cos(turn)[None]], -1
    )
    mesh = painted(band.reshape(-1, 3), grid_faces(61, 10), GUM, 0.6)
    return Mesh(mesh.vertices, mesh.faces, _darkened(mesh.colors, mesh.vertices), mesh.gloss)


def _darkened(colors: Float64, vertices: Float64) -> Float64:
    """Less light reaches deeper into the mouth."""
    shade = np.interp(vertices[:, 2], [3.5, 6.0, 8.2], [0.25, 0.6, 1.0])
    return colors * shade[:, None]


TONGUE_ROWS, TONGUE_COLUMNS = 26, 22
TONGUE_BACK, TONGUE_LENGTH = 1.30, 5.2


def tongue(mouth_y: float, lip_z: float) -> tuple[Mesh, Float64]:
    """The tongue at rest behind the lower teeth, and every vertex's place 0 (tip) .. 1 (root)."""
    s = np.linspace(0, 1, TONGUE_ROWS)
    turn = np.arange(TONGUE_COLUMNS) / TONGUE_COLUMNS * 2 * np.pi
    tip = np.sqrt(np.clip(1 - (1 - np.clip(s * 3.0, 0, 1)) ** 2, 0, 1))
    half_width = 0.002 + 1.48 * tip * (0.72 + 0.28 * np.clip(s * 2.2, 0, 1))
    half_height = 0.002 + 0.30 * tip + 0.34 * s
    height = mouth_y - 1.00 + 0.42 * np.sin(np.pi * np.clip(s * 1.05, 0, 1)) - 0.5 * s**2
    groove = -0.10 * np.exp(-((np.cos(turn) / 0.22) ** 2)) * (np.sin(turn) > 0)
    y = (
        height[:, None]
        + half_height[:, None] * np.sin(turn)
        + groove * np.clip(s * 4, 0, 1)[:, None]
    )
    z = np.broadcast_to((lip_z - TONGUE_BACK - TONGUE_LENGTH * s)[:, None], y.shape)
    vertices = np.stack([half_width[:, None] * np.cos(turn), y, z], -1).reshape(-1, 3)
    mesh = painted(
        vertices,
        grid_faces(TONGUE_ROWS, TONGUE_COLUMNS)[:, ::-1],
        np.array([0.84, 0.45, 0.46]),
        0.55,
    )
    colors = _darkened(mesh.colors, vertices + np.array([0, 0, 0.8]))
    return Mesh(vertices, mesh.faces, colors, mesh.gloss), np.repeat(s, TONGUE_COLUMNS)
