"""A triangle mesh with vertex colours, and the few operations the head needs on it."""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.arrays import Float64, Int64
from rig.face.identity import Identity

if TYPE_CHECKING:
    import scipy.sparse as sp

PLAIN, SKIN, HAIR, EYE, CLOTH = range(5)
"""Materials of `Mesh.kind`."""
WHITE_UV = (0.94, 0.94)
"""Where the atlas changes no colour."""
STRANDS_UV = (0.008, 0.008, 0.125)
"""Corner and side of the atlas's square of strands, which run along v."""
IRIS_UV = (0.867, 0.008, 0.125)
"""The same of the iris: u around it, v from pupil to rim."""


@dataclass(frozen=True)
class Maps:
    """Pictures of a head's surface, uint8, first row at v = 0; 128 changes nothing.

    `atlas` (A, A, 3) times two multiplies colours; `creases` (B, B, 4) tilts normals by its first
    three channels and darkens by the fourth (255 not at all), both by the accent of a vertex;
    `pores` (C, C, 2), repeated `PORES` times, varies the skin's colour and gloss.
    """

    atlas: NDArray[np.uint8]
    creases: NDArray[np.uint8]
    pores: NDArray[np.uint8]


PORES = 22.0
_FLAT = np.full((1, 1, 4), (128, 128, 128, 255), np.uint8)
NO_MAPS = Maps(_FLAT[..., :3], _FLAT, _FLAT[..., :2])


@dataclass(frozen=True)
class Mesh:
    """Vertices (V, 3) in cm, faces (N, 3) counter-clockwise seen from outside.

    `colors` (V, 3) are sRGB in 0..1; `gloss` (V,) in 0..1 is how much a vertex shines; `uv` (V, 2)
    are places in the maps; `light` (V, 2) in 0..1 is what the vertex gets of the ambient and of the
    first light; `kind` (V,) is its material.
    """

    vertices: Float64
    faces: Int64
    colors: Float64 = field(repr=False)
    gloss: Float64 = field(repr=False)
    uv: Float64 = field(default_factory=lambda: np.array(WHITE_UV), repr=False)
    light: Float64 = field(default_factory=lambda: np.ones(2), repr=False)
    kind: Int64 = field(default_factory=lambda: np.array(PLAIN), repr=False)
    maps: Maps = field(default=NO_MAPS, repr=False)

    def __post_init__(self) -> None:
        n = len(self.vertices)
        for name, shape in (("uv", (n, 2)), ("light", (n, 2)), ("kind", (n,))):
            object.__setattr__(self, name, np.broadcast_to(getattr(self, name), shape))


MESH_ARRAYS = ("vertices", "faces", "colors", "gloss", "uv", "light", "kind")


def join(meshes: list[Mesh]) -> Mesh:
    """Put meshes side by side in one, in order."""
    starts = np.cumsum([0] + [len(m.vertices) for m in meshes])
    faces = np.concatenate([m.faces + s for m, s in zip(meshes, starts, strict=False)])
    names = ("colors", "gloss", "uv", "light", "kind")
    rest: dict[str, Any] = {
        name: np.concatenate([getattr(m, name) for m in meshes]) for name in names
    }
    return Mesh(np.concatenate([m.vertices for m in meshes]), faces, **rest)


def painted(vertices: Float64, faces: Int64, color: ArrayLike, gloss: float = 0.2) -> Mesh:
    """Build a mesh of one colour, or of one colour a vertex."""
    n = len(vertices)
    return Mesh(
        vertices, faces, np.broadcast_to(np.asarray(color, float), (n, 3)).copy(), np.full(n, gloss)
    )


def mirrored(mesh: Mesh) -> Mesh:
    """The mesh mirrored at the plane x = 0, faces still counter-clockwise."""
    return replace(mesh, vertices=mesh.vertices * [-1, 1, 1], faces=mesh.faces[:, ::-1])


def grid_faces(rows: int, columns: int, *, closed: bool = True, start: int = 0) -> Int64:
    """Triangles of a (rows, columns) grid of vertices; `closed` joins last column to first."""
    i, j = np.meshgrid(
        np.arange(rows - 1), np.arange(columns if closed else columns - 1), indexing="ij"
    )
    a, b = i * columns + j, i * columns + (j + 1) % columns
    quad = np.stack([a, b, b + columns, a + columns], -1).reshape(-1, 4) + start
    return np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])


def adjacency(faces: Int64, n_vertices: int) -> "sp.csr_matrix":
    """Symmetric 0/1 matrix of the mesh's edges."""
    import scipy.sparse as sp

    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    one_way = sp.coo_matrix(
        (np.ones(len(edges)), (edges[:, 0], edges[:, 1])), (n_vertices, n_vertices)
    )
    both = (one_way + one_way.T).tocsr()
    both.data[:] = 1
    return both


def edge_counts(faces: Int64) -> tuple[Int64, Int64]:
    """Every edge (E, 2) once, and how many faces use it (2 inside a manifold, 1 on a border)."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), 1)
    unique, counts = np.unique(edges, axis=0, return_counts=True)
    return unique, counts


def vertex_normals(vertices: Float64, faces: Int64) -> Float64:
    """Unit normals (V, 3), the faces' cross products summed at their corners (area weights)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    corners = faces.T.ravel()
    total = np.stack(
        [
            np.bincount(corners, np.tile(cross[:, axis], 3), len(vertices))
            for axis in range(3)
        ],
        -1,
    )  # fmt: skip
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12))


def unit(vectors: Float64) -> Float64:
    """Vectors divided by their lengths along the last axis."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def smoothstep(x: Float64 | float) -> Float64:
    """0 below 0, 1 above 1, and a smooth cubic between."""
    clipped = np.clip(x, 0.0, 1.0)
    return np.asarray(clipped * clipped * (3 - 2 * clipped))


# The skull and flesh as a signed distance function, and rays that find its surface.
#
# Units are cm; +x is the character's left, +y up, +z forward; the eyes' centres are at y = 0.

CENTER = np.array([0.0, 0.0, 0.5])
"""The head is star-shaped around this point: every ray from it leaves the skin once."""


def ellipsoid(p: Float64, center: tuple[float, ...], radii: tuple[float, ...]) -> Float64:
    """Distance to an axis-aligned ellipsoid (first-order)."""
    q = (p - np.array(center)) / np.array(radii)
    length = np.linalg.norm(q, axis=-1)
    slope = np.linalg.norm(q / np.array(radii), axis=-1) + 1e-9
    return np.asarray(length * (length - 1) / slope)


def capsule(
    p: Float64, a: tuple[float, ...], b: tuple[float, ...], radius_a: float, radius_b: float
) -> Float64:
    """Distance to a capsule from `a` to `b` whose radius changes linearly."""
    start, axis = np.array(a), np.array(b) - np.array(a)
    h = np.clip(((p - start) @ axis) / (axis @ axis), 0, 1)
    return np.asarray(
        np.linalg.norm(p - start - h[..., None] * axis, axis=-1)
        - (radius_a + (radius_b - radius_a) * h)
    )


def blend(a: Float64, b: Float64, k: float) -> Float64:
    """Union of two shapes with a fillet of about `k` cm (polynomial smooth minimum)."""
    h = np.clip(0.5 + 0.5 * (b - a) / k, 0, 1)
    return b + (a - b) * h - k * h * (1 - h)


def carve(a: Float64, b: Float64, k: float) -> Float64:
    """Shape `a` without shape `b`, edges rounded by about `k` cm."""
    return -blend(-a, b, k)


def head_distance(points: Float64, identity: Identity) -> Float64:
    """Signed distance (negative inside) from points (..., 3) to the head without ears and lips."""
    p = points.copy()
    p[..., 0] = np.abs(p[..., 0])
    return _with_neck(_with_nose(_with_face(_skull(p, identity), p, identity), p, identity),
                      p, identity)  # fmt: skip


def _skull(p: Float64, i: Identity) -> Float64:
    d = ellipsoid(p, (0, 3.3, -0.9), (7.25 * i.skull_width, 8.3, 9.4))
    d = blend(d, ellipsoid(p, (0, 2.9, 3.0), (6.0 * i.skull_width, 5.5, 5.55)), 2.2)
    temple = ellipsoid(p, (8.6 * i.skull_width, 1.2, 5.4), (1.9, 2.6, 2.6))
    return carve(d, temple, 2.0)


def _with_face(d: Float64, p: Float64, i: Identity) -> Float64:
    drop = i.jaw_drop_cm
    w, jaw = i.face_width, i.jaw_width
    d = blend(d, ellipsoid(p, (0, -3.8, 1.8), (5.8 * w, 7.0, 6.45)), 2.4)
    corner = (4.65 * w * jaw, -6.6 - 0.4 * drop, -0.6)
    d = blend(d, capsule(p, corner, (1.5 * jaw, -9.6 - drop, 6.0), 1.05, 1.4), 2.6)
    chin = (0, -9.95 - drop, 7.3 + i.chin_forward_cm)
    d = blend(d, ellipsoid(p, chin, (2.1 * i.chin_width, 1.3, 1.65)), 1.5)
    cheek = (3.9 * w, -2.2, 4.7)
    d = blend(d, ellipsoid(p, cheek, (2.1 * i.cheek, 1.7 * i.cheek, 2.1 * i.cheek)), 2.2)
    d = blend(d, ellipsoid(p, (3.3 * w, -5.2, 4.3), (1.9, 2.2, 2.2)), 2.4)
    size = 0.62 + 0.14 * i.brow_ridge
    x = 1.2 * i.eye_spacing
    d = blend(d, capsule(p, (x, 1.5, 7.72), (4.4 * w, 1.9, 6.1), size, size), 1.6)
    d = blend(d, ellipsoid(p, (0, -7.1 + i.mouth_lift_cm, 6.1), (3.1 * w, 2.6, 2.75)), 1.8)
    return carve(d, ellipsoid(p, (3.0 * i.eye_spacing, 0.0, 9.35), (2.2, 1.3, 1.45)), 1.2)


def _with_nose(d: Float64, p: Float64, i: Identity) -> Float64:
    long, wide, high = i.nose_length, i.nose_width, i.nose_height
    tip_y, tip_z = -4.0 * long + i.nose_tip_up_cm, 9.45 + 0.65 * high
    bridge = capsule(p, (0, 0.9, 7.6 + 0.4 * high), (0, tip_y + 0.35, tip_z - 0.1), 0.5, 0.72)
    nose = blend(bridge, ellipsoid(p, (0, tip_y, tip_z), (0.85 * wide, 0.78, 0.85)), 0.55)
    wing = (1.02 * wide, -4.3 * long + 0.4 * i.nose_tip_up_cm, 8.95)
    nose = blend(nose, ellipsoid(p, wing, (0.66, 0.66, 0.95)), 0.6)
    column = capsule(p, (0, -4.95 * long, 8.9), (0, tip_y - 0.45, tip_z - 0.1), 0.32, 0.4)
    nose = blend(nose, column, 0.4)
    d = blend(d, nose, 0.85)
    d = blend(d, ellipsoid(p, (0, -5.8, 9.0), (0.4, 0.8, 0.3)), 0.4)
    return carve(d, capsule(p, (0, -5.4, 9.74), (0, -6.2, 9.62), 0.15, 0.16), 0.4)


def _with_neck(d: Float64, p: Float64, i: Identity) -> Float64:
    neck = capsule(p, (0, -6, -2.9), (0, -26, -4.6), 4.5 * i.neck_width, 5.3 * i.neck_width)
    d = blend(d, neck, 1.3)
    thin = min(i.neck_width / 0.8, 1.0) ** 2  # a child's neck shows no tendons
    sternal = capsule(p, (4.0 * i.neck_width, -8, -2.6), (1.2, -17, 1.2), 0.8 * thin, 0.9 * thin)
    return blend(d, sternal, 1.2)


def project(directions: Float64, identity: Identity, samples: int = 60) -> Float64:
    """Outermost point of the skin along each direction (n, 3) from `CENTER`.

    Steep downward rays are bent: their origin slides down the neck's axis and they turn
    horizontal, so that one formula covers the neck too.
    """
    bend = np.clip((-directions[:, 1] - 0.78) / 0.2, 0, 1) ** 1.3
    origin = CENTER + bend[:, None] * np.array([0, -15.5, -3.3])
    flat = np.stack([np.ones_like(bend), 1 - 0.97 * bend, np.ones_like(bend)], -1)
    ray = unit(directions * flat)
    return cast(origin, ray, identity, samples)


def cast(origin: Float64, ray: Float64, identity: Identity, samples: int = 60) -> Float64:
    """Outermost point of the skin along each ray (n, 3); `origin` is one (3,) or each ray's own."""
    start = np.broadcast_to(origin, ray.shape)
    t = np.linspace(1.0, 30.0, samples)
    inside = head_distance(start[:, None] + t[:, None] * ray[:, None], identity) < 0
    last = samples - 2 - np.argmax(inside[:, :-1][:, ::-1], axis=1)
    low, high = t[last], t[last + 1]
    for _ in range(22):
        middle = 0.5 * (low + high)
        is_inside = head_distance(start + middle[:, None] * ray, identity) < 0
        low, high = np.where(is_inside, middle, low), np.where(is_inside, high, middle)
    return np.asarray(start + (0.5 * (low + high))[:, None] * ray)
