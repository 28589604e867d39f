"""Registration of one head with another: landmarks, guessed or given, thin plates, closest points.

The upper lip is matched with the upper lip only: vertices near the mouth are labelled by
their distance *along the surface* from the rims, which does not cross the slit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.sparse import coo_array, csc_array, csr_array, diags_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from rig.arrays import Float64, Int64
from rig.errors import MeshError
from rig.mesh.closest import ClosestPoints, SurfacePoints
from rig.mesh.deformation import factored, similarity
from rig.mesh.trimesh import (
    TriMesh,
    adjacency,
    boundary_edges,
    components,
    edges,
    largest_part,
    vertex_normals,
)
from rig.retarget.landmarks import CORNERS, LOWER_RIM, UPPER_RIM, check_landmarks

Rounds = Sequence[tuple[float, float, float]]
"""Per round: stiffness; furthest match that counts, in distances between the outer eye corners;
weight of the landmarks."""

_ROUNDS: Rounds = (
    (100.0, 0.13, 8.0),
    (40.0, 0.11, 6.0),
    (15.0, 0.09, 5.0),
    (6.0, 0.07, 4.0),
    (3.0, 0.055, 3.0),
    (1.5, 0.045, 2.0),
)
_LIP_REACH = 0.75
"""Lips are labelled this far from their rims along the surface, in widths of the mouth."""
_WELD = 1e-7
UPPER_LIP, LOWER_LIP = (*UPPER_RIM, "upper_lip_top"), (*LOWER_RIM, "lower_lip_bottom")

POOR_MATCH = 0.02
"""A median residual above this share of the eye distance (2 mm on a head) gives a warning."""


@dataclass(frozen=True, eq=False)
class Registration:
    """A source head laid over a target head.

    Parameters
    ----------
    source, target : TriMesh
        As they were given.
    placed : array [shape=(V_source, 3)]
        The source's vertices on the target.
    source_labels, target_labels : array of int [shape=(V,)]
        +1 upper lip, -1 lower lip, 0 neither.
    rotation : array [shape=(3, 3)]
        Turns the source's axes into the target's.
    scale : float
        Size of the target in units of the source's (1 if equal; 0.01 for metres over cm).
    eyes : float
        Distance between the target's outer eye corners, its unit of length here.
    residual : float
        Median distance from the placed skin to the target, in units of the target's outer-eye
        distance.
    inside_out : bool
        True if the target's normals point inward; it was turned over for the matching.
    """

    source: TriMesh
    target: TriMesh
    placed: Float64
    source_labels: Int64
    target_labels: Int64
    rotation: Float64
    scale: float
    eyes: float
    residual: float
    inside_out: bool

    @cached_property
    def correspondence(self) -> SurfacePoints:
        """Point on the placed source's skin of every target vertex."""
        normals = vertex_normals(self.target)
        return self.correspond_points(self.target.vertices, normals, self.target_labels)

    def correspond_points(self, points: Float64, normals: Float64, labels: Int64) -> SurfacePoints:
        """Points on the source's skin of points on the target with the target's normals.

        The triangles are numbered in `skin_faces`.
        """
        search = ClosestPoints(
            TriMesh(self.placed, self.source.faces[self.skin_faces]), labels=self.source_labels
        )
        outward = -normals if self.inside_out else normals
        return search.query(points, normals=outward, labels=labels)

    @cached_property
    def skin_faces(self) -> Int64:
        """Triangles of the source's largest part; teeth and tongue are not matched with lips."""
        on_skin = components(self.source)[self.source.faces[:, 0]] == 0
        return np.flatnonzero(np.asarray(on_skin))


def register(
    source: TriMesh,
    source_landmarks: Mapping[str, int],
    target: TriMesh,
    target_landmarks: Mapping[str, int],
) -> Registration:
    """Deform `source` onto `target`.

    Similarity and thin-plate spline on the landmarks both have, then six rounds of closest points
    with a Laplacian that loosens. Units and pose of the target do not matter.

    Parameters
    ----------
    source : TriMesh
        The rigged head; its largest connected part is the skin.
    source_landmarks : mapping of str to int
        Vertex of each landmark, see `rig.retarget.landmarks.LANDMARKS`.
    target : TriMesh
        The user's neutral head, any topology.
    target_landmarks : mapping of str to int
        The same on the target; at least `NEEDED`.

    Raises
    ------
    MeshError
        If landmarks are missing, or the lips share one.
    """
    for landmarks, mesh in ((source_landmarks, source), (target_landmarks, target)):
        check_landmarks(landmarks, len(mesh.vertices))
    from_, to = _shared_points(source_landmarks, target, target_landmarks)
    source_labels = lip_labels(source, source_landmarks)
    target_labels = lip_labels(target, target_landmarks)

    scale, rotation, shift = similarity(source.vertices[from_], to)
    aligned = scale * source.vertices @ rotation.T + shift
    centres = aligned[from_]
    spline = RBFInterpolator(centres, to - centres, kernel="thin_plate_spline", smoothing=0.02)
    aligned = aligned + np.asarray(spline(aligned))
    corners = [target_landmarks[f"eye_outer_{side}"] for side in ("left", "right")]
    eyes = float(np.linalg.norm(np.subtract(*target.vertices[corners])))
    placed = TriMesh(aligned, source.faces)
    found = ClosestPoints(target, candidates=8).query(placed.vertices)
    near = found.distances < _ROUNDS[0][1] * eyes
    theirs = found.interpolate(target.faces, vertex_normals(target))
    cosine = np.einsum("vc,vc->v", vertex_normals(placed), theirs)[near]
    inside_out = bool(len(cosine) and np.median(cosine) < 0)
    facing = target.flipped() if inside_out else target
    search = ClosestPoints(facing, labels=target_labels, candidates=24)

    skin_mesh, skin = largest_part(TriMesh(aligned, source.faces))
    position = np.searchsorted(skin, from_)
    on_skin = (position < len(skin)) & (skin[np.minimum(position, len(skin) - 1)] == from_)
    surface = closest_rounds(
        skin_mesh, source_labels[skin], search, position[on_skin], to[on_skin], eyes
    )
    carried = _carry_along(aligned, skin, surface)
    matched = search.query(surface, labels=source_labels[skin])
    residual = float(np.median(matched.distances)) / eyes
    return Registration(
        source, target, carried, source_labels, target_labels, rotation, scale, eyes, residual,
        inside_out,
    )  # fmt: skip


def _shared_points(
    source_landmarks: Mapping[str, int],
    target: TriMesh,
    target_landmarks: Mapping[str, int],
) -> tuple[Int64, Float64]:
    """Source vertices and target points of the landmarks both have, each place once.

    On a coarse mesh two landmarks may share a vertex; an upper and a lower one may not.
    """
    upper, lower = (
        {target_landmarks[n] for n in names if n in target_landmarks}
        for names in (UPPER_LIP, LOWER_LIP)
    )
    if upper & lower:
        raise MeshError(
            f"vertex {min(upper & lower)} is a landmark of the upper and of the lower lip; "
            "mark them apart (the lips of the mesh must not share vertices there)"
        )
    names = [name for name in source_landmarks if name in target_landmarks]
    from_ = np.array([source_landmarks[name] for name in names])
    to = target.vertices[[target_landmarks[name] for name in names]]
    _, first = np.unique(to, axis=0, return_index=True)
    first = np.sort(first)
    _, kept = np.unique(from_[first], return_index=True)
    chosen = first[np.sort(kept)]
    return from_[chosen], to[chosen]


def lip_labels(mesh: TriMesh, landmarks: Mapping[str, int]) -> Int64:
    """Label vertices near the mouth +1 (upper lip), -1 (lower lip) or 0 [shape=(V,)]."""
    graph = edge_lengths(mesh)
    width = float(np.linalg.norm(np.subtract(*(mesh.vertices[landmarks[c]] for c in CORNERS))))
    reach = _LIP_REACH * width
    upper, lower = (
        dijkstra(graph, directed=False, indices=seeds, limit=reach, min_only=True)
        for seeds in (
            [landmarks[n] for n in names if n in landmarks] for names in (UPPER_LIP, LOWER_LIP)
        )
    )
    labels = np.zeros(len(mesh.vertices), dtype=np.int64)
    labels[(upper < lower) & (upper < reach)] = 1
    labels[(lower < upper) & (lower < reach)] = -1
    return labels


def edge_lengths(mesh: TriMesh) -> csr_array:
    """Graph of edge lengths; rim vertices at one place (texture seams) are joined."""
    ends = edges(mesh.faces)
    lengths = np.linalg.norm(np.subtract(*(mesh.vertices[ends[:, k]] for k in (0, 1))), axis=1)
    rim = np.unique(boundary_edges(mesh))
    pairs = KDTree(mesh.vertices[rim]).query_pairs(_WELD * mesh.size, output_type="ndarray")
    ends = np.concatenate([ends, rim[pairs]]) if len(pairs) else ends
    # A stored zero would be no edge at all.
    lengths = np.concatenate([lengths, np.zeros(len(pairs))]) + 1e-12 * mesh.size
    low, high = np.sort(ends, axis=1).T
    _, first = np.unique(low * len(mesh.vertices) + high, return_index=True)
    count = len(mesh.vertices)
    return csr_array(coo_array((lengths[first], (low[first], high[first])), shape=(count, count)))


def closest_rounds(
    skin: TriMesh,
    labels: Int64,
    search: ClosestPoints,
    landmarks: Int64,
    goals: Float64,
    eyes: float,
    rounds: Rounds = _ROUNDS,
) -> Float64:
    """Pull the skin to its closest points, less stiffly each round.

    Parameters
    ----------
    skin : TriMesh
        Placed near the target.
    labels : array of int [shape=(V,)]
        Lip sides of the skin.
    search : ClosestPoints
        Over the target, with its own labels.
    landmarks, goals : arrays [shape=(P,)] and [shape=(P, 3)]
        Vertices of the skin and where they belong; may be empty.
    eyes : float
        Distance between the outer eye corners.
    rounds : sequence of (float, float, float)
        See `Rounds`.

    Returns
    -------
    vertices : array [shape=(V, 3)]
    """
    # L^T L of the umbrella Laplacian, with a trace of stiffness against drifting parts.
    neighbours = adjacency(skin)
    degree = np.maximum(np.asarray(neighbours.sum(axis=1)).ravel(), 1.0)
    laplacian = diags_array(np.ones(len(degree))) - diags_array(1.0 / degree) @ neighbours
    bending = csc_array(laplacian.T @ laplacian + 1e-9 * diags_array(np.ones(len(degree))))
    on_rim = np.zeros(len(search.mesh.vertices), dtype=bool)
    on_rim[boundary_edges(search.mesh)] = True
    points = np.array(skin.vertices)
    for stiffness, reach, hold in rounds:
        normals = vertex_normals(TriMesh(points, skin.faces))
        found = search.query(points, normals=normals, labels=labels, least_cosine=0.5)
        goal = found.interpolate(search.mesh.faces, search.mesh.vertices)
        corners = search.mesh.faces[found.triangles]
        # Beyond the edge of an open mesh every point matches the edge: no correspondence.
        beyond = (on_rim[corners] | (found.weights < 1e-9)).all(axis=1)
        weight = (found.allowed & ~beyond & (found.distances < reach * eyes)).astype(float)
        pull = weight[:, None] * (goal - points)
        weight[landmarks] += hold
        pull[landmarks] += hold * (goals - points[landmarks])
        system = csc_array(diags_array(weight) + stiffness * bending)
        points = points + factored(system).solve(pull)
    return points


def _carry_along(aligned: Float64, skin: Int64, surface: Float64) -> Float64:
    """Move eyes, teeth, tongue with the skin nearest to them, by inverse distance."""
    placed = aligned.copy()
    placed[skin] = surface
    others = np.setdiff1d(np.arange(len(aligned)), skin)
    moved = (surface - aligned[skin])[None]
    placed[others] += inverse_distance(aligned[skin], aligned[others], moved, count=8, power=1)[0]
    return placed


def inverse_distance(
    points: Float64, queries: Float64, values: Float64, *, count: int = 4, power: int = 2
) -> Float64:
    """Interpolate values [shape=(K, P, 3)] at points to queries by their nearest."""
    count = min(count, len(points))
    distance, near = KDTree(points).query(queries, k=count)
    distance, near = (np.asarray(x).reshape(-1, count) for x in (distance, near))
    weight = 1.0 / np.maximum(distance, 1e-9) ** power
    weight /= weight.sum(axis=1, keepdims=True)
    return np.asarray(np.einsum("qn,kqnc->kqc", weight, values[:, near]))
