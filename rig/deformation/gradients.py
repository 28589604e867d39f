"""Deformation gradients: rotation and stretch of each triangle from the neutral face (SDFA §3.4).

The gradient of triangle i is `T_i = R_i S_i`; a frame is packed as s (6N) and r (3N).
"""

from typing import Any, cast

import numpy as np

from rig.arrays import Float64
from rig.deformation.rotations import exp_entries, polar, rotation_log, unwrap_sequence
from rig.errors import MeshError, TopologyError
from rig.mesh.trimesh import TriMesh, degenerate_triangles, listed

_UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Order of the six packed stretch entries: xx, xy, xz, yy, yz, zz."""

_FRAMES_AT_ONCE = 16
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


def pack(gradients: Any, *, continuous: bool = False) -> tuple[Float64, Float64]:
    """Split frames of gradients into packed stretch and rotation (SDFA §3.4).

    Parameters
    ----------
    gradients : array [shape=(T, N, 3, 3)] or [shape=(N, 3, 3)]
        T of each triangle, det T > 0.
    continuous : bool
        The frames follow one another: each rotation vector is taken nearest to the one before
        (`rig.deformation.rotations.unwrap`). False for single poses, and for training data,
        where one pose must always give the same numbers.

    Returns
    -------
    s : array [shape=(T, 6 N) or (6 N,)]
        S - I of each triangle as xx, xy, xz, yy, yz, zz. Zero where nothing is stretched.
    r : array [shape=(T, 3 N) or (3 N,), radians]
        Rotation vectors; |r_i| <= pi unless `continuous`.

    Notes
    -----
    Paper silent: whether s holds S or S - I. S - I keeps rest at zero and its digits in float16.
    """
    all_gradients = np.asarray(gradients, dtype=np.float64)
    single = all_gradients.ndim == 3
    frames = all_gradients[None] if single else all_gradients
    s = np.empty((len(frames), 6 * frames.shape[1]))
    turns = np.empty((len(frames), frames.shape[1], 3))
    for i, frame in enumerate(frames):  # one at a time stays in the cache: twice as fast
        rotation, stretch = polar(frame)
        s[i] = np.stack([stretch[..., a, b] - (a == b) for a, b in _UPPER], axis=-1).ravel()
        turns[i] = rotation_log(rotation)
    r = (unwrap_sequence(turns) if continuous else turns).reshape(len(frames), -1)
    return (s[0], r[0]) if single else (s, r)


def pack_vertices(
    rest: TriMesh, deformed: Any, *, continuous: bool = False
) -> tuple[Float64, Float64]:
    """Packed s and r of deformed meshes [shape=(T, V, 3)], a few frames at a time."""
    points = np.asarray(deformed)
    parts = [
        pack(deformation_gradients(rest, points[i : i + _FRAMES_AT_ONCE]))
        for i in range(0, len(points), _FRAMES_AT_ONCE)
    ]
    s, r = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    if continuous:
        r = unwrap_sequence(r.reshape(len(r), -1, 3)).reshape(r.shape)
    return s, r


def unpack(s: Any, r: Any) -> Float64:
    """T = R S from packed rows.

    Parameters
    ----------
    s : array [shape=(..., 6 N)]
        Packed S - I.
    r : array [shape=(..., 3 N), radians]
        Packed rotation vectors.

    Returns
    -------
    gradients : array [shape=(..., N, 3, 3)]
    """
    s, r = np.asarray(s, dtype=np.float64), np.asarray(r, dtype=np.float64)
    if s.shape[:-1] != r.shape[:-1] or s.shape[-1] % 6 or s.shape[-1] != 2 * r.shape[-1]:
        raise MeshError(
            f"s has shape {s.shape} and r {r.shape}; they must be (..., 6 N) and (..., 3 N)"
        )
    products = gradient_entries(
        np.moveaxis(s.reshape(*s.shape[:-1], -1, 6), -1, 0),
        np.moveaxis(r.reshape(*r.shape[:-1], -1, 3), -1, 0),
    )
    return np.moveaxis(products, (0, 1), (-2, -1))


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
