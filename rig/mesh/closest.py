"""Closest points on a mesh, limited to triangles of the same side and direction.

Letters: Q query points.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from rig.arrays import Bool, Float64, Int64
from rig.mesh.trimesh import TriMesh, triangle_normals

_PENALTY = 1e3
"""Distance added to triangles that are not allowed, in mesh sizes: chosen only if none is."""


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Q points on a surface: a triangle each, and weights of its corners.

    Parameters
    ----------
    triangles : array [shape=(Q,)]
    weights : array [shape=(Q, 3), rows sum to 1]
        Barycentric coordinates.
    distances : array [shape=(Q,)]
        From the query point to the surface point.
    allowed : array of bool [shape=(Q,)]
        False where no allowed triangle was near and another was taken.
    """

    triangles: Int64
    weights: Float64
    distances: Float64
    allowed: Bool

    def interpolate(self, faces: Int64, values: Any) -> Float64:
        """Values at the points [shape=(Q, ...)] from values at vertices [shape=(V, ...)]."""
        corners = np.asarray(values)[faces[self.triangles]]
        return np.asarray(np.einsum("qk,qk...->q...", self.weights, corners))


class ClosestPoints:
    """Prepared search over one mesh.

    Parameters
    ----------
    mesh : TriMesh
    labels : array of int [shape=(V,)], optional
        Side of each vertex: +1 upper lip, -1 lower lip, 0 neither. A query labelled +1 is never
        matched with a triangle labelled -1, nor the reverse.
    candidates : int
        How many triangles (by centroid) are tried for each query.
    """

    def __init__(self, mesh: TriMesh, *, labels: Any = None, candidates: int = 32) -> None:
        from scipy.spatial import KDTree

        self.mesh = mesh
        self._corners = mesh.vertices[mesh.faces]
        self._normals = triangle_normals(mesh)
        self._tree = KDTree(self._corners.mean(axis=1))
        self._candidates = min(candidates, len(mesh.faces))
        zeros = np.zeros(len(mesh.vertices), dtype=np.int64)
        sides = zeros if labels is None else np.asarray(labels)
        self._sides = np.sign(sides[mesh.faces].sum(axis=1))

    def query(
        self, points: Any, *, normals: Any = None, labels: Any = None, least_cosine: float = 0.3
    ) -> SurfacePoints:
        """Closest allowed surface point of each query.

        Parameters
        ----------
        points : array [shape=(Q, 3)]
            The queries.
        normals : array [shape=(Q, 3)], optional
            Only triangles facing the same way (cosine at least `least_cosine`) are allowed.
        labels : array of int [shape=(Q,)], optional
            Lip sides of the queries.
        least_cosine : float [-1 to 1]
            See `normals`.
        """
        points = np.asarray(points, dtype=np.float64)
        _, found = self._tree.query(points, k=self._candidates)
        near = np.asarray(found, dtype=np.int64).reshape(len(points), -1)
        best = np.full(len(points), np.inf)
        triangles = near[:, 0].copy()
        weights = np.zeros((len(points), 3))
        for column in near.T:
            corners = self._corners[column]
            barycentric, distance = closest_barycentric(points, corners)
            refused = np.zeros(len(points), dtype=bool)
            if normals is not None:
                facing = np.einsum("qc,qc->q", self._normals[column], normals)
                refused |= facing < least_cosine
            if labels is not None:
                refused |= self._sides[column] * np.asarray(labels) < 0
            cost = distance + refused * (_PENALTY * self.mesh.size)
            better = cost < best
            best = np.where(better, cost, best)
            triangles = np.where(better, column, triangles)
            weights[better] = barycentric[better]
        allowed = best < _PENALTY * self.mesh.size
        surface = np.einsum("qk,qkc->qc", weights, self._corners[triangles])
        return SurfacePoints(triangles, weights, np.linalg.norm(points - surface, axis=1), allowed)


def closest_barycentric(points: Float64, corners: Float64) -> tuple[Float64, Float64]:
    """Closest point of triangle `corners` [shape=(Q, 3, 3)] to each of `points` [shape=(Q, 3)].

    Either the foot of the perpendicular, if it falls inside, or the nearest point of an edge.

    Returns
    -------
    weights : array [shape=(Q, 3)]
    distances : array [shape=(Q,)]
    """
    best, distance = _foot(points, corners)
    for one, two in ((0, 1), (1, 2), (2, 0)):
        start, span = corners[:, one], corners[:, two] - corners[:, one]
        length = np.maximum(np.einsum("qc,qc->q", span, span), 1e-300)
        t = np.clip(np.einsum("qc,qc->q", points - start, span) / length, 0.0, 1.0)
        apart = np.linalg.norm(points - start - t[:, None] * span, axis=1)
        nearer = apart < distance
        distance = np.where(nearer, apart, distance)
        edge = np.zeros_like(best)
        edge[:, one], edge[:, two] = 1.0 - t, t
        best = np.where(nearer[:, None], edge, best)
    return best, distance


def _foot(points: Float64, corners: Float64) -> tuple[Float64, Float64]:
    """Perpendicular foot; at infinite distance where it falls outside the triangle."""
    a = corners[:, 0]
    u, v, w = corners[:, 1] - a, corners[:, 2] - a, points - a
    uu, uv, vv = (np.einsum("qc,qc->q", x, y) for x, y in ((u, u), (u, v), (v, v)))
    wu, wv = np.einsum("qc,qc->q", w, u), np.einsum("qc,qc->q", w, v)
    determinant = uu * vv - uv * uv
    flat = determinant <= 1e-24 * uu * vv
    safe = np.where(flat, 1.0, determinant)
    s, t = (vv * wu - uv * wv) / safe, (uu * wv - uv * wu) / safe
    weights = np.stack([1.0 - s - t, s, t], axis=1)
    inside = (weights >= 0).all(axis=1) & ~flat
    foot = a + s[:, None] * u + t[:, None] * v
    distance = np.where(inside, np.linalg.norm(points - foot, axis=1), np.inf)
    return np.where(inside[:, None], weights, 0.0), distance
