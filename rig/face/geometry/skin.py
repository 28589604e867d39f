"""The skin: flesh surface, lips, mouth bag, lids and nostrils, as one 2-manifold."""

from dataclasses import dataclass, replace

import numpy as np

from rig.arrays import Float64, Int64
from rig.face.geometry import topology
from rig.face.geometry.mesh import CENTER, adjacency, edge_counts, project, smoothstep, unit
from rig.face.geometry.topology import (
    EYE_L,
    EYE_R,
    FACE_AXIS,
    FILLER,
    MOUTH,
    NECK_Y,
    NOSTRIL_L,
    NOSTRIL_R,
    Anatomy,
    Topology,
    anatomy,
    build_topology,
    directions_for,
)
from rig.face.identity import Identity

LIP_UPPER = np.array([-0.12, 0.03, 0.16, 0.20, 0.10, 0.0, 0, 0, 0, 0])
LIP_LOWER = np.array([-0.12, 0.06, 0.22, 0.27, 0.16, -0.04, -0.16, -0.11, -0.04, 0])
"""How far each mouth loop bulges forward of the muzzle at the middle of the lip, cm."""
BAG = np.array(
    [
        # depth, opening, narrowing, extra depth
        [-0.22, 0.04, 0.985, 0.00],
        [-0.50, 0.20, 0.965, 0.05],
        [-0.90, 0.60, 0.90, 0.20],
        [-1.9, 1.15, 0.82, 0.30],
        [-3.6, 1.45, 0.72, 0.10],
        [-6.6, 0.80, 0.40, 0.00],
    ]
)
"""The loops behind the lips' rim, from the wet side of the lip to the throat, cm."""
LID_LIFT = np.array([0.055, 0.13, 0.17, 0.17, 0.13, 0.08, 0.0])
LID_BLEND = np.array([1.0, 1.0, 0.94, 0.75, 0.46, 0.20, 0.05])
"""Lid thickness over the eyeball, and how much of each loop lies on the eyeball's sphere."""
LID_SHARE = np.array([1.0, 0.98, 0.86, 0.60, 0.32, 0.12, 0.0])
"""How far each loop of the eye turns about the eyeball with the rim."""
LID_MIDDLE_DEGREES, LID_UPPER_DEGREES = -2.5, 23.5
"""Middle of the open lids seen from the eyeball's centre, and the most of the upper rim: lids at
rest cover 1 to 2 mm of the iris above and touch its rim below (Farkas 1994)."""
UV_POWER = 0.62
CHIN_FOLD_CM = 0.26
"""Depth of the fold between lower lip and chin."""


@dataclass(frozen=True)
class Skin:
    """Neutral skin with the feature, loop and place of every vertex.

    `ring` is negative on the inside: mouth bag -1..-6 (-9 at its end), lid backs -1, nostrils
    -1..-2. `mirror` is each vertex's partner on the other side.
    """

    vertices: Float64
    faces: Int64
    kind: Int64
    ring: Int64
    slot: Int64
    mirror: Int64
    anatomy: Anatomy

    def loop(self, kind: int, ring: int) -> Int64:
        """Vertices of one loop in order around it."""
        chosen = np.flatnonzero((self.kind == kind) & (self.ring == ring))
        return chosen[np.argsort(self.slot[chosen])]

    def lip_rims(self) -> tuple[Int64, Int64]:
        """Opposing vertices of the upper and the lower lip's rim, from corner to corner."""
        rim = self.loop(MOUTH, 0)
        upper = np.arange(1, len(rim) // 2)
        return rim[upper], rim[len(rim) - upper]


def build_skin(identity: Identity) -> Skin:
    """Make the neutral skin of one identity."""
    topology = build_topology()
    vertices = project(directions_for(identity), identity)
    vertices = _smoothed(vertices, topology)
    skin = Skin(
        vertices, topology.faces, topology.kind, topology.ring, topology.slot,
        topology.mirror, anatomy(identity),
    )  # fmt: skip
    for step in (_with_chin_fold, _with_lips, _with_mouth_bag, _with_lids, _with_nostrils):
        skin = step(skin, identity)
    return _finished(skin)


def _smoothed(vertices: Float64, topology: Topology) -> Float64:
    """Taubin smoothing: removes the lumps between the primitives, keeps the volume."""
    graph = adjacency(topology.faces, len(vertices))
    degree = np.asarray(graph.sum(1))
    weight = np.where(topology.kind == FILLER, 0.5, 0.3)
    is_mouth = topology.kind == MOUTH
    weight[is_mouth] = np.interp(topology.ring[is_mouth], [0, 4, 9], [0, 0.1, 0.5])
    near_nose = np.hypot(vertices[:, 0], vertices[:, 1] + 4.4) < 1.9
    weight[near_nose & (vertices[:, 2] > 8.4)] *= 0.45
    y, z = vertices[:, 1], vertices[:, 2]
    below_chin = 0.5 * smoothstep((-9.2 - y) / 1.2) * smoothstep((z - 1.5) / 1.5)
    for passes, share in ((3, weight), (8, below_chin * (topology.kind == FILLER))):
        for factor in (0.55, -0.42) * passes:
            mean = (graph @ vertices) / degree
            vertices = vertices + 2 * factor * share[:, None] * (mean - vertices)
    return vertices


def _with_chin_fold(skin: Skin, identity: Identity) -> Skin:
    """Sink the fold between the lower lip and the chin, which gives the chin its profile."""
    vertices = skin.vertices.copy()
    x, y, z = vertices.T
    middle = skin.anatomy.mouth_y - 1.62 + 0.10 * x**2
    deep = np.exp(-(((y - middle) / 0.55) ** 2) - (x / 1.5) ** 2)
    is_lip = (skin.kind == MOUTH) & (skin.ring <= 3)
    vertices[:, 2] -= CHIN_FOLD_CM * deep * ((z > 4) & ~is_lip)
    return replace(skin, vertices=vertices)


def _with_lips(skin: Skin, identity: Identity) -> Skin:
    """Give the mouth's loops the profile of lips; the rims meet within 0.1 mm."""
    vertices = skin.vertices.copy()
    t = topology.angles(topology.MOUTH_COUNT)
    s, is_upper = np.sin(t), np.sin(t) >= 0
    fade = np.abs(s) ** 0.7
    full = 0.45 + 0.55 * identity.lip_fullness
    for k, offset in enumerate(topology.MOUTH_OFFSETS):
        row = skin.loop(MOUTH, k)
        bulge = np.where(is_upper, LIP_UPPER[k], LIP_LOWER[k]) * full
        vertices[row, 2] += bulge * fade - 0.13 * (1 - fade) * np.exp(-offset * 1.6)
    rim = skin.loop(MOUTH, 0)
    vertices[rim, :2] = topology.mouth_loop(0.0, identity)[:, :2]
    return replace(skin, vertices=vertices)


def _extend(skin: Skin, rows: list[Float64], kind: int, faces: list[Int64], tip_ring: int) -> Skin:
    """Append inner loops (`rows`) and one closing vertex to the skin."""
    count = len(rows[0])
    partner = (count // 2 - np.arange(count)) % count
    if kind != MOUTH:
        partner = np.arange(count)
    n, n_rows = len(skin.vertices), len(rows)
    ring = np.concatenate([np.repeat(-1 - np.arange(n_rows), count), [tip_ring]])
    slot = np.concatenate([np.tile(np.arange(count), n_rows), [0]])
    mirror = np.concatenate([n + k * count + partner for k in range(n_rows)])
    new = np.concatenate([*rows, rows[-1].mean(0, keepdims=True)])
    return replace(
        skin,
        vertices=np.concatenate([skin.vertices, new]),
        faces=np.concatenate([skin.faces, *faces]),
        kind=np.concatenate([skin.kind, np.full(len(new), kind)]),
        ring=np.concatenate([skin.ring, ring]),
        slot=np.concatenate([skin.slot, slot]),
        mirror=np.concatenate([skin.mirror, mirror, [n + n_rows * count]]),
    )


def _inner_faces(skin: Skin, rim: Int64, n_rows: int, flipped: bool) -> list[Int64]:
    """Strips from `rim` inwards over `n_rows` new loops, then a fan to the closing vertex."""
    start, count = len(skin.vertices), len(rim)
    tip, outer, parts = start + n_rows * count, rim, []
    for k in range(n_rows):
        inner = start + k * count + np.arange(count)
        a2, b2 = np.roll(outer, -1), np.roll(inner, -1)
        parts += [np.stack([outer, a2, inner], -1), np.stack([a2, b2, inner], -1)]
        outer = inner
    parts.append(np.stack([outer, np.roll(outer, -1), np.full(count, tip)], -1))
    return [p[:, ::-1] for p in parts] if flipped else parts


def _with_mouth_bag(skin: Skin, identity: Identity) -> Skin:
    """Fold the lips inwards into a closed bag that holds teeth and tongue."""
    rim = skin.loop(MOUTH, 0)
    s = np.sin(topology.angles(topology.MOUTH_COUNT))
    rows = []
    for depth, opening, narrow, extra in BAG:
        row = skin.vertices[rim].copy()
        row[:, 0] *= narrow
        row[:, 1] += np.where(s >= 0, opening, -1.05 * opening) * np.abs(s) ** 0.8
        row[:, 2] += depth - extra
        rows.append(row)
    return _extend(skin, rows, MOUTH, _inner_faces(skin, rim, len(rows), False), -9)


def _with_lids(skin: Skin, identity: Identity) -> Skin:
    """Lay the eye's loops on a sphere just larger than the eyeball and give lids a back."""
    place = skin.anatomy
    for kind, side in ((EYE_L, 1), (EYE_R, -1)):
        vertices = skin.vertices.copy()
        s = np.sin(topology.angles(topology.EYE_COUNT))
        for j, offset in enumerate(topology.EYE_OFFSETS):
            row = skin.loop(kind, j)
            outline = topology.lid_outline(offset, identity)
            radius = place.eye_radius + LID_LIFT[j]
            flat2 = (outline**2).sum(1)
            z = np.sqrt(np.maximum(radius**2 - flat2, 0.30**2))
            lid = np.concatenate([outline, z[:, None]], 1)
            lid = unit(lid) * np.maximum(np.linalg.norm(lid, axis=1, keepdims=True), radius)
            lid = (lid + place.eye) * [side, 1, 1]
            vertices[row] += LID_BLEND[j] * (lid - vertices[row])
            if j in (3, 4):  # the fold above the upper lid
                vertices[row, 2] -= (0.10 if j == 3 else 0.04) * np.clip(s, 0, 1)
        skin = _with_lids_at_rest(replace(skin, vertices=vertices), kind, side)
        skin = _with_lid_back(skin, kind, side)
    return skin


def _with_lids_at_rest(skin: Skin, kind: int, side: int) -> Skin:
    """Turn the lids down about the eyeball, so that the upper one covers the iris's rim."""
    center = skin.anatomy.eye * [side, 1, 1]
    t = topology.angles(topology.EYE_COUNT)
    rim = skin.vertices[skin.loop(kind, 0)] - center
    angle = np.degrees(np.arctan2(rim[:, 1], rim[:, 2]))
    upper, lower = angle[topology.EYE_COUNT // 4], angle[3 * topology.EYE_COUNT // 4]
    down = 0.5 * (upper + lower) - LID_MIDDLE_DEGREES
    close = np.maximum(upper - down - LID_UPPER_DEGREES, 0)
    turn = np.radians(down + close * np.sign(np.sin(t))) * np.abs(np.sin(t)) ** 0.6
    vertices = skin.vertices.copy()
    for ring, share in enumerate(LID_SHARE):
        row = skin.loop(kind, ring)
        x, y, z = (vertices[row] - center).T
        cos, sin = np.cos(share * turn), np.sin(share * turn)
        vertices[row] = center + np.stack([x, cos * y - sin * z, cos * z + sin * y], -1)
    return replace(skin, vertices=vertices)


def _with_lid_back(skin: Skin, kind: int, side: int) -> Skin:
    """One loop behind the lid's rim, so that the lid has a thickness; the socket stays open."""
    rim = skin.loop(kind, 0)
    center = skin.anatomy.eye * [side, 1, 1]
    back = center + (skin.vertices[rim] - center) * 0.965
    back[:, 2] -= 0.12
    back = center + unit(back - center) * np.maximum(
        np.linalg.norm(back - center, axis=1, keepdims=True), skin.anatomy.eye_radius + 0.01
    )
    count, n = len(rim), len(skin.vertices)
    inner = n + np.arange(count)
    a2, b2 = np.roll(rim, -1), np.roll(inner, -1)
    faces = np.concatenate([np.stack([rim, a2, inner], -1), np.stack([a2, b2, inner], -1)])
    other = n + count + np.arange(count) if kind == EYE_L else n - count + np.arange(count)
    return replace(
        skin,
        vertices=np.concatenate([skin.vertices, back]),
        faces=np.concatenate([skin.faces, faces if side > 0 else faces[:, ::-1]]),
        kind=np.concatenate([skin.kind, np.full(count, kind)]),
        ring=np.concatenate([skin.ring, np.full(count, -1)]),
        slot=np.concatenate([skin.slot, np.arange(count)]),
        mirror=np.concatenate([skin.mirror, other]),
    )


def _with_nostrils(skin: Skin, identity: Identity) -> Skin:
    """Sink a short closed tube into the underside of the nose on each side."""
    start = len(skin.vertices)
    for kind, side in ((NOSTRIL_L, 1), (NOSTRIL_R, -1)):
        rim = skin.loop(kind, 0)
        middle = skin.vertices[rim].mean(0)
        up = np.array([-0.10 * side, 0.75, -0.55])
        rows = [
            middle + (skin.vertices[rim] - middle) * shrink + up * depth
            for shrink, depth in ((0.84, 0.28), (0.66, 0.8))
        ]
        faces = _inner_faces(skin, rim, len(rows), side < 0)
        skin = _extend(skin, rows, kind, faces, -9)
    half = (len(skin.vertices) - start) // 2
    mirror = skin.mirror.copy()
    mirror[start : start + half] = start + half + np.arange(half)
    mirror[start + half :] = start + np.arange(half)
    return replace(skin, mirror=mirror)


def _finished(skin: Skin) -> Skin:
    """Level the neck's cut, make both halves mirror images, keep every lid off its eyeball."""
    vertices = skin.vertices.copy()
    edges, uses = edge_counts(skin.faces)
    border = np.unique(edges[uses == 1])
    neck = border[skin.kind[border] == FILLER]
    vertices[:, 1] = np.maximum(vertices[:, 1], NECK_Y)
    vertices[neck, 1] = NECK_Y
    vertices = 0.5 * (vertices + vertices[skin.mirror] * [-1, 1, 1])
    for kind, side in ((EYE_L, 1), (EYE_R, -1)):
        ids = np.flatnonzero(skin.kind == kind)
        lift = np.where(skin.ring[ids] < 0, 0.012, LID_LIFT[np.minimum(skin.ring[ids], 4)])
        center = skin.anatomy.eye * [side, 1, 1]
        away = vertices[ids] - center
        length = np.linalg.norm(away, axis=1)
        least = np.maximum(length, skin.anatomy.eye_radius + lift)
        vertices[ids] = center + away * (least / length)[:, None]
    return replace(skin, vertices=vertices)


def paint_skin(skin: Skin, identity: Identity) -> tuple[Float64, Float64]:
    """Vertex colours (V, 3) sRGB and gloss (V,): blush, lips, dark mouth, lid edges."""
    v, ring, kind = skin.vertices, skin.ring, skin.kind
    base = np.array(identity.skin)
    colors = np.tile(base, (len(v), 1))

    def mix(weight: Float64, color: Float64) -> None:
        colors[:] += weight[:, None] * (color - colors)

    x, y, z = np.abs(v[:, 0]), v[:, 1], v[:, 2]
    flush = base * [1.0, 0.78, 0.76]
    mix(0.26 * np.exp(-((x - 3.9) ** 2 + (y + 3.2) ** 2) / 4.5) * (z > 2), flush)
    mix(0.35 * np.exp(-(x**2 + (y + 4.1) ** 2) / 1.4) * (z > 8), flush)
    mix(0.25 * np.exp(-(x**2 + (y + 10.0) ** 2) / 1.6) * (z > 6), flush)
    is_mouth, is_eye = kind == MOUTH, (kind == EYE_L) | (kind == EYE_R)
    lips = np.array(identity.lips)
    mix(is_mouth * np.interp(ring, [-2, 0, 2, 3, 4], [0.9, 0.9, 0.85, 0.55, 0.0]), lips)
    mix(is_mouth * (ring < 0) * np.interp(-ring, [0, 1, 3, 5, 9], [0, 0.25, 0.85, 1, 1]),
        np.array([0.16, 0.035, 0.04]))  # fmt: skip
    mix(is_eye * np.interp(ring, [-1, 0, 1, 2], [0.85, 0.6, 0.10, 0]), base * [0.55, 0.36, 0.34])
    height = np.sin(topology.angles(topology.EYE_COUNT))[skin.slot % topology.EYE_COUNT]
    is_upper, is_lower = is_eye & (height > 0.1), is_eye & (height < -0.1)
    wet = is_lower * np.interp(ring, [-1, 0, 1], [0.7, 0.9, 0.0])
    mix(wet, 0.5 * base + [0.46, 0.36, 0.36])
    mix(is_upper * np.interp(ring, [-1, 0, 1], [0.8, 0.7, 0.0]), np.array(identity.hair) * 0.6)
    fold = np.interp(ring, [2, 3, 4], [0, 0.5, 0])  # of the upper lid
    mix(is_upper * fold, base * [0.62, 0.44, 0.40])
    is_nostril = (kind == NOSTRIL_L) | (kind == NOSTRIL_R)
    mix(is_nostril * np.interp(ring, [-3, -1, 0, 1, 2], [1, 1, 0.55, 0.15, 0]), base * 0.09)
    gloss = np.full(len(v), 0.25)
    gloss[is_mouth] = np.interp(
        ring[is_mouth], [-9, -3, -1, 0, 3, 5], [0.0, 0.02, 0.4, 0.5, 0.42, 0.25]
    )
    gloss[is_nostril & (ring < 1)] = 0.0
    gloss += (1 - gloss) * wet
    return colors, gloss


def skin_uv(skin: Skin) -> Float64:
    """Places (V, 2) in the atlas: around the face's axis, the face wider than the back of the head.

    The same for all identities. Inner surfaces have the places of their rims.
    """
    directions = build_topology().directions
    across = unit(np.cross([0, 1.0, 0], FACE_AXIS))
    upward = np.cross(FACE_AXIS, across)
    polar = np.arccos(np.clip(directions @ FACE_AXIS, -1, 1))
    turn = np.arctan2(directions @ upward, directions @ across)
    reach = 0.5 * (polar / np.pi) ** UV_POWER
    uv = np.empty((len(skin.vertices), 2))
    uv[: len(directions)] = 0.5 + reach[:, None] * np.stack([np.cos(turn), -np.sin(turn)], -1)
    inner = np.flatnonzero(skin.ring < 0)
    rims = {kind: skin.loop(kind, 0) for kind in np.unique(skin.kind[inner])}
    uv[inner] = [uv[rims[skin.kind[k]][skin.slot[k]]] for k in inner]
    return uv


def direction_points(points: Float64, identity: Identity) -> Float64:
    """Where the rays from the head's centre through `points` (n, 3) leave the flesh."""
    return project(unit(points - CENTER), identity)
