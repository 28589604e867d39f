"""A triangle mesh, checked once when it is made.

Space is right-handed, y up, the face looks along +z, the subject's left
is +x (the convention of glTF); the unit is the file's own.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.arrays import AnyFloat, Float32, Float64, Int64
from rig.errors import MeshError, TopologyError, listed
from rig.limits import COORDINATE, SEQUENCE_BYTES, TRIANGLES, VERTICES

if TYPE_CHECKING:
    from scipy.sparse import csr_array

DEGENERATE_AREA = 1e-12
"""A triangle is degenerate below this share of the squared diagonal of the mesh's box."""


@dataclass(frozen=True, eq=False)
class TriMesh:
    """Vertices and triangles.

    Parameters
    ----------
    vertices : array [shape=(V, 3)]
        Positions, finite; kept as float64.
    faces : array [shape=(N, 3)]
        Vertex indices of each triangle, counter-clockwise seen from outside; kept as int64.

    Raises
    ------
    MeshError
        If a shape is wrong, a coordinate is not finite, or there are too many elements.
    TopologyError
        If an index points outside the vertices or a triangle names a vertex twice.
    """

    vertices: Float64
    faces: Int64

    def __post_init__(self) -> None:
        vertices = np.array(self.vertices, dtype=np.float64)
        faces = np.array(self.faces)
        _check_shapes(vertices, faces)
        faces = faces.astype(np.int64)
        count = len(vertices)
        if faces.min() < 0 or faces.max() >= count:
            outside = np.flatnonzero(((faces < 0) | (faces >= count)).any(axis=1))
            raise TopologyError(
                f"triangles {listed(outside, 8)} name vertices outside 0..{count - 1}; "
                "the file is cut short or its indices are wrong"
            )
        a, b, c = faces.T
        doubled = (a == b) | (b == c) | (c == a)
        if doubled.any():
            raise TopologyError(
                f"triangles {listed(np.flatnonzero(doubled), 8)} name a vertex twice; remove them"
            )
        vertices.setflags(write=False)
        faces.setflags(write=False)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)

    @cached_property
    def size(self) -> float:
        """Diagonal of the bounding box, the reference length of tolerances."""
        return float(np.linalg.norm(np.ptp(self.vertices, axis=0)))

    def with_vertices(self, vertices: Any) -> "TriMesh":
        """Return the same triangles over other positions [shape=(V, 3)]."""
        return TriMesh(vertices, self.faces)

    def flipped(self) -> "TriMesh":
        """Return the mesh with every triangle turned over."""
        return TriMesh(self.vertices, self.faces[:, ::-1])

    def compact(self) -> tuple["TriMesh", Int64]:
        """Drop vertices no triangle uses.

        Returns
        -------
        mesh : TriMesh
        used : array [shape=(V',)]
            Old index of each vertex that stayed, ascending.
        """
        used = np.flatnonzero(np.bincount(self.faces.ravel(), minlength=len(self.vertices)))
        if len(used) == len(self.vertices):
            return self, used
        place = np.zeros(len(self.vertices), np.int64)
        place[used] = np.arange(len(used))
        return TriMesh(self.vertices[used], place[self.faces]), used


def _check_shapes(vertices: Float64, faces: NDArray[Any]) -> None:
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise MeshError(f"vertices have shape {vertices.shape}; they must be (V, 3)")
    if faces.ndim != 2 or faces.shape[1] != 3 or not np.issubdtype(faces.dtype, np.integer):
        raise MeshError(
            f"faces have shape {faces.shape} and type {faces.dtype}; they must be (N, 3) integers"
        )
    if len(faces) == 0:
        raise MeshError("the mesh has no triangles; export the surface, not points or curves")
    if len(vertices) > VERTICES or len(faces) > TRIANGLES:
        raise MeshError(
            f"{len(vertices)} vertices and {len(faces)} triangles; at most {VERTICES} vertices and "
            f"{TRIANGLES} triangles are read: decimate the mesh"
        )
    is_usable = np.abs(vertices) <= COORDINATE
    if not is_usable.all():
        bad = np.flatnonzero(~is_usable.all(axis=1))
        raise MeshError(
            f"vertices {listed(bad, 8)} are not finite numbers within ±{COORDINATE:g}; export the "
            "mesh again"
        )


def check_length(frames: int, vertices: int, *, most: int = SEQUENCE_BYTES) -> None:
    """Refuse a sequence whose float32 positions take more than `most` bytes.

    Raises
    ------
    MeshError
        Naming frames, vertices and size.
    """
    size = 12 * frames * vertices
    if size > most:
        raise MeshError(
            f"{frames} frames of {vertices} vertices are {size / 2**30:.1f} GiB, at most "
            f"{most / 2**30:g} are made; cut the recording, or write curves, which stay small"
        )


def cross_products(mesh: TriMesh) -> Float64:
    """Give each triangle's (v2 - v1) x (v3 - v1) [shape=(N, 3)], twice its area long."""
    a, b, c = (np.take(mesh.vertices, mesh.faces[:, k], axis=0).T for k in range(3))
    (x, y, z), (u, v, w) = b - a, c - a
    product: Float64 = np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)
    return product


def triangle_areas(mesh: TriMesh) -> Float64:
    """Area of each triangle [shape=(N,), squared unit of the mesh]."""
    areas: Float64 = 0.5 * np.linalg.norm(cross_products(mesh), axis=1)
    return areas


def triangle_normals(mesh: TriMesh) -> Float64:
    """Unit normal of each triangle [shape=(N, 3)]; zero where the triangle has no area."""
    return _unit(cross_products(mesh))


def vertex_normals(mesh: TriMesh) -> Float64:
    """Area-weighted unit normal at each vertex [shape=(V, 3)]; zero at unused vertices."""
    return _unit(_corner_sums(mesh.faces, cross_products(mesh), len(mesh.vertices)))


def _corner_sums(faces: Int64, products: Float64, count: int) -> Float64:
    """Sum [shape=(count, 3)] of the faces' products at each of their corners."""
    corners = faces.T.ravel()
    sums = [np.bincount(corners, np.tile(axis, 3), count) for axis in products.T]
    return np.stack(sums, axis=1)


class MovedNormals:
    """Normals of one mesh in many poses that each move a part of it.

    Attributes
    ----------
    rest : array [shape=(V, 3)]
        `vertex_normals` of the mesh.

    Parameters
    ----------
    mesh : TriMesh
        At rest.
    """

    def __init__(self, mesh: TriMesh) -> None:
        products, count = cross_products(mesh), len(mesh.vertices)
        sums = _corner_sums(mesh.faces, products, count)
        self.rest = _unit(sums)
        # Coordinates and corners each in a row of their own, which is faster.
        self._vertices, self._sums, self._products = (
            np.ascontiguousarray(array.T, np.float32) for array in (mesh.vertices, sums, products)
        )
        self._faces = np.ascontiguousarray(mesh.faces.T)
        # Faces of each vertex (most, V), filled up with a face that is none.
        corners = mesh.faces.ravel()
        order, faces = np.argsort(corners, kind="stable"), np.bincount(corners, minlength=count)
        at = np.arange(len(order)) - np.repeat(np.cumsum(faces) - faces, faces)
        self._faces_of = np.full((faces.max(), count), len(mesh.faces))
        self._faces_of[at, corners[order]] = order // 3
        self._place = np.zeros(count, np.int64)

    def turn(self, moving: Int64, delta: Float32) -> tuple[Int64, Float32]:
        """Vertices (n,) whose faces move with `moving` by `delta`, and the change (n, 3) there.

        Vertices of no face do not move. Changes are exact to 1e-4.
        """
        is_touched = np.zeros(self._faces.shape[1] + 1, bool)
        is_touched[np.take(self._faces_of, moving, axis=1)] = True
        touched = np.flatnonzero(is_touched[:-1])
        corners: Int64 = np.take(self._faces, touched, axis=1)
        is_turned = np.zeros(len(self._place), bool)
        is_turned[corners] = True
        turned = np.flatnonzero(is_turned)
        self._place[turned] = np.arange(len(turned))
        corners = np.take(self._place, corners)
        is_used = is_turned[moving]
        place, delta = self._place[moving[is_used]], delta[is_used]
        sides = []
        for axis, by in zip(self._vertices, delta.T, strict=True):
            posed = np.take(axis, turned)
            posed[place] += by
            first, second, third = np.take(posed, corners)
            sides.append((second - first, third - first))
        (x, u), (y, v), (z, w) = sides
        sums = np.empty((3, len(turned)))
        for axis, product in enumerate((y * w - z * v, z * u - x * w, x * v - y * u)):
            product -= np.take(self._products[axis], touched)
            sums[axis] = np.bincount(corners.ravel(), np.tile(product, 3), len(turned))
            sums[axis] += np.take(self._sums[axis], turned)
        change = _unit(sums.T) - np.take(self.rest, turned, axis=0)
        return turned, change.astype(np.float32)


def _unit(vectors: AnyFloat) -> Float64:
    lengths = np.sqrt(np.einsum("...c,...c->...", vectors, vectors))
    return np.asarray(vectors / np.where(lengths > 0, lengths, 1)[..., None])


def degenerate_triangles(mesh: TriMesh) -> Int64:
    """Indices of triangles without area (less than `DEGENERATE_AREA` of the size squared)."""
    found: Int64 = np.flatnonzero(triangle_areas(mesh) <= DEGENERATE_AREA * mesh.size**2)
    return found


def without_degenerate(mesh: TriMesh) -> TriMesh:
    """Return the mesh without its triangles of no area; vertices keep their indices."""
    keep = np.ones(len(mesh.faces), dtype=bool)
    keep[degenerate_triangles(mesh)] = False
    return TriMesh(mesh.vertices, mesh.faces[keep])


def edges(faces: Int64) -> Int64:
    """Directed edges of every triangle, corner by corner [shape=(3 N, 2)]."""
    joined: Int64 = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return joined


def adjacency(mesh: TriMesh) -> "csr_array":
    """Symmetric 0/1 matrix of neighbouring vertices [shape=(V, V)]."""
    from scipy.sparse import coo_array, csr_array

    ends = edges(mesh.faces)
    count = len(mesh.vertices)
    ones = np.ones(2 * len(ends))
    rows, columns = np.concatenate([ends, ends[:, ::-1]]).T
    matrix = csr_array(coo_array((ones, (rows, columns)), shape=(count, count)))
    matrix.data[:] = 1.0
    return matrix


def components(mesh: TriMesh) -> Int64:
    """Number each vertex's connected part [shape=(V,), 0 is the part with most vertices].

    A vertex no triangle uses is a part of its own.
    """
    from scipy.sparse.csgraph import connected_components

    count, labels = connected_components(adjacency(mesh), directed=False)
    order = np.argsort(-np.bincount(labels, minlength=count), kind="stable")
    rank = np.empty(count, dtype=np.int64)
    rank[order] = np.arange(count)
    numbered: Int64 = rank[labels]
    return numbered


def largest_part(mesh: TriMesh) -> tuple[TriMesh, Int64]:
    """Return the connected part with most vertices, and their indices in the mesh, ascending."""
    on_it = components(mesh)[mesh.faces[:, 0]] == 0
    return TriMesh(mesh.vertices, mesh.faces[on_it]).compact()


def boundary_edges(mesh: TriMesh) -> Int64:
    """Edges that one triangle alone has [shape=(E, 2)], directed as in that triangle."""
    directed = edges(mesh.faces)
    _, inverse, counts = np.unique(
        np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    rim: Int64 = directed[counts[inverse.ravel()] == 1]
    return rim
