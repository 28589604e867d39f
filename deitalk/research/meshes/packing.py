"""Deformation gradients as numbers to learn: polar decomposition, logarithm, packing (SDFA §3.4).

Matrices are kept as nine arrays, one per entry ("struct of arrays", shape (3, 3, ...)), so that
numpy works on long rows. `...` is any batch: triangles, or frames x triangles.
"""

from typing import Any, cast

import numpy as np

from rig.arrays import Float64
from rig.errors import MeshError
from rig.mesh.deformation import deformation_gradients, exp_entries, gradient_entries
from rig.mesh.trimesh import TriMesh

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


def unwrap(vectors: Any, reference: Any) -> Float64:
    """Vector of the same rotation that is nearest to a reference.

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


def unwrap_sequence(vectors: Any) -> Float64:
    """Unwrap frame after frame [shape=(T, N, 3), radians]; the first against rest."""
    frames = np.array(vectors, dtype=np.float64)
    before = np.zeros_like(frames[0])
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


def pack(gradients: Any, *, continuous: bool = False) -> tuple[Float64, Float64]:
    """Split frames of gradients into packed stretch and rotation (SDFA §3.4).

    Parameters
    ----------
    gradients : array [shape=(T, N, 3, 3)] or [shape=(N, 3, 3)]
        T of each triangle, det T > 0.
    continuous : bool
        The frames follow one another: each rotation vector is taken nearest to the one before
        (`unwrap`). False for single poses, and for training data,
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
