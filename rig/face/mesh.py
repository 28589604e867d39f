"""A triangle mesh with its surface, and the few operations that a head needs on it."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Float64, Int64

PLAIN, SKIN, HAIR, EYE, CLOTH, FINE = range(6)
"""Materials of `Mesh.kind`; fine hair is brows, which lie on the skin."""
FINE_CM = 0.35
"""How much nearer than they are brows are drawn, so that the skin hides none."""


@dataclass(frozen=True)
class Maps:
    """Pictures of a head's surface, uint8, first row at v = 0.

    `atlas` (A, A, 4) has the sRGB colour, by which vertex colours are multiplied, and the share of
    the surface that is there; `creases` (B, B, 4) tilts normals by its first three channels (128:
    not) and darkens by the fourth (255: not), both by the accent of a vertex; `pores` (C, C, 3),
    repeated `PORES` times, varies the skin's colour and gloss by its first channel and tilts
    normals by the others (128: not).
    """

    atlas: NDArray[np.uint8]
    creases: NDArray[np.uint8]
    pores: NDArray[np.uint8]

    def atlas_for(self, side: float) -> NDArray[np.uint8]:
        """The atlas, or a smaller one that suffices where `side` texels are wanted."""
        return self.atlas


PORES = 30.0
NO_MAPS = Maps(
    np.full((2, 2, 4), 255, np.uint8),
    np.full((2, 2, 4), (128, 128, 128, 255), np.uint8),
    np.full((1, 1, 3), 128, np.uint8),
)


@dataclass(frozen=True)
class Mesh:
    """Vertices (V, 3) in cm, faces (N, 3) counter-clockwise seen from outside.

    `colors` (V, 3) are sRGB in 0..1; `gloss` (V,) in 0..1 is how much a vertex shines; `uv` (V, 2)
    are places in the maps; `light` (V, 2) in 0..1 is what the vertex gets of the ambient and of the
    first light; `kind` (V,) is its material; `weld` (V,) is the first vertex at the same point of
    the surface: where the picture has a seam, a point has several vertices.
    """

    vertices: Float64
    faces: Int64
    colors: Float64 = field(default_factory=lambda: np.ones(3), repr=False)
    gloss: Float64 = field(default_factory=lambda: np.array(0.2), repr=False)
    uv: Float64 = field(default_factory=lambda: np.zeros(2), repr=False)
    light: Float64 = field(default_factory=lambda: np.ones(2), repr=False)
    kind: Int64 = field(default_factory=lambda: np.array(PLAIN), repr=False)
    maps: Maps = field(default=NO_MAPS, repr=False)
    weld: Int64 = field(default_factory=lambda: np.zeros(0, np.int64), repr=False)

    def __post_init__(self) -> None:
        n = len(self.vertices)
        for name, shape in (
            ("colors", (n, 3)), ("gloss", (n,)), ("uv", (n, 2)), ("light", (n, 2)), ("kind", (n,)),
        ):  # fmt: skip
            object.__setattr__(self, name, np.broadcast_to(getattr(self, name), shape))
        if not len(self.weld):
            object.__setattr__(self, "weld", np.arange(n))

    def normals(self, vertices: Float64) -> Float64:
        """Unit normals (V, 3) of a pose of this mesh, without a seam."""
        return vertex_normals(vertices, self.weld[self.faces])[self.weld]


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
    return np.asarray(vectors / np.sqrt(np.einsum("...k,...k", vectors, vectors))[..., None])


def smoothstep(x: Float64 | float) -> Float64:
    """0 below 0, 1 above 1, and a smooth cubic between."""
    clipped = np.clip(x, 0.0, 1.0)
    return np.asarray(clipped * clipped * (3 - 2 * clipped))
