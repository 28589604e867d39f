"""Vertices and triangles of the skin: loops of mouth, eyes and nostrils, a filler between them.

They are those of ``topology.npz``, alike for all identities: the embedded mesh models and users'
corpora number their vertices by them, so that proportions may change and triangles may not. Loops
are joined by strips of quads. The filler was made once: Poisson-disc points on the sphere of
directions, dense at mouth, nose and chin, mirrored in x = 0, relaxed and triangulated by Delaunay.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from rig.arrays import Float64, Int64
from rig.face.geometry.mesh import CENTER, adjacency, project, unit
from rig.face.identity import Identity

FILLER, MOUTH, EYE_L, EYE_R, NOSTRIL_L, NOSTRIL_R = range(6)
FACE_AXIS = unit(np.array([0, -0.33, 0.94]))
NECK_Y = -15.6


@dataclass(frozen=True)
class Topology:
    """The skin's directions for the reference identity and its triangles.

    `kind`, `ring`, `slot` (V,) are for each vertex its feature, its loop
    (0 is the rim) and which place on the loop; `mirror` (V,) is the vertex on the other side.
    """

    directions: Float64
    faces: Int64
    kind: Int64
    ring: Int64
    slot: Int64
    mirror: Int64


@lru_cache(maxsize=1)
def build_topology() -> Topology:
    """Read the directions and triangles of all skins."""
    with np.load(Path(__file__).with_name("topology.npz"), allow_pickle=False) as stored:
        directions = stored["directions"]
        labels = [
            stored[name].astype(np.int64) for name in ("faces", "kind", "ring", "slot", "mirror")
        ]
    return Topology(directions, *labels)


def loop_directions(identity: Identity) -> list[tuple[int, Float64]]:
    """Every feature's kind and its loops (loops, count, 3), the order vertices are stored in."""
    eye, nostril = eye_directions(identity), nostril_directions(identity)
    flip = np.array([-1, 1, 1])
    return [
        (MOUTH, mouth_directions(identity)),
        (EYE_L, eye),
        (EYE_R, eye * flip),
        (NOSTRIL_L, nostril),
        (NOSTRIL_R, nostril * flip),
    ]


def directions_for(identity: Identity) -> Float64:
    """The topology's directions with the loops where `identity` has them.

    The filler follows the loops harmonically, so that triangles keep their shape.
    """
    import scipy.sparse as sp
    from scipy.sparse.linalg import splu

    topology = build_topology()
    rows = np.concatenate([r.reshape(-1, 3) for _, r in loop_directions(identity)])
    n, n_rows = len(topology.directions), len(rows)
    graph = adjacency(topology.faces, n)
    laplacian = sp.diags(np.asarray(graph.sum(1)).ravel()) - graph
    fixed = (np.arange(n) < n_rows) | (topology.directions[:, 2] < 0)
    shift = np.zeros((n, 3))
    shift[:n_rows] = rows - topology.directions[:n_rows]
    free = ~fixed
    matrix = laplacian.tocsr()
    shift[free] = splu(matrix[free][:, free].tocsc()).solve(
        -(matrix[free][:, fixed] @ shift[fixed])
    )
    return unit(topology.directions + shift)


# The curves around the mouth, the eyes and the nostrils that the mesh is built on.
#
# Every loop is a closed row of vertices. Its angle t starts at the side nearest the character's
# left (+x) for the mouth, at the outer corner for an eye, and runs over the top.


MOUTH_COUNT, EYE_COUNT, NOSTRIL_COUNT = 52, 36, 12
MOUTH_OFFSETS = np.array([0.0, 0.12, 0.28, 0.46, 0.66, 0.92, 1.25, 1.65, 2.1, 2.6])
"""Distance of each mouth loop from the rim, cm; 0 to 3 are the red of the lips."""
EYE_OFFSETS = np.array([0.0, 0.07, 0.18, 0.33, 0.52, 0.76, 1.04])
NOSTRIL_SCALES = np.array([1.0, 1.4, 1.85])
EYE_RADIUS = 1.50
MOUTH_HALF_WIDTH = 2.38


@dataclass(frozen=True)
class Anatomy:
    """Places that several parts need, for one identity (cm)."""

    eye: Float64
    eye_radius: float
    mouth_y: float
    mouth_half_width: float


def anatomy(identity: Identity) -> Anatomy:
    """Eye centre (left eye), eyeball radius, and where the lips meet."""
    radius = EYE_RADIUS * identity.eye_size
    eye = np.array([3.0 * identity.eye_spacing, 0.0, 6.2 - 0.6 * (radius - EYE_RADIUS)])
    mouth_y = -7.1 - 0.25 * identity.jaw_drop_cm + identity.mouth_lift_cm
    return Anatomy(eye, radius, mouth_y, MOUTH_HALF_WIDTH * identity.mouth_width)


def angles(count: int) -> Float64:
    """`count` equal steps around a loop, radians."""
    return np.arange(count) / count * 2 * np.pi


def lip_line(u: Float64, place: Anatomy) -> tuple[Float64, Float64]:
    """Height and depth of the closed mouth's line at u in -1 (right corner) .. 1 (left)."""
    y = place.mouth_y + 0.07 * np.sin(np.pi * u**2) - 0.03 * np.exp(-((u / 0.3) ** 2))
    return y + 0.09 * np.abs(u) ** 3, 9.7 - 1.45 * u**2


def mouth_loop(offset: float, identity: Identity) -> Float64:
    """Points (MOUTH_COUNT, 3) of the loop `offset` cm outside the lips' rim, before projection."""
    place = anatomy(identity)
    t = angles(MOUTH_COUNT)
    c, s = np.cos(t), np.sin(t)
    is_upper = s >= 0
    full = identity.lip_fullness if offset < 1 else 1 + (identity.lip_fullness - 1) * 0.4
    y, z = lip_line(np.clip(c, -1, 1), place)
    rise = np.interp(offset, [0, 0.46, 0.92, 2.6], [0.004, 0.60, 0.88, 1.40])
    fall = np.interp(offset, [0, 0.46, 0.92, 2.6], [0.004, 0.72, 1.15, 2.6])
    power = np.interp(offset, [0, 0.6, 2.6], [1.0, 0.95, 0.8])
    bow = np.interp(offset, [0, 0.46, 0.75, 1.3], [0, 0.13, 0.11, 0])
    peaks = 0.7 * np.exp(-(((np.abs(c) - 0.27) / 0.15) ** 2))
    notch = np.where(is_upper, bow * (peaks - np.exp(-((c / 0.14) ** 2))), 0)
    y = y + np.where(is_upper, rise, -fall) * full * np.abs(s) ** power + notch * full
    return np.stack([(place.mouth_half_width + 0.62 * offset) * c, y, z], -1)


def lid_outline(offset: float, identity: Identity) -> Float64:
    """Left eye: (EYE_COUNT, 2) x and y from the eye's centre of the loop `offset` cm out."""
    t = angles(EYE_COUNT)
    c, s = np.cos(t), np.sin(t)
    size, open_ = identity.eye_size, identity.eye_height
    x = (1.36 * size + 0.74 * offset) * c
    up = np.interp(offset, [0, 1.04], [0.66 * size * open_, 1.50])
    down = np.interp(offset, [0, 1.04], [0.46 * size * open_, 1.25])
    skew = 1 - 0.16 * c * np.exp(-2 * offset)
    arch = np.where(s >= 0, up * np.abs(s) ** 0.82 * skew, -down * np.abs(s) ** 0.95)
    tilt = np.tan(np.radians(identity.eye_tilt_degrees)) * x
    canthus = -0.10 * np.clip(-c, 0, 1) ** 8 * np.exp(-3 * offset)
    return np.stack([x, arch + tilt + canthus], -1)


def mouth_directions(identity: Identity) -> Float64:
    """Directions (loops, MOUTH_COUNT, 3) from `CENTER` of the mouth's loops."""
    aim = np.stack([mouth_loop(r, identity) for r in MOUTH_OFFSETS])
    for _ in range(4):  # slide along the skin to the heights of the outline
        hit = project(unit(aim - CENTER).reshape(-1, 3), identity)
        aim[..., 2] = hit[:, 2].reshape(aim.shape[:2])
    return unit(aim - CENTER)


def eye_directions(identity: Identity) -> Float64:
    """Directions (loops, EYE_COUNT, 3) from `CENTER` of the left eye's loops."""
    place = anatomy(identity)
    rows = []
    for r in EYE_OFFSETS:
        outline = lid_outline(r, identity)
        depth = np.full((EYE_COUNT, 1), 1.35 - 0.2 * r)
        rows.append(unit(np.concatenate([outline, depth], 1) + place.eye - CENTER))
    return np.stack(rows)


def nostril_directions(identity: Identity) -> Float64:
    """Directions (loops, NOSTRIL_COUNT, 3) from `CENTER` of the left nostril's loops."""
    t = angles(NOSTRIL_COUNT)
    long, wide = identity.nose_length, identity.nose_width
    y = -0.522 * long + 0.03 * identity.nose_tip_up_cm
    rows = []
    for k in NOSTRIL_SCALES:
        x = 0.0745 * wide + 0.0275 * wide * k * np.cos(t)
        height = y + 0.0225 * k * np.sin(t) + 0.10 * (x - 0.0745 * wide)
        rows.append(unit(np.stack([x, height, np.ones_like(t)], -1)))
    return np.stack(rows)
