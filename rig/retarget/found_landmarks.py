"""Landmarks of a neutral face, found by laying the embedded head over it.

The head is tried in the usual orientations and several sizes, fitted rigidly, then loosely; its
landmarks are read off. The mouth is then found exactly: lips are vertices near in space and far
along the surface.
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import KDTree

from rig.arrays import Bool, Float64, Int64
from rig.errors import MeshError
from rig.mesh.closest import ClosestPoints
from rig.mesh.deformation import similarity
from rig.mesh.trimesh import TriMesh, boundary_edges, largest_part, vertex_normals
from rig.retarget.landmarks import nearest
from rig.retarget.registration import Rounds, closest_rounds, edge_lengths

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


def guess_landmarks(mesh: TriMesh, source: TriMesh, landmarks: dict[str, int]) -> dict[str, int]:
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
    skin, chosen = largest_part(source)
    if len(mesh.vertices) < _FEWEST_VERTICES:
        raise _unrecognised(f"{len(mesh.vertices)} vertices are too few for a face")
    marks = {name: int(np.searchsorted(chosen, v)) for name, v in landmarks.items()}
    target, used = largest_part(mesh)
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
    return {name: int(used[v]) for name, v in found.items()}


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

    def matches(placed: Float64) -> tuple[Float64, Int64, Bool]:
        """Distance and number of each front vertex's nearest point, and whether both face alike."""
        distance, there = nearest(tree, placed[front])
        cosine = np.einsum("vc,vc->v", our_normals[front], normals[there])
        return distance, there, np.asarray(cosine > 0.3)

    for size in _SIZES:
        scale = size * width / our_width
        placed = scale * (ours - our_nose) + nose
        for _ in range(_STEPS):
            distance, there, facing = matches(placed)
            near = facing & (distance <= np.quantile(distance, 0.85))
            if near.sum() < 20 or len(np.unique(there[near])) < 4:  # shrunk to a point
                break
            scale, rotation, shift = similarity(ours[front[near]], points[there[near]])
            placed = scale * ours @ rotation.T + shift
        distance, _, facing = matches(placed)
        cost = float(np.mean(np.minimum(distance / scale, 2.0) + 1.0 * ~facing))
        if cost < best[0]:
            best = (cost, placed)
    return (*best, axes)


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
    distance, _ = nearest(KDTree(loop), mesh.vertices)
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
