"""Deformation gradients: rotation and stretch of each triangle from the neutral face (SDFA §3.4).

The gradient of triangle i is `T_i = R_i S_i`; a frame is packed as s (6N) and r (3N).
"""

from typing import Any, cast

import numpy as np

from rig.arrays import Float64
from rig.errors import MeshError, TopologyError
from rig.mesh.trimesh import TriMesh, degenerate_triangles, listed

# Rotations of many triangles at once: polar decomposition, logarithm, exponential (SDFA §3.4).
#
# Matrices are kept as nine arrays, one per entry ("struct of arrays", shape (3, 3, ...)), so that
# numpy works on long rows. `...` is any batch: triangles, or frames x triangles.

_NEWTON_STEPS = 40
_CYCLE = ((1, 2), (2, 0), (0, 1))


def polar(matrices: Any) -> tuple[Float64, Float64]:
    """Split each T into R S: a rotation and a symmetric stretch.

    SDFA §3.4 (after its refs. 19, 20), by Newton's iteration X <- (g X + X^-T / g) / 2 with the
    scale g that balances the norms of X and its inverse.

    Parameters
    ----------
    matrices : array [shape=(..., 3, 3)]
        T, with det T > 0. Gradients of Eq. 1-4 always are: the fourth vertex makes the
        determinant (area ratio)^1.5.

    Returns
    -------
    rotation, stretch : array [shape=(..., 3, 3)]

    Raises
    ------
    ValueError
        If some determinant is not positive.
    """
    t = entries(matrices)
    rotation = polar_rotation(t)
    stretch = np.empty_like(t)
    for i in range(3):
        for j in range(i, 3):
            # S = R^T T, symmetrised against rounding.
            one = sum(rotation[k, i] * t[k, j] for k in range(3))
            other = sum(rotation[k, j] * t[k, i] for k in range(3))
            stretch[i, j] = stretch[j, i] = 0.5 * (one + other)
    return matrix(rotation), matrix(stretch)


def polar_rotation(t: Float64) -> Float64:
    """Nearest rotation to each T, both as entries [shape=(3, 3, ...)]."""
    x = np.array(t, dtype=np.float64)
    tolerance = 8 * np.finfo(x.dtype).eps
    for _ in range(_NEWTON_STEPS):
        cofactors = _cofactors(x)
        determinant = sum(x[0, j] * cofactors[0, j] for j in range(3))
        if not np.all(determinant > 0):
            raise ValueError("polar needs matrices with a positive determinant")
        inverse_transposed = cofactors / determinant
        scale = np.sqrt(_norm(inverse_transposed) / _norm(x))
        step = 0.5 * (scale * x + inverse_transposed / scale)
        moved = float(np.max(np.abs(step - x), initial=0.0))
        x = step
        if moved <= tolerance:
            break
    return x


def _norm(x: Float64) -> Float64:
    return cast(Float64, np.sqrt(np.einsum("ij...,ij...->...", x, x)))


def _cofactors(x: Float64) -> Float64:
    result = np.empty_like(x)
    for i, (a, b) in enumerate(_CYCLE):
        for j, (c, d) in enumerate(_CYCLE):
            result[i, j] = x[a, c] * x[b, d] - x[a, d] * x[b, c]
    return result


def rotation_log(rotations: Any) -> Float64:
    """Rotation vector of each R: axis times angle, |r| <= pi radians.

    By way of the unit quaternion, whose largest entry is found first: accurate at every angle,
    where the arc cosine of the trace loses half its digits near 0 and pi.

    Parameters
    ----------
    rotations : array [shape=(..., 3, 3)]
        Orthogonal, det 1.

    Returns
    -------
    vectors : array [shape=(..., 3), radians]
    """
    r = entries(rotations)
    outer = _quaternion_outer(r)
    diagonal = np.stack([outer[k, k] for k in range(4)])
    largest = np.argmax(diagonal, axis=0)
    q = np.take_along_axis(outer, largest[None, None], axis=0)[0]
    q = q / np.sqrt(np.sum(q * q, axis=0))
    q = np.where(q[0] < 0, -q, q)
    sine = np.sqrt(np.sum(q[1:] * q[1:], axis=0))
    angle = 2.0 * np.arctan2(sine, q[0])
    factor = np.divide(angle, sine, out=np.full_like(angle, 2.0), where=sine > 0)
    return cast(Float64, np.moveaxis(factor * q[1:], 0, -1))


def _quaternion_outer(r: Float64) -> Float64:
    """Give 4 q q^T for each rotation [shape=(4, 4, ...)], q = (w, x, y, z)."""
    outer = np.empty((4, 4, *r.shape[2:]))
    outer[0, 0] = 1 + r[0, 0] + r[1, 1] + r[2, 2]
    outer[1, 1] = 1 + r[0, 0] - r[1, 1] - r[2, 2]
    outer[2, 2] = 1 - r[0, 0] + r[1, 1] - r[2, 2]
    outer[3, 3] = 1 - r[0, 0] - r[1, 1] + r[2, 2]
    for axis, (a, b) in enumerate(_CYCLE):
        outer[0, axis + 1] = outer[axis + 1, 0] = r[b, a] - r[a, b]
        outer[a + 1, b + 1] = outer[b + 1, a + 1] = r[b, a] + r[a, b]
    return outer


def rotation_exp(vectors: Any) -> Float64:
    """Rotation of each rotation vector [shape=(..., 3), radians] -> [shape=(..., 3, 3)].

    Rodrigues' formula (SDFA §3.4); any angle, beyond pi too.
    """
    components = np.moveaxis(np.asarray(vectors, dtype=np.float64), -1, 0)
    return matrix(exp_entries(components))


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


def unwrap(vectors: Any, reference: Any) -> Float64:
    """Of the vectors of the same rotation, the one nearest to a reference.

    r and r + 2 pi k axis are one rotation. Near pi the logarithm jumps from one end of the axis
    to the other (6.28 rad between frames of `mouthClose` on two rim triangles of the ICT face);
    unwrapped against the frame before, it runs on.

    Paper silent: SDFA §3.4 does not mention the ambiguity.

    Parameters
    ----------
    vectors : array [shape=(..., 3), radians]
        Rotation vectors of the logarithm.
    reference : array [shape=(..., 3), radians]
        The frame before, or the rest (zeros).

    Returns
    -------
    unwrapped : array [shape=(..., 3), radians]
    """
    r, ref = np.asarray(vectors, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    angle = np.linalg.norm(r, axis=-1, keepdims=True)
    # A rotation of no angle has every axis; it takes the reference's.
    still = angle < 1e-9
    direction = np.where(still, ref, r)
    length = np.linalg.norm(direction, axis=-1, keepdims=True)
    axis = np.divide(direction, length, out=np.zeros_like(direction), where=length > 0)
    along = np.sum(ref * axis, axis=-1, keepdims=True)
    turns = np.round((along - np.where(still, 0.0, angle)) / (2 * np.pi))
    return cast(Float64, r + 2 * np.pi * turns * axis)


def unwrap_sequence(vectors: Any, start: Any = None) -> Float64:
    """Unwrap frame after frame [shape=(T, N, 3), radians]; the first against `start` or rest."""
    frames = np.array(vectors, dtype=np.float64)
    before = np.zeros_like(frames[0]) if start is None else np.asarray(start, dtype=np.float64)
    for i in range(len(frames)):
        before = frames[i] = unwrap(frames[i], before)
    return frames


def entries(matrices: Any) -> Float64:
    """Turn (..., 3, 3) into contiguous entries (3, 3, ...)."""
    moved = np.moveaxis(np.asarray(matrices, dtype=np.float64), (-2, -1), (0, 1))
    return np.ascontiguousarray(moved)


def matrix(rows: Float64) -> Float64:
    """Turn entries (3, 3, ...) back into (..., 3, 3), a view."""
    return np.moveaxis(rows, (0, 1), (-2, -1))


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
        (`rig.deformation.gradients.unwrap`). False for single poses, and for training data,
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
