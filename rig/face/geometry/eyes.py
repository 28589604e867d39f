"""Eyeballs and lashes."""

from dataclasses import replace

import numpy as np

from rig.arrays import Float64, Int64
from rig.face.geometry.mesh import EYE, HAIR, IRIS_UV, Mesh, grid_faces, join, painted, unit
from rig.face.geometry.skin import Skin
from rig.face.identity import Identity

PUPIL_DEGREES, IRIS_DEGREES = 10.5, 28.0
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
    turn = np.tile(np.arange(_COLUMNS) / _COLUMNS, len(polar))
    outward = np.clip((degrees - PUPIL_DEGREES) / (IRIS_DEGREES - PUPIL_DEGREES), 0, 1)
    u0, v0, side = IRIS_UV
    uv = np.stack([u0 + side * np.abs(1 - 2 * turn), v0 + side * outward], -1)
    return Mesh(vertices, faces, colors, gloss, uv, kind=np.array(EYE)), widened - vertices


def _polar_grid(polar: Float64, radius: float) -> Float64:
    turn = np.arange(_COLUMNS) / _COLUMNS * 2 * np.pi
    ring = np.sin(polar)[:, None]
    z = np.cos(polar)[:, None] * np.ones(_COLUMNS)
    return radius * np.stack([ring * np.cos(turn), ring * np.sin(turn), z], -1).reshape(-1, 3)


def _eye_colors(identity: Identity, degrees: Float64, column: Int64) -> tuple[Float64, Float64]:
    iris = 0.85 * np.array(identity.iris) + 0.02
    fleck = 1 + 0.16 * np.sin(column * 2.9) * np.sin(column * 1.3)
    stops = [0, PUPIL_DEGREES + 0.05, PUPIL_DEGREES + 0.3, 19, 26, IRIS_DEGREES, 29.1, 40, 55, 180]
    shades = np.array(
        [
            [0.015] * 3,
            [0.015] * 3,
            iris * 1.25,
            iris * 1.15,
            iris * 0.8,
            iris * 0.28,
            [0.76, 0.73, 0.72],
            [0.78, 0.73, 0.71],
            [0.76, 0.60, 0.56],
            [0.74, 0.45, 0.42],
        ]
    )
    colors = np.stack([np.interp(degrees, stops, shades[:, k]) for k in range(3)], -1)
    in_iris = (degrees > PUPIL_DEGREES + 0.1) & (degrees < IRIS_DEGREES - 0.5)
    colors[in_iris] *= fleck[in_iris, None]
    return np.clip(colors, 0, 1), np.full(len(degrees), 1.0)


LASHES_UPPER, LASHES_LOWER = 58, 26


def lashes(skin: Skin, kind: int, identity: Identity) -> tuple[Mesh, Int64, Float64]:
    """Single lashes along both lids: mesh, the rim vertex each hangs on, place 0..1.

    Places run from the inner corner (0) to the outer (1) of the eye; those of the lower lid are .5.
    """
    rim = skin.loop(kind, 0)
    side = 1 if skin.vertices[rim[0], 0] > 0 else -1
    half = len(rim) // 2
    meshes, roots, places = [], [], []
    for count, row, is_upper in (
        (LASHES_UPPER, rim[: half + 1][::-1], True),
        (LASHES_LOWER, np.r_[rim[half:], rim[0]], False),
    ):
        along = np.linspace(0.10 if is_upper else 0.25, 0.985, count)
        mesh = _fringe(skin.vertices[row], along, side, is_upper)
        meshes.append(painted(*mesh, np.array(identity.hair) * 0.35, 0.1))
        nearest = row[np.round(along * (len(row) - 1)).astype(int)]
        each = len(meshes[-1].vertices) // count
        roots.append(np.repeat(nearest, each))
        places.append(np.repeat(along if is_upper else np.full(count, 0.5), each))
    return replace(join(meshes), kind=np.array(HAIR)), np.concatenate(roots), np.concatenate(places)


def _fringe(row: Float64, along: Float64, side: int, is_upper: bool) -> tuple[Float64, Int64]:
    """Vertices and faces of lashes at places along a row of the lid's rim, both of their sides."""
    at = along * (len(row) - 1)
    root = np.stack([np.interp(at, np.arange(len(row)), row[:, k]) for k in range(3)], -1)
    jitter = np.random.default_rng(3 + is_upper).uniform(-1, 1, (2, len(along)))
    grow = np.sin(np.pi * np.clip(along * 0.92, 0, 1)) ** 0.5 * (0.55 + 0.45 * along)
    length = (0.50 if is_upper else 0.20) * grow * (1 + 0.18 * jitter[0])
    lean = side * (0.9 * (along - 0.42) + 0.12 * jitter[1])
    up = 0.20 if is_upper else -0.62
    way = unit(np.stack([lean, np.full(len(along), up), np.full(len(along), 0.85)], -1))
    curl = np.array([0, 0.42 if is_upper else -0.1, -0.12])
    t = np.array([0.0, 0.45, 1.0])
    line = root[:, None] + length[:, None, None] * (
        t[:, None] * way[:, None] + t[:, None] ** 2 * curl
    )
    thick = np.array([0.020, 0.012, 0.002])[:, None] * [1, 0, 0]
    strip = np.stack([line - thick, line + thick], 2).reshape(-1, 3)
    faces = np.concatenate([grid_faces(3, 2, closed=False, start=6 * k) for k in range(len(along))])
    return np.concatenate([strip, strip]), np.concatenate([faces, faces[:, ::-1] + len(strip)])
