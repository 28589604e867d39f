"""The skull and flesh as a signed distance function, and rays that find its surface.

Units are cm; +x is the character's left, +y up, +z forward; the eyes' centres are at y = 0.
"""

import numpy as np

from rig.arrays import Float64
from rig.face.geometry.mesh import unit
from rig.face.identity import Identity

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
    corner = (4.1 * w * jaw, -6.0 - 0.4 * drop, 0.6)
    d = blend(d, capsule(p, corner, (1.5 * jaw, -9.6 - drop, 6.0), 0.95, 1.4), 2.4)
    chin = (0, -9.95 - drop, 7.3 + i.chin_forward_cm)
    d = blend(d, ellipsoid(p, chin, (2.1 * i.chin_width, 1.3, 1.65)), 1.5)
    cheek = (3.85 * w, -2.6, 5.05)
    d = blend(d, ellipsoid(p, cheek, (2.2 * i.cheek, 2.0 * i.cheek, 2.1 * i.cheek)), 2.0)
    size = 0.62 + 0.14 * i.brow_ridge
    x = 1.2 * i.eye_spacing
    d = blend(d, capsule(p, (x, 1.5, 7.72), (4.4 * w, 1.9, 6.1), size, size), 1.6)
    d = blend(d, ellipsoid(p, (0, -7.1 + i.mouth_lift_cm, 6.1), (3.1 * w, 2.6, 2.75)), 1.8)
    return carve(d, ellipsoid(p, (3.1 * i.eye_spacing, 0.0, 9.35), (2.2, 1.3, 1.45)), 1.2)


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
    neck = capsule(p, (0, -6, -2.2), (0, -26, -4.6), 4.6 * i.neck_width, 5.4 * i.neck_width)
    d = blend(d, neck, 1.4)
    thin = min(i.neck_width / 0.8, 1.0) ** 2  # a child's neck shows no tendons
    sternal = capsule(p, (4.0 * i.neck_width, -6.5, -1.2), (1.2, -17, 1.6), 0.8 * thin, 0.9 * thin)
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
