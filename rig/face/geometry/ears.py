"""An ear from rings: bowl, inner ridge, groove, rim, and back into the skull."""

import numpy as np

from rig.face.geometry.mesh import SKIN, WHITE_UV, Mesh, grid_faces, painted, project
from rig.face.identity import Identity

_COLUMNS = 44
_RADIUS = np.array(
    [0.01, 0.18, 0.30, 0.40, 0.47, 0.53, 0.59, 0.66, 0.73, 0.80, 0.87, 0.93, 0.98, 1.0, 0.98,
     0.92, 0.84, 0.74, 0.66, 0.60]
)  # fmt: skip
_DEPTH = np.array(
    [-0.42, -0.41, -0.37, -0.26, -0.06, 0.10, 0.15, 0.12, 0.02, -0.05, -0.02, 0.12, 0.17, 0.08,
     -0.06, -0.20, -0.34, -0.55, -0.9, -1.5]
)  # fmt: skip
_LOBE = np.array(
    [-0.32, -0.29, -0.22, -0.12, -0.03, 0.03, 0.06, 0.08, 0.09, 0.09, 0.08, 0.06, 0.02, -0.06,
     -0.16, -0.24, -0.32, -0.5, -0.9, -1.5]
)  # fmt: skip


def ear(identity: Identity) -> Mesh:
    """The left ear, its back sunk into the head."""
    turn = np.arange(_COLUMNS) / _COLUMNS * 2 * np.pi  # 0 front, pi/2 top, pi back
    c, s = np.cos(turn), np.sin(turn)
    outline = 1 + 0.10 * np.maximum(s, 0) * np.maximum(-c, 0) * 2 - 0.22 * np.maximum(-s, 0) ** 1.5
    wide, tall = 1.52 * outline, 2.75 * (1 + 0.06 * s)
    is_lobe = np.clip(-s * 1.9 - 0.85, 0, 1)
    is_front = np.clip(c * 2.4 - 1.1, 0, 1) * np.clip(1 - np.abs(s + 0.1) * 1.3, 0, 1)
    depth = _DEPTH[:, None] * (1 - is_lobe) + _LOBE[:, None] * is_lobe
    depth = depth * (1 - is_front) + np.minimum(_LOBE, 0.03)[:, None] * is_front
    tragus = 0.30 * np.exp(-(((_RADIUS[:, None] - 0.50) / 0.14) ** 2)) * is_front
    front = _RADIUS[:, None] * wide * c
    up = _RADIUS[:, None] * tall * s
    local = np.stack([front, up, depth + tragus], -1).reshape(-1, 3) * identity.ear_size
    yaw, roll = np.radians(28), np.radians(-9)
    forward = np.array([-np.sin(yaw), 0, np.cos(yaw)])
    outward = np.array([np.cos(yaw), 0, np.sin(yaw)])
    upward = np.array([0.0, 1.0, 0.0])
    lean_f = np.cos(roll) * forward + np.sin(roll) * upward
    lean_u = np.cos(roll) * upward - np.sin(roll) * forward
    # Just outside the side of the head, level with the nose.
    direction = np.array([[1.0, -0.14, -0.22]])
    on_skin = project(direction / np.linalg.norm(direction), identity)[0]
    center = np.asarray(on_skin + np.array([0.86, 0.0, -0.25]))
    vertices = center + local @ np.stack([lean_f, lean_u, outward])
    mesh = painted(vertices, grid_faces(len(_RADIUS), _COLUMNS), identity.skin, 0.2)
    # The bowl is darker, the rim a little redder.
    radius = np.repeat(_RADIUS, _COLUMNS)
    back = np.repeat(np.arange(len(_RADIUS)) > 13, _COLUMNS)
    shade = np.where(back, 0.9, np.interp(radius, [0, 0.3, 0.5, 1.0], [0.6, 0.72, 0.97, 1.0]))
    colors = mesh.colors * shade[:, None] * [1.0, 0.95, 0.94]
    uv = np.add(WHITE_UV, 0.03 * np.stack([front, up], -1).reshape(-1, 2) / 3)
    return Mesh(vertices, mesh.faces, colors, mesh.gloss, uv, kind=np.array(SKIN))
