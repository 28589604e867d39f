"""Rotations of many triangles at once: polar decomposition, logarithm, exponential (SDFA §3.4).

Matrices are kept as nine arrays, one per entry ("struct of arrays", shape (3, 3, ...)), so that
numpy works on long rows. `...` is any batch: triangles, or frames x triangles.
"""

from typing import Any, cast

import numpy as np

from rig.arrays import Float64

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
