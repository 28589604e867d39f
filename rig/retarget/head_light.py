"""Light that hair, nose, chin and shoulders keep from a head, found from depth pictures."""

import numpy as np
import scipy.sparse as sp

from rig.arrays import Bool, Float64, Int64
from rig.face.mesh import unit, vertex_normals
from rig.face.render.shading import TO_LIGHT
from rig.face.render.software import Screen, nearest_faces

SIDE, REACH_CM, BIAS_CM = 420, 24.0, 0.14
DIRECTIONS, KEY_SPREAD, KEY_SAMPLES = 40, 0.34, 28
SMOOTHINGS, LEAST_AMBIENT = 5, 0.25
"""Rounds of means of neighbours, and the ambient light of places that see no sky."""


def occlusion(points: Float64, faces: Int64, opaque: Bool | slice) -> Float64:
    """Share (V, 2) of the ambient and of the first light that reaches each point, 0..1.

    `opaque` faces keep light away; all faces tell where the surface looks.
    """
    normals = vertex_normals(points, faces)
    i = np.arange(DIRECTIONS) + 0.5
    polar, turn = np.arccos(1 - 2 * i / DIRECTIONS), np.pi * (1 + 5**0.5) * i
    sky = np.stack([np.sin(polar) * np.cos(turn), np.cos(polar), np.sin(polar) * np.sin(turn)], -1)
    rng = np.random.default_rng(5)
    key = unit(TO_LIGHT[0] + KEY_SPREAD * rng.standard_normal((KEY_SAMPLES, 3)))
    seen = np.zeros((len(normals), 2))
    total = np.full((len(normals), 2), 1e-6)
    for directions, column in ((sky, 0), (key, 1)):
        for direction in directions:
            cosine = np.maximum(normals @ direction, 0)
            weight = cosine * (1 + direction[1]) if column == 0 else np.ones(len(cosine))
            seen[:, column] += weight * _lit(points, faces[opaque], normals, direction)
            total[:, column] += weight
    share = seen / total
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    near = sp.coo_matrix((np.ones(len(edges)), tuple(edges.T)), (len(share),) * 2).tocsr()
    near = near + near.T
    count = np.maximum(np.asarray(near.sum(1)), 1).reshape(-1, 1)
    for _ in range(SMOOTHINGS):
        share = 0.5 * share + 0.5 * (near @ share) / count
    share[:, 0] = LEAST_AMBIENT + (1 - LEAST_AMBIENT) * share[:, 0]
    return np.asarray(share)


def _lit(points: Float64, faces: Int64, normals: Float64, direction: Float64) -> Float64:
    """Whether nothing lies between each vertex and a far light, 0..1."""
    right = unit(np.cross([0.0, 1.0, 0.01], direction))
    frame = np.stack([right, np.cross(direction, right), direction])
    x, y, z = frame @ (points - [0, -4, 0]).T
    scale = SIDE / (2 * REACH_CM)
    at = ((x * scale + SIDE / 2), (SIDE / 2 - y * scale), 60.0 - z)
    screen = Screen(SIDE, SIDE, *(values.astype(np.float32) for values in at))
    a, b, c = faces.T
    area = (at[0][b] - at[0][a]) * (at[1][c] - at[1][a])
    area -= (at[1][b] - at[1][a]) * (at[0][c] - at[0][a])
    _, depth = nearest_faces(screen, faces[np.abs(area) > 1e-6])
    # A little above the surface, so that it does not shade itself.
    from_x = at[0] + 0.5 * BIAS_CM * scale * (normals @ frame[0])
    from_y = at[1] - 0.5 * BIAS_CM * scale * (normals @ frame[1])
    lit = np.zeros(len(x))
    for dx, dy in ((-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)):
        column = np.clip((from_x + dx).astype(int), 0, SIDE - 1)
        row = np.clip((from_y + dy).astype(int), 0, SIDE - 1)
        lit += 0.25 * (depth[row, column] > at[2] - BIAS_CM)
    return lit
