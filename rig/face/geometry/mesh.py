"""A triangle mesh with vertex colours, and the few operations the head needs on it."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from rig.arrays import Float64, Int64

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


def adjacency(faces: Int64, n_vertices: int) -> sp.csr_matrix:
    """Symmetric 0/1 matrix of the mesh's edges."""
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
