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
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree

from rig.arrays import Float64, Int64
from rig.errors import MeshError
from rig.mesh.trimesh import (
    ClosestPoints,
    SurfacePoints,
    TriMesh,
    adjacency,
    boundary_edges,
    components,
    edges,
    vertex_normals,
)
from rig.retarget.landmarks import CORNERS, LOWER_RIM, UPPER_RIM, check_landmarks, similarity

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
        """For every target vertex, its point on the placed source's skin."""
        normals = vertex_normals(self.target)
        return self.correspond_points(self.target.vertices, normals, self.target_labels)

    def correspond_points(self, points: Float64, normals: Float64, labels: Int64) -> SurfacePoints:
        """For points on the target with the target's normals, their points on the source's skin.

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
    from_, to = _shared_points(source, source_landmarks, target, target_landmarks)
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

    skin = np.flatnonzero(components(source) == 0)
    new_index = np.full(len(aligned), -1, dtype=np.int64)
    new_index[skin] = np.arange(len(skin))
    inside = (new_index[source.faces] >= 0).all(axis=1)
    skin_mesh = TriMesh(aligned[skin], new_index[source.faces[inside]])
    position = np.searchsorted(skin, from_)
    on_skin = (position < len(skin)) & (skin[np.minimum(position, len(skin) - 1)] == from_)
    surface = closest_rounds(
        skin_mesh, source_labels[skin], search, position[on_skin], to[on_skin], eyes
    )
    carried = _carry_along(aligned, skin, surface)
    matched = search.query(surface, labels=source_labels[skin])
    residual = float(np.median(matched.distances)) / eyes
    return Registration(
        source,
        target,
        carried,
        source_labels,
        target_labels,
        rotation,
        scale,
        eyes,
        residual,
        inside_out,
    )


def _shared_points(
    source: TriMesh,
    source_landmarks: Mapping[str, int],
    target: TriMesh,
    target_landmarks: Mapping[str, int],
) -> tuple[Int64, Float64]:
    """Source vertices and target points of the landmarks both have, each place once.

    On a coarse mesh two landmarks may share a vertex; an upper and a lower one may not.
    """
    upper, lower = (
        {target_landmarks[n] for n in names if n in target_landmarks}
        for names in ((*UPPER_RIM, "upper_lip_top"), (*LOWER_RIM, "lower_lip_bottom"))
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
        _along_surface(graph, [landmarks[n] for n in (*rim, edge) if n in landmarks], reach)
        for rim, edge in ((UPPER_RIM, "upper_lip_top"), (LOWER_RIM, "lower_lip_bottom"))
    )
    labels = np.zeros(len(mesh.vertices), dtype=np.int64)
    labels[(upper < lower) & (upper < reach)] = 1
    labels[(lower < upper) & (lower < reach)] = -1
    return labels


def _along_surface(graph: csr_array, seeds: Sequence[int], reach: float) -> Float64:
    return np.asarray(dijkstra(graph, directed=False, indices=seeds, limit=reach, min_only=True))


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
        factors = splu(
            system,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        points = points + factors.solve(pull)
    return points


def _carry_along(aligned: Float64, skin: Int64, surface: Float64) -> Float64:
    """Move eyes, teeth, tongue with the skin nearest to them, by inverse distance."""
    placed = aligned.copy()
    placed[skin] = surface
    others = np.setdiff1d(np.arange(len(aligned)), skin)
    if len(others):
        distance, nearest = KDTree(aligned[skin]).query(aligned[others], k=8)
        weight = 1.0 / np.maximum(distance, 1e-9)
        weight /= weight.sum(axis=1, keepdims=True)
        moved = (surface - aligned[skin])[nearest]
        placed[others] += np.einsum("qk,qkc->qc", weight, moved)
    return placed


# Landmarks of a neutral face, found by laying the embedded head over it.
#
# The head is tried in the usual orientations and several sizes, fitted rigidly, then loosely; its
# landmarks are read off. The mouth is then found exactly: lips are vertices near in space and far
# along the surface.


ORIENTATIONS = (
    np.eye(3),
    np.diag([-1.0, 1.0, -1.0]),
    np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    np.array([[-1.0, 0, 0], [0, 0, 1], [0, 1, 0]]),
)
"""From the mesh's axes to ours: y up facing +z; facing -z; z up facing -y; facing +y."""

_SIZES = (0.75, 0.85, 0.95, 1.05, 1.2)
_STEPS = 25
_LOOSENING: Rounds = (
    (3000.0, 0.35, 0.0),
    (1000.0, 0.3, 0.0),
    (300.0, 0.25, 0.0),
    (100.0, 0.2, 0.0),
    (40.0, 0.15, 0.0),
    (15.0, 0.1, 0.0),
)
_VAGUE = (
    "brow",
    "nose_wing",
    "eye_upper",
    "eye_lower",
    "upper_lip",
    "lower_lip",
    "upper_rim",
    "lower_rim",
)
"""Landmarks for which the fit is too inaccurate; they are found by rims and the slit only."""
_WORST = 0.03
"""Largest median residual of an accepted fit, in eye distances."""


_SLIT_REACH = (0.03, 0.06)
"""Distance of vertices across the slit, in widths of the mouth; the second for parted lips."""
_WAY_ROUND = 3.0
"""Least ratio of the way along the surface to that distance."""
_FEWEST_PAIRS = 12
_FEWEST_VERTICES = 100


@dataclass(frozen=True)
class Guess:
    """Landmarks that were found, and the residual of the fit.

    Parameters
    ----------
    landmarks : dict of str to int
    residual : float
        Median distance of the laid-over head from the mesh, in outer-eye distances.
    """

    landmarks: dict[str, int]
    residual: float


def guess_landmarks(mesh: TriMesh, source: TriMesh, landmarks: dict[str, int]) -> Guess:
    """Find the landmarks of `mesh` from those of a source head.

    Parameters
    ----------
    mesh : TriMesh
        A neutral face, mouth closed, upright along one of its axes; hair and shoulders may be
        there, the face must be bare.
    source : TriMesh
        The embedded head; its largest part is the skin.
    landmarks : dict of str to int
        Of the source.

    Raises
    ------
    MeshError
        If no fit is good enough or no mouth is found; landmarks must be given then.
    """
    skin, chosen = _largest_part(source)
    if len(mesh.vertices) < _FEWEST_VERTICES:
        raise _unrecognised(f"{len(mesh.vertices)} vertices are too few for a face")
    marks = {name: int(np.searchsorted(chosen, v)) for name, v in landmarks.items()}
    target, used = _largest_part(mesh)
    fits = [_fit_rigidly(skin, target, axes) for axes in ORIENTATIONS]
    _, placed, axes = min(fits, key=lambda fit: fit[0])
    turned = TriMesh(target.vertices @ axes.T, target.faces)
    eyes = float(np.linalg.norm(placed[marks["eye_outer_left"]] - placed[marks["eye_outer_right"]]))
    none = np.zeros(0, dtype=np.int64)
    search = ClosestPoints(turned, candidates=24)
    surface = closest_rounds(
        TriMesh(placed, skin.faces),
        np.zeros(len(placed), dtype=np.int64),
        search,
        none,
        np.zeros((0, 3)),
        eyes,
        _LOOSENING,
    )
    residual = float(np.median(search.query(surface).distances)) / eyes
    if residual > _WORST:
        raise _unrecognised("no face was recognised in the mesh (it must stand upright)")
    found = {name: _nearest_vertex(turned, surface[v]) for name, v in marks.items()}
    placed_marks = {name: surface[v] for name, v in marks.items()}
    found = {n: v for n, v in found.items() if not n.startswith(_VAGUE)}
    found |= _mouth(turned, placed_marks) | _eyes(turned, placed_marks, eyes)
    return Guess({name: int(used[v]) for name, v in found.items()}, residual)


def _largest_part(mesh: TriMesh) -> tuple[TriMesh, Int64]:
    labels = components(mesh)
    return TriMesh(mesh.vertices, mesh.faces[labels[mesh.faces[:, 0]] == 0]).compact()


def _fit_rigidly(skin: TriMesh, target: TriMesh, axes: Float64) -> tuple[float, Float64, Float64]:
    """Best similarity of the skin's front over the target in one orientation, of several sizes."""
    points = target.vertices @ axes.T
    normals = vertex_normals(TriMesh(points, target.faces))
    tree = KDTree(points)
    ours, our_normals = skin.vertices, vertex_normals(skin)
    front = np.flatnonzero((our_normals[:, 2] > 0.1) & (ours[:, 2] > 3.0))[::3]
    nose = points[np.argmax(points[:, 2])]
    level = np.abs(points[:, 1] - nose[1]) < 0.05 * np.ptp(points[:, 1])
    width = float(np.ptp(points[level, 0]))
    our_nose = ours[np.argmax(ours[:, 2])]
    our_level = np.abs(ours[:, 1] - our_nose[1]) < 1.0
    our_width = float(np.ptp(ours[our_level, 0]))
    best = (np.inf, ours)
    for size in _SIZES:
        scale = size * width / our_width
        placed = scale * (ours - our_nose) + nose
        for _ in range(_STEPS):
            distance, nearest = _query(tree, placed[front])
            facing = np.einsum("vc,vc->v", our_normals[front], normals[nearest]) > 0.3
            near = facing & (distance <= np.quantile(distance, 0.85))
            if near.sum() < 20:
                break
            scale, rotation, shift = similarity(ours[front[near]], points[nearest[near]])
            placed = scale * ours @ rotation.T + shift
        distance, nearest = _query(tree, placed[front])
        facing = np.einsum("vc,vc->v", our_normals[front], normals[nearest]) > 0.3
        cost = float(np.mean(np.minimum(distance / scale, 2.0) + 1.0 * ~facing))
        if cost < best[0]:
            best = (cost, placed)
    return (*best, axes)


def _query(tree: KDTree, points: Float64) -> tuple[Float64, Int64]:
    distance, nearest = tree.query(points)
    return np.asarray(distance), np.asarray(nearest, dtype=np.int64)


def _nearest_vertex(mesh: TriMesh, point: Float64) -> int:
    return int(np.argmin(np.linalg.norm(mesh.vertices - point, axis=1)))


def _eyes(mesh: TriMesh, placed_marks: dict[str, Float64], eyes: float) -> dict[str, int]:
    """Lids from the open rims of the eyes, where the skin has them."""
    ends = boundary_edges(mesh)
    count = len(mesh.vertices)
    links = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    _, labels = connected_components(links, directed=False)
    rim = np.unique(ends)
    found: dict[str, int] = {}
    for side, outward in (("left", 1.0), ("right", -1.0)):
        corners = [
            placed_marks[f"eye_{corner}_{side}"] for corner in ("outer", "inner", "upper", "lower")
        ]
        for label in np.unique(labels[rim]):
            loop = rim[labels[rim] == label]
            points = mesh.vertices[loop]
            width, height = np.ptp(points[:, 0]), np.ptp(points[:, 1])
            middle = points.mean(axis=0)
            apart = np.linalg.norm((middle - np.mean(corners, axis=0))[:2])
            if not (0.15 < width / eyes < 0.45 and height < width and apart < 0.15 * eyes):
                continue
            found[f"eye_outer_{side}"] = int(loop[np.argmax(outward * points[:, 0])])
            found[f"eye_inner_{side}"] = int(loop[np.argmin(outward * points[:, 0])])
            found[f"eye_upper_{side}"] = _lid(mesh, points, middle, 1.0)
            found[f"eye_lower_{side}"] = _lid(mesh, points, middle, -1.0)
    return found


def _lid(mesh: TriMesh, loop: Float64, middle: Float64, side: float) -> int:
    """Vertex of a lid's edge: the one furthest into the eye, near the loop and its middle.

    Behind the edge the skin turns in and the loop is wider than the visible opening.
    """
    width = float(np.ptp(loop[:, 0]))
    distance = _query(KDTree(loop), mesh.vertices)[0]
    offset = mesh.vertices - middle
    here = (
        (distance < 0.2 * width)
        & (np.abs(offset[:, 0]) < 0.1 * width)
        & (side * offset[:, 1] > 0.05 * width)
    )
    if not here.any():
        return _nearest_vertex(mesh, middle)
    return int(np.argmin(np.where(here, side * offset[:, 1], np.inf)))


def _mouth(mesh: TriMesh, placed_marks: dict[str, Float64]) -> dict[str, int]:
    """Rims and corners from the slit: near in space, far along the surface."""
    corners = placed_marks["mouth_corner_left"], placed_marks["mouth_corner_right"]
    width = float(np.linalg.norm(corners[0] - corners[1]))
    middle = 0.5 * (placed_marks["upper_rim"] + placed_marks["lower_rim"])
    near = np.flatnonzero(
        (np.abs(mesh.vertices - middle) < np.array([0.75, 0.35, 0.5]) * width).all(axis=1)
    )
    pairs, short = _slit_pairs(mesh, near, width)
    points = mesh.vertices
    centre = 0.5 * (points[pairs[:, 0]] + points[pairs[:, 1]])
    left, right = centre[:, 0].max() + short, centre[:, 0].min() - short
    half = 0.25 * (left - right)
    found = {}
    for name, x in (("", 0.5 * (left + right)), ("_left", 0.5 * (left + right) + half),
                    ("_right", 0.5 * (left + right) - half)):  # fmt: skip
        here = np.flatnonzero(np.abs(centre[:, 0] - x) < 0.08 * width)
        if len(here) == 0:
            continue
        # Of the pairs here, the one furthest in front is where the lips meet.
        best = pairs[here[np.argmax(centre[here, 2])]]
        found[f"upper_rim{name}"], found[f"lower_rim{name}"] = int(best[0]), int(best[1])
    if "upper_rim" not in found:
        raise _unrecognised("no closed mouth was found in the mesh")
    for side, extreme, way in (("left", np.argmax, short), ("right", np.argmin, -short)):
        end = centre[extreme(centre[:, 0])] + np.array([way, 0.0, 0.0])
        found[f"mouth_corner_{side}"] = _nearest_vertex(mesh, end)
    return found


def _slit_pairs(mesh: TriMesh, near: Int64, width: float) -> tuple[Int64, float]:
    """Pairs (upper, lower) of vertices across the slit [shape=(P, 2)], and where they end.

    That is how far short of the corners, where the way round is no longer long.
    """
    graph, normals, points = edge_lengths(mesh), vertex_normals(mesh), mesh.vertices
    for share in _SLIT_REACH:
        reach = share * width
        close = KDTree(points[near]).query_pairs(reach, output_type="ndarray")
        if len(close) == 0:
            continue
        starts = np.unique(close[:, 0])
        along = dijkstra(graph, directed=False, indices=near[starts], limit=_WAY_ROUND * reach)
        row = np.searchsorted(starts, close[:, 0])
        far = ~np.isfinite(along[row, near[close[:, 1]]])
        if far.sum() < _FEWEST_PAIRS:
            continue
        one, two = near[close[far, 0]], near[close[far, 1]]
        # The upper lip lies above; where they touch, its rim faces down.
        above = points[one, 1] - points[two, 1] + 0.01 * width * (normals[two, 1] - normals[one, 1])
        upper, lower = np.where(above > 0, one, two), np.where(above > 0, two, one)
        return np.stack([upper, lower], axis=1), 0.5 * _WAY_ROUND * reach
    raise _unrecognised("no closed mouth was found in the mesh")


def _unrecognised(problem: str) -> MeshError:
    return MeshError(f"{problem}; give `landmarks`", parameter="landmarks")
