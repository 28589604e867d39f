"""Deformation gradients: rotation and stretch of each triangle from the neutral face (SDFA §3.4).

The gradient of triangle i is `T_i = R_i S_i`; a frame is packed as s (6N) and r (3N).
"""

from typing import Any, cast

import numpy as np

from rig.arrays import Float64
from rig.errors import MeshError, TopologyError
from rig.mesh.trimesh import TriMesh, degenerate_triangles, listed


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
            f"triangles {listed(flat)} of the neutral mesh have no area; "
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
    TopologyError
        If the vertex counts differ.
    """
    points = np.asarray(deformed, dtype=np.float64)
    if points.shape[-2:] != rest.vertices.shape:
        raise TopologyError(
            f"deformed vertices have shape {points.shape}; "
            f"they must end in {rest.vertices.shape}, the template's"
        )
    refuse_degenerate(rest)
    moved = triangle_frames(points, rest.faces)
    _refuse_collapsed(moved, rest.size)
    inverse = np.linalg.inv(triangle_frames(rest.vertices, rest.faces))
    return cast(Float64, moved @ inverse)


def _refuse_collapsed(moved: Float64, size: float) -> None:
    # |v4 - v1|^2 is twice the area.
    doubled_area = np.sum(moved[..., 2] ** 2, axis=-1)
    flat = doubled_area <= _COLLAPSED * size**2
    if not flat.any():
        return
    where = np.argwhere(flat)
    frame = f" of frame {int(where[0][0])}" if where.shape[1] > 1 else ""
    same = where[(where[:, :-1] == where[0][:-1]).all(axis=1)][:, -1]
    raise MeshError(
        f"triangles {listed(same)}{frame} collapse to no area; "
        "keep a small gap between vertices that meet, or remove those triangles"
    )


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
