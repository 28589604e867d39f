"""Vertices and triangles of the skin: loops plus a Delaunay filler.

Loops are joined by strips of quads; the rest of the sphere of directions is filled with points
whose spacing follows the detail wanted, mirrored in x = 0, and triangulated by a convex hull
(on a sphere that is the Delaunay triangulation). The result depends on no identity.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from scipy.spatial import ConvexHull, cKDTree

from rig.arrays import Bool, Float64, Int64
from rig.face.geometry import loops
from rig.face.geometry.mesh import adjacency, project, unit
from rig.face.identity import Identity

FILLER, MOUTH, EYE_L, EYE_R, NOSTRIL_L, NOSTRIL_R = range(6)
FACE_AXIS = unit(np.array([0, -0.33, 0.94]))
NOSE_AXIS = unit(np.array([0, -4.3, 9.6]))
CHIN_AXIS = unit(np.array([0, -10.9, 6.0]))
NECK_Y = -15.6


@dataclass(frozen=True)
class Topology:
    """The skin's directions for the reference identity and its triangles.

    `kind`, `ring`, `slot` (V,) are for each vertex its feature, its loop
    (0 is the rim) and which place on the loop; `mirror` (V,) is the vertex on the other side.
    """

    directions: Float64
    faces: Int64
    kind: Int64
    ring: Int64
    slot: Int64
    mirror: Int64


def spacing(directions: Float64) -> Float64:
    """Target distance between neighbouring vertices, radians seen from the head's centre."""
    from_face = np.degrees(np.arccos(np.clip(directions @ FACE_AXIS, -1, 1)))
    from_nose = np.degrees(np.arccos(np.clip(directions @ NOSE_AXIS, -1, 1)))
    face = np.interp(from_face, [0, 28, 42, 60, 90, 180], [0.046, 0.046, 0.067, 0.14, 0.28, 0.36])
    nose = np.interp(from_nose, [0, 11, 19], [0.0275, 0.032, 0.064])
    neck = np.where(directions[:, 1] < -0.72, 0.118, 1.0)
    under_chin = np.degrees(np.arccos(np.clip(directions @ CHIN_AXIS, -1, 1)))
    neck = np.minimum(neck, np.interp(under_chin, [0, 18, 32], [0.045, 0.051, 0.12]))
    return np.minimum(np.minimum(face, nose), neck)


def loop_directions(identity: Identity) -> list[tuple[int, Float64]]:
    """Every feature's kind and its loops (loops, count, 3), the order vertices are stored in."""
    eye, nostril = loops.eye_directions(identity), loops.nostril_directions(identity)
    flip = np.array([-1, 1, 1])
    return [
        (MOUTH, loops.mouth_directions(identity)),
        (EYE_L, eye),
        (EYE_R, eye * flip),
        (NOSTRIL_L, nostril),
        (NOSTRIL_R, nostril * flip),
    ]


def _gnomonic(directions: Float64) -> Float64:
    return directions[:, :2] / np.maximum(directions[:, 2:3], 1e-3)


def in_polygon(points: Float64, polygon: Float64) -> Bool:
    """Which points (n, 2) lie inside a closed polygon (m, 2)."""
    x, y = points[:, 0], points[:, 1]
    inside = np.zeros(len(points), bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, 0), strict=True):
        crosses = (y0 > y) != (y1 > y)
        inside ^= crosses & (x < (x1 - x0) * (y - y0) / (y1 - y0 + 1e-12) + x0)
    return inside


def _in_a_feature(directions: Float64, features: list[tuple[int, Float64]]) -> Bool:
    flat, front = _gnomonic(directions), directions[:, 2] > 0.2
    inside = np.zeros(len(directions), bool)
    for _, rows in features:
        inside |= front & in_polygon(flat, _gnomonic(rows[-1]))
    return inside


def _midline(rows: Float64, features: list[tuple[int, Float64]]) -> Float64:
    """A row of points in the mirror plane, all the way round."""
    elevation = np.radians(np.arange(-100, 260, 0.25))
    ring = np.stack([0 * elevation, np.sin(elevation), np.cos(elevation)], -1)
    gap = 0.8 * spacing(ring)
    distance, _ = cKDTree(rows).query(ring)
    chosen: list[Float64] = []
    for point, radius in zip(ring, gap * ((distance > 0.6 * gap) & ~_in_a_feature(ring, features)),
                             strict=True):  # fmt: skip
        is_free = radius > 0 and (not chosen or np.linalg.norm(point - chosen[-1]) > radius)
        if is_free and (len(chosen) < 3 or np.linalg.norm(point - chosen[0]) > 0.6 * radius):
            chosen.append(point)
    return np.array(chosen)


def _scattered(rows: Float64, midline: Float64, features: list[tuple[int, Float64]]) -> Float64:
    """Poisson-disc points on the left half, away from loops and midline."""
    n = 60_000
    i = np.arange(n) + 0.5
    polar, turn = np.arccos(1 - 2 * i / n), np.pi * (1 + 5**0.5) * i
    points = np.stack(
        [np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], -1
    )
    points = points[points[:, 0] >= 0]
    points = points[np.argsort(-points[:, 2], kind="stable")]
    gap = spacing(points)
    distance, _ = cKDTree(rows).query(points)
    keep = (distance > 0.6 * gap) & (points[:, 0] > 0.45 * gap) & ~_in_a_feature(points, features)
    points, gap = points[keep], gap[keep]
    tree = cKDTree(points)
    is_free = np.ones(len(points), bool)
    for taken in tree.query_ball_point(midline, 0.75 * spacing(midline)):
        is_free[taken] = False
    chosen = []
    for k in range(len(points)):
        if is_free[k]:
            chosen.append(k)
            is_free[tree.query_ball_point(points[k], gap[k])] = False
    return points[chosen]


def _hull(directions: Float64) -> Int64:
    """Delaunay triangles on the sphere, counter-clockwise from outside, mirror-symmetric."""
    faces = ConvexHull(directions).simplices.astype(np.int64)
    a, b, c = (directions[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * (a + b + c)).sum(1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return faces


def _symmetric(faces: Int64, directions: Float64, mirror: Int64) -> Int64:
    """Keep the triangles of the left half and add their mirror images.

    Where an edge joins a vertex to its own mirror image across the midline, the edge is turned
    so that it lies in the midline.
    """
    x = directions[faces][..., 0]
    half = [faces[(x > -1e-9).all(1)]]
    across: dict[int, list[int]] = {}
    for face in faces[(x > 1e-9).any(1) & (x < -1e-9).any(1)]:
        left = int(face[np.argmax(directions[face, 0])])
        across.setdefault(left, []).extend(int(k) for k in face if mirror[k] == k)
    for left, midline in across.items():
        one, two = midline
        a, b, c = directions[[left, one, two]]
        is_outward = np.cross(b - a, c - a) @ a > 0
        half.append(np.array([[left, one, two] if is_outward else [left, two, one]]))
    kept = np.concatenate(half)
    return np.concatenate([kept, mirror[kept][:, ::-1]])


def _relaxed(directions: Float64, movable: Bool, midline: Bool) -> Float64:
    """Move filler points towards their neighbours' mean, six times."""
    for _ in range(6):
        graph = adjacency(_hull(directions), len(directions))
        mean = (graph @ directions) / np.asarray(graph.sum(1))
        moved = 0.4 * directions + 0.6 * mean
        moved[midline, 0] = 0
        touches_loop = np.asarray(graph[:, ~movable].sum(1)).ravel() > 0
        hold = ~movable | touches_loop
        directions = np.where(hold[:, None], directions, unit(moved))
    return directions


def _strips(start: int, count: int, n_loops: int, flipped: bool) -> Int64:
    """Two triangles a quad between neighbouring loops of one feature."""
    i = np.arange(count)
    parts = []
    for k in range(n_loops - 1):
        a, b = start + k * count + i, start + (k + 1) * count + i
        a2, b2 = np.roll(a, -1), np.roll(b, -1)
        parts += [np.stack([a, b, a2], -1), np.stack([a2, b, b2], -1)]
    faces = np.concatenate(parts)
    return faces[:, ::-1] if flipped else faces


@lru_cache(maxsize=1)
def build_topology() -> Topology:
    """Place and join the skin's vertices for the reference identity (about a second)."""
    features = loop_directions(Identity())
    rows = np.concatenate([r.reshape(-1, 3) for _, r in features])
    labels = np.concatenate(
        [
            np.stack(np.broadcast_arrays(
                kind, np.arange(r.shape[0])[:, None], np.arange(r.shape[1])[None]), -1
            ).reshape(-1, 3)
            for kind, r in features
        ]
    )  # fmt: skip
    midline = _midline(rows, features)
    side = _scattered(rows, midline, features)
    directions = np.concatenate([rows, midline, side, side * [-1, 1, 1]])
    n, n_rows = len(directions), len(rows)
    kind, ring, slot = np.zeros((3, n), np.int64)
    kind[:n_rows], ring[:n_rows], slot[:n_rows] = labels.T

    outer = np.zeros(n, bool)
    outer[n_rows:] = True
    for which, r in features:
        outer |= (kind == which) & (ring == len(r) - 1)
    ids = np.flatnonzero(outer)
    movable, on_midline = np.arange(n) >= n_rows, np.zeros(n, bool)
    on_midline[n_rows : n_rows + len(midline)] = True
    directions[ids] = _relaxed(directions[ids], movable[ids], on_midline[ids])
    # Index of the mirror image of every point.
    distance, index = cKDTree(directions).query(directions * [-1, 1, 1])
    assert np.max(distance) < 1e-6, "the skin's points are not mirror-symmetric"
    mirror = np.asarray(index, np.int64)
    faces = ids[_hull(directions[ids])]
    faces = faces[~_spans_feature(faces, directions, kind, features)]
    faces = _symmetric(faces, directions, mirror)
    strips, start = [], 0
    for which, r in features:
        flipped = which in (EYE_R, NOSTRIL_R)
        strips.append(_strips(start, r.shape[1], r.shape[0], flipped))
        start += r.shape[0] * r.shape[1]
    whole = Topology(directions, np.concatenate([faces, *strips]), kind, ring, slot, mirror)
    return _cut_at_neck(whole)


def _cut_at_neck(whole: Topology) -> Topology:
    """Drop what lies below the neck of the reference head."""
    height = project(whole.directions, Identity())[:, 1]
    faces = whole.faces[(height[whole.faces] > NECK_Y).any(1)]
    used = np.zeros(len(height), bool)
    used[faces] = True
    new = np.cumsum(used) - 1
    return Topology(
        whole.directions[used], new[faces], whole.kind[used], whole.ring[used],
        whole.slot[used], new[whole.mirror[used]],
    )  # fmt: skip


def _spans_feature(
    faces: Int64, directions: Float64, kind: Int64, features: list[tuple[int, Float64]]
) -> Bool:
    """Hull triangles that lie inside a feature's outermost loop, to be cut out."""
    corner = kind[faces]
    same = (corner[:, 0] > 0) & (corner == corner[:, :1]).all(1)
    flat = _gnomonic(directions[faces].mean(1))
    cut = np.zeros(len(faces), bool)
    for which, rows in features:
        cut |= same & (corner[:, 0] == which) & in_polygon(flat, _gnomonic(rows[-1]))
    return cut


def directions_for(identity: Identity) -> Float64:
    """The topology's directions with the loops where `identity` has them.

    The filler follows the loops harmonically, so that triangles keep their shape.
    """
    topology = build_topology()
    if identity == Identity():
        return topology.directions
    rows = np.concatenate([r.reshape(-1, 3) for _, r in loop_directions(identity)])
    n, n_rows = len(topology.directions), len(rows)
    graph = adjacency(topology.faces, n)
    laplacian = sp.diags(np.asarray(graph.sum(1)).ravel()) - graph
    fixed = (np.arange(n) < n_rows) | (topology.directions[:, 2] < 0)
    shift = np.zeros((n, 3))
    shift[:n_rows] = rows - topology.directions[:n_rows]
    free = ~fixed
    matrix = laplacian.tocsr()
    shift[free] = splu(matrix[free][:, free].tocsc()).solve(
        -(matrix[free][:, fixed] @ shift[fixed])
    )
    return unit(topology.directions + shift)
