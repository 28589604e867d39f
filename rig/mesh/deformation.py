"""Deformation gradients of triangles, and vertices of them (SDFA §3.4-3.5, Eq. 5-6).

The gradient of triangle i is its rotation and stretch from the neutral face, `T_i = R_i S_i`; a
frame is packed as s (6N) and r (3N).

The fourth vertices are eliminated: the columns of Eq. 1's system that belong to them only hold
T n, which does not depend on the three real vertices. The rest is, per triangle, the gradient
within its plane, weighted by the root of its area:

    sum_i area_i | grad_i x - T_i |^2      over the free vertices x.

Paper silent: Eq. 6 is singular by one translation per connected component (nothing is pinned),
and its rows carry no weights, so that small dense triangles would count as much as large ones.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]

from rig.arrays import Float64, Int64
from rig.errors import MeshError, listed
from rig.mesh.trimesh import TriMesh, components, degenerate_triangles, triangle_areas

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def exp_entries(vectors: Float64) -> Float64:
    """Rodrigues' formula on entries: [shape=(3, ...)] -> [shape=(3, 3, ...)]."""
    x, y, z = vectors
    half = 0.5 * np.sqrt(x * x + y * y + z * z)
    # np.sinc(u) = sin(pi u) / (pi u), with its limit 1 at zero.
    sinc_half = np.sinc(half / np.pi)
    cos_half = np.cos(half)
    a = sinc_half * cos_half  # sin(t) / t
    b = 0.5 * sinc_half * sinc_half  # (1 - cos(t)) / t^2
    result = np.empty((3, 3, *x.shape))
    bx, by, bz = b * x, b * y, b * z
    ax, ay, az = a * x, a * y, a * z
    result[0, 0] = 1.0 - (by * y + bz * z)
    result[1, 1] = 1.0 - (bx * x + bz * z)
    result[2, 2] = 1.0 - (bx * x + by * y)
    xy, xz, yz = bx * y, bx * z, by * z
    result[0, 1], result[1, 0] = xy - az, xy + az
    result[0, 2], result[2, 0] = xz + ay, xz - ay
    result[1, 2], result[2, 1] = yz - ax, yz + ax
    return result


_COLLAPSED = 1e-14
"""A moved triangle counts as collapsed below this share of the mesh's squared size."""


def triangle_frames(vertices: Any, faces: Any) -> Float64:
    """Edges of each triangle with its fourth vertex, as columns (SDFA Eq. 1 and 3).

    v4 - v1 = n / sqrt(|n|), n = (v2 - v1) x (v3 - v1): as long as the root of twice the area, so
    that it grows as the edges do.

    Parameters
    ----------
    vertices : array [shape=(..., V, 3)]
        Positions, one mesh or many.
    faces : array [shape=(N, 3)]
        Vertex indices of each triangle.

    Returns
    -------
    frames : array [shape=(..., N, 3, 3)]
        Columns v2 - v1, v3 - v1, v4 - v1. The third is zero where a triangle has no area.
    """
    points, faces = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
    first = points[..., faces[:, 0], :]
    one, two = points[..., faces[:, 1], :] - first, points[..., faces[:, 2], :] - first
    normal = np.cross(one, two)
    root = np.sqrt(np.linalg.norm(normal, axis=-1, keepdims=True))
    third = np.divide(normal, root, out=np.zeros_like(normal), where=root > 0)
    return np.stack([one, two, third], axis=-1)


def refuse_degenerate(mesh: TriMesh) -> None:
    """Raise MeshError naming the triangles of `mesh` that have no area (no frame exists)."""
    flat = degenerate_triangles(mesh)
    if len(flat):
        raise MeshError(
            f"triangles {listed(flat, 8)} of the neutral mesh have no area; "
            "remove them (rig.mesh.without_degenerate) or merge their vertices"
        )


def deformation_gradients(rest: TriMesh, deformed: Any) -> Float64:
    """T_i = V~_i V_i^-1 for each triangle (SDFA Eq. 2-4).

    Parameters
    ----------
    rest : TriMesh
        The expressionless template.
    deformed : array [shape=(..., V, 3)]
        The moved vertices, in the template's order.

    Returns
    -------
    gradients : array [shape=(..., N, 3, 3)]
        det T > 0 for every triangle; the identity where nothing moved.

    Raises
    ------
    MeshError
        If triangles of the template have no area, or moved ones collapsed to none.
    """
    refuse_degenerate(rest)
    moved = triangle_frames(deformed, rest.faces)
    doubled_area = np.sum(moved[..., 2] ** 2, axis=-1)  # |v4 - v1|^2 is twice the area
    where = np.argwhere(doubled_area <= _COLLAPSED * rest.size**2)
    if len(where):
        frame = f" of frame {int(where[0][0])}" if where.shape[1] > 1 else ""
        same = where[(where[:, :-1] == where[0][:-1]).all(axis=1)][:, -1]
        raise MeshError(
            f"triangles {listed(same, 8)}{frame} collapse to no area; "
            "keep a small gap between vertices that meet, or remove those triangles"
        )
    inverse = np.linalg.inv(triangle_frames(rest.vertices, rest.faces))
    return cast(Float64, moved @ inverse)


def gradient_entries(stretch: Float64, turn: Float64) -> Float64:
    """Entries [shape=(3, 3, ...)] of R S from packed rows (6, ...) and (3, ...)."""
    rotation = exp_entries(np.ascontiguousarray(turn))
    xx, xy, xz, yy, yz, zz = np.ascontiguousarray(stretch)
    xx, yy, zz = xx + 1.0, yy + 1.0, zz + 1.0
    columns = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    result = np.empty_like(rotation)
    for i in range(3):
        a, b, c = rotation[i]
        for j, (p, q, w) in enumerate(columns):
            result[i, j] = a * p + b * q + c * w
    return result


MOST_SHARE = 0.2
"""A component with more than this share of the largest one's vertices is solved, not rigid."""
FRAMES_PER_SOLVE = 8
"""Right-hand sides go through the factors eight frames (24 columns) at a time, which stays in
the cache; hundreds at once take twice as long."""


@dataclass(frozen=True, eq=False)
class RigidPart:
    """A part that moves as one piece (eye, teeth) after the vertices it follows.

    Parameters
    ----------
    vertices : array [shape=(K,)]
        All vertices of the part; its triangles leave the system.
    follows : array [shape=(M,)]
        Vertices of the skin whose best rigid motion the part takes (chin for lower teeth, skull
        for upper). Empty: the part stays.
    """

    vertices: Int64
    follows: Int64


class DeformationSolver:
    """Factor the template's system once; solve any number of frames.

    Parameters
    ----------
    template : TriMesh
        The expressionless mesh.
    pins : array of int, optional
        Vertices whose positions are given to `solve`. A component without one gets its rearmost
        vertex (smallest z: scalp or neck of a face that looks along +z).
    parts : sequence of RigidPart
        Parts that are moved rigidly, not solved.

    Attributes
    ----------
    pins : array [shape=(P,)]
        The pinned vertices, ascending; `pin_positions` of `solve` come in this order.

    Raises
    ------
    MeshError
        If triangles of the template have no area.
    """

    def __init__(
        self, template: TriMesh, *, pins: Any = (), parts: Sequence[RigidPart] = ()
    ) -> None:
        from scipy.sparse import csc_array, csr_array

        refuse_degenerate(template)
        self.template = template
        self.parts = tuple(parts)
        in_part, free = np.zeros((2, len(template.vertices)), dtype=bool)
        for part in self.parts:
            in_part[part.vertices] = True
        self._solved = np.flatnonzero(~in_part[template.faces].any(axis=1))
        free[template.faces] = True
        free &= ~in_part
        given, labels = np.asarray(pins, dtype=np.int64), components(template)
        depth = np.where(free, template.vertices[:, 2], np.inf)
        unpinned = np.setdiff1d(labels[free], labels[given])
        rearmost = [np.argmin(np.where(labels == label, depth, np.inf)) for label in unpinned]
        self.pins: Int64 = np.unique(np.append(given, np.array(rearmost, dtype=np.int64)))
        free[self.pins] = False
        self._free = np.flatnonzero(free)

        faces = template.faces[self._solved]
        areas = triangle_areas(template)[self._solved]
        gradient = _gradient_operator(template.vertices, faces)
        weighted = csr_array(gradient.multiply(np.tile(areas, 3)[:, None]))
        free_rows = csr_array(weighted[:, self._free].T)
        self._right_hand = free_rows
        self._coupling = csr_array(free_rows @ gradient[:, self.pins])
        self._factors = factored(csc_array(free_rows @ gradient[:, self._free]))
        self._threads = ThreadpoolController()

    def solve(self, s: Any, r: Any, *, pin_positions: Any = None) -> Float64:
        """Vertices that best keep the packed gradients (Eq. 5-6).

        Parameters
        ----------
        s : array [shape=(T, 6 N)]
            Packed stretch, see `gradient_entries`.
        r : array [shape=(T, 3 N), radians]
            Packed rotation.
        pin_positions : array [shape=(T, P, 3) or (P, 3)], optional
            Where the pins are; the template's if not given.

        Returns
        -------
        vertices : array [shape=(T, V, 3)]
        """
        gradients = (
            gradient_entries(
                stretch.reshape(-1, 6)[self._solved].T.astype(np.float64),
                turn.reshape(-1, 3)[self._solved].T.astype(np.float64),
            )
            for stretch, turn in zip(s, r, strict=True)
        )
        return self._run(gradients, len(s), pin_positions)

    def solve_gradients(self, gradients: Float64, *, pin_positions: Any = None) -> Float64:
        """Vertices from whole gradients [shape=(T, N, 3, 3)]; else as `solve`."""
        each = (np.moveaxis(frame[self._solved], 0, -1) for frame in gradients)
        return self._run(each, len(gradients), pin_positions)

    def _run(self, gradients: Iterator[Float64], frames: int, pin_positions: Any) -> Float64:
        rest = self.template.vertices
        vertices = np.tile(rest, (frames, 1, 1))
        given = rest[self.pins] if pin_positions is None else np.asarray(pin_positions, np.float64)
        pins = np.broadcast_to(given, (frames, len(self.pins), 3))
        vertices[:, self.pins] = pins
        with self._threads.limit(limits=1, user_api="blas"):
            for start in range(0, frames, FRAMES_PER_SOLVE):
                stop = min(start + FRAMES_PER_SOLVE, frames)
                right = np.empty((stop - start, 3, len(self._free)))
                for rows, pinned in zip(right, pins[start:stop], strict=True):
                    self._assemble(next(gradients), pinned, rows)
                solution = self._factors.solve(right.reshape(-1, len(self._free)).T)
                vertices[start:stop, self._free] = solution.T.reshape(right.shape).swapaxes(1, 2)
        for part in [part for part in self.parts if len(part.follows)]:
            for frame in vertices:
                before, after = rest[part.follows], frame[part.follows]
                _, rotation, shift = similarity(before, after, is_rigid=True)
                frame[part.vertices] = rest[part.vertices] @ rotation.T + shift
        return vertices

    def _assemble(self, gradient: Float64, pins: Float64, out: Float64) -> None:
        """Right-hand side A^T c of one frame [shape=(3, free)], pins moved to this side."""
        for axis in range(3):
            out[axis] = self._right_hand @ np.ascontiguousarray(gradient[axis]).ravel()
        out -= (self._coupling @ pins).T


def factored(matrix: Any) -> Any:
    """Factors of a symmetric sparse matrix, whose `solve` takes right-hand sides."""
    from scipy.sparse.linalg import splu

    options = {"SymmetricMode": True}
    return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


def similarity(
    before: Any, after: Any, *, is_rigid: bool = False
) -> tuple[float, Float64, Float64]:
    """Scale, rotation and shift that best take points to points: `scale R x + shift`.

    Umeyama's closed form (1991); never a reflection. With `is_rigid` the scale is 1 (Kabsch).
    """
    a, b = np.asarray(before, dtype=np.float64), np.asarray(after, dtype=np.float64)
    centre_a, centre_b = a.mean(axis=0), b.mean(axis=0)
    u, stretch, vt = np.linalg.svd((b - centre_b).T @ (a - centre_a))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * signs) @ vt
    scale = 1.0 if is_rigid else float((stretch * signs).sum() / ((a - centre_a) ** 2).sum())
    return scale, rotation, centre_b - scale * rotation @ centre_a


def small_parts(template: TriMesh) -> list[RigidPart]:
    """Rigid parts for every component but the largest and those not small.

    Eyeballs, teeth and gums of most heads are components of their own. Each follows the skin
    vertices nearest to it (as many as it has itself, at least 12).

    Parameters
    ----------
    template : TriMesh
        The head with its eyes and teeth.
    """
    labels = components(template)
    sizes = np.bincount(labels)
    skin = np.flatnonzero(labels == 0)
    parts = []
    for label in range(1, len(sizes)):
        if not 4 <= sizes[label] <= MOST_SHARE * sizes[0]:
            continue
        own = np.flatnonzero(labels == label)
        distance = np.linalg.norm(
            template.vertices[skin] - template.vertices[own].mean(axis=0), axis=1
        )
        nearest = np.argsort(distance, kind="stable")[: max(12, len(own))]
        parts.append(RigidPart(own, skin[nearest]))
    return parts


def _gradient_operator(vertices: Float64, faces: Int64) -> "csr_array":
    """Sparse A: positions -> gradient within each triangle's plane [shape=(3 N, V)].

    Row a N + i holds derivative along axis a on triangle i: the rows of the pseudo-inverse of
    [v2 - v1, v3 - v1], with v1 taking what makes them sum to zero.
    """
    from scipy.sparse import coo_array, csr_array

    first = vertices[faces[:, 0]]
    spans = np.stack([vertices[faces[:, 1]] - first, vertices[faces[:, 2]] - first], axis=-1)
    inverse = np.linalg.pinv(spans)  # (N, 2, 3)
    weights = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)  # (N, 3, 3)
    n = len(faces)
    rows = np.arange(3)[None, None, :] * n + np.arange(n)[:, None, None]
    columns = np.broadcast_to(faces[:, :, None], (n, 3, 3))
    triplets = (weights.ravel(), (np.broadcast_to(rows, (n, 3, 3)).ravel(), columns.ravel()))
    return csr_array(coo_array(triplets, shape=(3 * n, len(vertices))))


def mesh_solver(template: TriMesh) -> DeformationSolver:
    """Solver of a template; its eyes and teeth, where it has them, move as single pieces."""
    return DeformationSolver(template, parts=small_parts(template))
