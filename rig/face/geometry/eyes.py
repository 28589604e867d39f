"""Eyeballs and lashes."""

import numpy as np

from rig.arrays import Float64, Int64
from rig.face.geometry.mesh import Mesh, grid_faces, painted
from rig.face.geometry.skin import Skin
from rig.face.identity import Identity

PUPIL_DEGREES, IRIS_DEGREES = 9.5, 24.5
_RINGS = np.array([0, 0.3, 0.6, 0.85, 1.0, 1.02, 1.3, 1.6, 1.8, 1.93, 2.0, 2.05])
_COLUMNS = 40


def eyeball(identity: Identity, radius: float) -> tuple[Mesh, Float64]:
    """An eyeball around the origin that looks along +z, and its pupil shape.

    Returns
    -------
    mesh : Mesh
        Polar grid; rings fall on the edges of pupil and iris, so both are crisp.
    widen : ndarray [shape=(V, 3)], cm
        Displacement that makes the pupil half as wide again.
    """
    inner = np.interp(_RINGS, [0, 1, 2, 3], [0, PUPIL_DEGREES, IRIS_DEGREES, 60])
    polar = np.radians(np.concatenate([inner, np.linspace(32, 178, 14)]))
    grow = np.interp(_RINGS, [0, 1.02, 1.93, 3], [0, 0.5 * PUPIL_DEGREES, 0, 0])
    wide = polar + np.radians(np.concatenate([grow, np.zeros(14)]))
    vertices, widened = (_polar_grid(a, radius) for a in (polar, wide))
    degrees = np.repeat(np.degrees(polar), _COLUMNS)
    faces = grid_faces(len(polar), _COLUMNS)[:, ::-1]
    colors, gloss = _eye_colors(identity, degrees, np.tile(np.arange(_COLUMNS), len(polar)))
    return Mesh(vertices, faces, colors, gloss), widened - vertices


def _polar_grid(polar: Float64, radius: float) -> Float64:
    turn = np.arange(_COLUMNS) / _COLUMNS * 2 * np.pi
    ring = np.sin(polar)[:, None]
    z = np.cos(polar)[:, None] * np.ones(_COLUMNS)
    return radius * np.stack([ring * np.cos(turn), ring * np.sin(turn), z], -1).reshape(-1, 3)


def _eye_colors(identity: Identity, degrees: Float64, column: Int64) -> tuple[Float64, Float64]:
    iris = np.array(identity.iris)
    fleck = 1 + 0.16 * np.sin(column * 2.9) * np.sin(column * 1.3)
    stops = [0, PUPIL_DEGREES + 0.05, PUPIL_DEGREES + 0.3, 17, 22.5, IRIS_DEGREES, 25.6, 45, 180]
    shades = np.array(
        [
            [0.015] * 3,
            [0.015] * 3,
            iris * 1.25,
            iris * 1.15,
            iris * 0.8,
            iris * 0.28,
            [0.86, 0.83, 0.81],
            [0.90, 0.87, 0.85],
            [0.84, 0.66, 0.62],
        ]
    )
    colors = np.stack([np.interp(degrees, stops, shades[:, k]) for k in range(3)], -1)
    in_iris = (degrees > PUPIL_DEGREES + 0.1) & (degrees < IRIS_DEGREES - 0.5)
    colors[in_iris] *= fleck[in_iris, None]
    return np.clip(colors, 0, 1), np.full(len(degrees), 1.0)


def lashes(skin: Skin, kind: int, identity: Identity) -> tuple[Mesh, Int64, Float64]:
    """A dark fringe along the upper lid: mesh, the rim vertex each column hangs on, place 0..1.

    Columns run from the inner corner (0) to the outer (1) of the eye.
    """
    rim = skin.loop(kind, 0)
    upper = rim[np.r_[0 : len(rim) // 2 + 1]][::-1]
    side = 1 if skin.vertices[upper[0], 0] > 0 else -1
    along = np.linspace(0, 1, len(upper))
    length = 0.16 + 0.24 * np.sin(np.pi * np.clip(along * 0.95, 0, 1)) ** 0.6 * (0.4 + 0.6 * along)
    length *= np.clip(np.minimum(along, 1 - along) * 8, 0.12, 1)
    out = np.stack([0.45 * side * (along - 0.4), 0.18 + 0 * along, np.full(len(upper), 0.9)], -1)
    root = skin.vertices[upper]
    mid = root + length[:, None] * (0.55 * out)
    tip = root + length[:, None] * (out + np.array([0, 0.34, -0.10]))
    top = root + np.array([0, 0.045, 0.010])
    rows = np.stack([root - [0, 0.01, 0], mid, tip, top], 1)
    faces = grid_faces(len(upper), 4)
    mesh = painted(
        rows.reshape(-1, 3),
        faces[:, ::-1] if side > 0 else faces,
        np.array(identity.hair) * 0.5,
        0.1,
    )
    return mesh, np.repeat(upper, 4), np.repeat(along, 4)
