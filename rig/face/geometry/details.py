"""Parts of a head beside its skin and hair: eyes, teeth and tongue, ears, shoulders."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from rig.arrays import Float64, Int64
from rig.face.geometry.mesh import (
    CLOTH,
    EYE,
    HAIR,
    IRIS_UV,
    SKIN,
    WHITE_UV,
    Mesh,
    grid_faces,
    join,
    mirrored,
    painted,
    project,
    smoothstep,
    unit,
)
from rig.face.geometry.skin import Skin
from rig.face.identity import Identity

PUPIL_DEGREES, IRIS_DEGREES = 10.5, 28.0
_RINGS = np.array([0, 0.3, 0.6, 0.85, 1.0, 1.02, 1.3, 1.6, 1.8, 1.93, 2.0, 2.05])
_COLUMNS = 40


def eyeball(identity: Identity, radius: float) -> tuple[Mesh, Float64]:
    """An eyeball around the origin that looks along +z, and its pupil shape.

    Returns
    -------
    mesh : Mesh
        Polar grid; rings fall on the edges of pupil and iris, so both are crisp.
    widen : ndarray [shape=(V, 3)], cm
        Displacement that makes the pupil half as wide again.
    """
    inner = np.interp(_RINGS, [0, 1, 2, 3], [0, PUPIL_DEGREES, IRIS_DEGREES, 60])
    polar = np.radians(np.concatenate([inner, np.linspace(32, 178, 14)]))
    grow = np.interp(_RINGS, [0, 1.02, 1.93, 3], [0, 0.5 * PUPIL_DEGREES, 0, 0])
    wide = polar + np.radians(np.concatenate([grow, np.zeros(14)]))
    vertices, widened = (_polar_grid(a, radius) for a in (polar, wide))
    degrees = np.repeat(np.degrees(polar), _COLUMNS)
    faces = grid_faces(len(polar), _COLUMNS)[:, ::-1]
    colors, gloss = _eye_colors(identity, degrees, np.tile(np.arange(_COLUMNS), len(polar)))
    turn = np.tile(np.arange(_COLUMNS) / _COLUMNS, len(polar))
    outward = np.clip((degrees - PUPIL_DEGREES) / (IRIS_DEGREES - PUPIL_DEGREES), 0, 1)
    u0, v0, side = IRIS_UV
    uv = np.stack([u0 + side * np.abs(1 - 2 * turn), v0 + side * outward], -1)
    return Mesh(vertices, faces, colors, gloss, uv, kind=np.array(EYE)), widened - vertices


def _polar_grid(polar: Float64, radius: float) -> Float64:
    turn = np.arange(_COLUMNS) / _COLUMNS * 2 * np.pi
    ring = np.sin(polar)[:, None]
    z = np.cos(polar)[:, None] * np.ones(_COLUMNS)
    return radius * np.stack([ring * np.cos(turn), ring * np.sin(turn), z], -1).reshape(-1, 3)


def _eye_colors(identity: Identity, degrees: Float64, column: Int64) -> tuple[Float64, Float64]:
    iris = 0.85 * np.array(identity.iris) + 0.02
    fleck = 1 + 0.16 * np.sin(column * 2.9) * np.sin(column * 1.3)
    stops = [0, PUPIL_DEGREES + 0.05, PUPIL_DEGREES + 0.3, 19, 26, IRIS_DEGREES, 29.1, 40, 55, 180]
    shades = np.array(
        [
            [0.015] * 3,
            [0.015] * 3,
            iris * 1.25,
            iris * 1.15,
            iris * 0.8,
            iris * 0.28,
            [0.76, 0.73, 0.72],
            [0.78, 0.73, 0.71],
            [0.76, 0.60, 0.56],
            [0.74, 0.45, 0.42],
        ]
    )
    colors = np.stack([np.interp(degrees, stops, shades[:, k]) for k in range(3)], -1)
    in_iris = (degrees > PUPIL_DEGREES + 0.1) & (degrees < IRIS_DEGREES - 0.5)
    colors[in_iris] *= fleck[in_iris, None]
    return np.clip(colors, 0, 1), np.full(len(degrees), 1.0)


LASHES_UPPER, LASHES_LOWER = 58, 26


def lashes(skin: Skin, kind: int, identity: Identity) -> tuple[Mesh, Int64, Float64]:
    """Single lashes along both lids: mesh, the rim vertex each hangs on, place 0..1.

    Places run from the inner corner (0) to the outer (1) of the eye; those of the lower lid are .5.
    """
    rim = skin.loop(kind, 0)
    side = 1 if skin.vertices[rim[0], 0] > 0 else -1
    half = len(rim) // 2
    meshes, roots, places = [], [], []
    for count, row, is_upper in (
        (LASHES_UPPER, rim[: half + 1][::-1], True),
        (LASHES_LOWER, np.r_[rim[half:], rim[0]], False),
    ):
        along = np.linspace(0.10 if is_upper else 0.25, 0.985, count)
        mesh = _fringe(skin.vertices[row], along, side, is_upper)
        meshes.append(painted(*mesh, np.array(identity.hair) * 0.35, 0.1))
        nearest = row[np.round(along * (len(row) - 1)).astype(int)]
        each = len(meshes[-1].vertices) // count
        roots.append(np.repeat(nearest, each))
        places.append(np.repeat(along if is_upper else np.full(count, 0.5), each))
    return replace(join(meshes), kind=np.array(HAIR)), np.concatenate(roots), np.concatenate(places)


def _fringe(row: Float64, along: Float64, side: int, is_upper: bool) -> tuple[Float64, Int64]:
    """Vertices and faces of lashes at places along a row of the lid's rim, both of their sides."""
    at = along * (len(row) - 1)
    root = np.stack([np.interp(at, np.arange(len(row)), row[:, k]) for k in range(3)], -1)
    jitter = np.random.default_rng(3 + is_upper).uniform(-1, 1, (2, len(along)))
    grow = np.sin(np.pi * np.clip(along * 0.92, 0, 1)) ** 0.5 * (0.55 + 0.45 * along)
    length = (0.50 if is_upper else 0.20) * grow * (1 + 0.18 * jitter[0])
    lean = side * (0.9 * (along - 0.42) + 0.12 * jitter[1])
    up = 0.20 if is_upper else -0.62
    way = unit(np.stack([lean, np.full(len(along), up), np.full(len(along), 0.85)], -1))
    curl = np.array([0, 0.42 if is_upper else -0.1, -0.12])
    t = np.array([0.0, 0.45, 1.0])
    line = root[:, None] + length[:, None, None] * (
        t[:, None] * way[:, None] + t[:, None] ** 2 * curl
    )
    thick = np.array([0.020, 0.012, 0.002])[:, None] * [1, 0, 0]
    strip = np.stack([line - thick, line + thick], 2).reshape(-1, 3)
    faces = np.concatenate([grid_faces(3, 2, closed=False, start=6 * k) for k in range(len(along))])
    return np.concatenate([strip, strip]), np.concatenate([faces, faces[:, ::-1] + len(strip)])


# Teeth, gums and tongue.


TOOTH = np.array([0.83, 0.77, 0.71])
GUM = np.array([0.66, 0.33, 0.33])
UPPER_WIDTHS = np.array([0.76, 0.60, 0.66, 0.60, 0.58, 0.74])
LOWER_WIDTHS = np.array([0.50, 0.54, 0.60, 0.60, 0.62, 0.76])
UPPER_HEIGHTS = np.array([0.50, 0.44, 0.49, 0.40, 0.38, 0.34])
LOWER_HEIGHTS = np.array([0.42, 0.42, 0.43, 0.42, 0.41, 0.40])
UPPER_BACK, LOWER_BACK = 0.58, 0.95
"""How far the middle of the front teeth lies behind the lips' rim, cm."""
UPPER_EDGE, LOWER_EDGE = -0.22, -0.24
"""Height of the incisors' biting edges below the line where the lips meet, cm."""
LIP_BACK, LIP_EDGE = 0.80, -0.36
"""The surface in front of the lower teeth that the lower lip rests on, stated likewise."""


def arch_point(s: Float64, lip_z: float, *, is_upper: bool) -> tuple[Float64, Float64]:
    """Find x and z of the dental arch at s in -1..1 (0 between the front teeth)."""
    width, depth = (2.06, 4.2) if is_upper else (1.84, 4.1)
    front = lip_z - (UPPER_BACK if is_upper else LOWER_BACK)
    return width * np.sin(s * 1.35), front - depth * (1 - np.cos(s * 1.35))


def _tooth(width: float, height: float, thickness: float) -> Mesh:
    """A rounded block around the origin, slightly narrower at the gum."""
    polar, turn = np.linspace(0.02, np.pi - 0.02, 9), np.arange(12) / 12 * 2 * np.pi
    ring = np.sin(polar)[:, None]
    ball = np.stack(
        [ring * np.cos(turn), np.cos(polar)[:, None] * np.ones(12), ring * np.sin(turn)], -1
    ).reshape(-1, 3)
    box = np.sign(ball) * np.abs(ball) ** 0.55 * [width / 2, height, thickness]
    return painted(box, grid_faces(9, 12), TOOTH, 0.55)


def dental_arch(mouth_y: float, lip_z: float, *, is_upper: bool) -> Mesh:
    """Twelve teeth and their gum, in place for a head whose lips meet at `mouth_y`, `lip_z`."""
    widths = UPPER_WIDTHS if is_upper else LOWER_WIDTHS
    heights = UPPER_HEIGHTS if is_upper else LOWER_HEIGHTS
    edge = mouth_y + (UPPER_EDGE if is_upper else LOWER_EDGE)
    up = 1 if is_upper else -1
    centers = (np.cumsum(widths) - widths / 2) / widths.sum() * 0.93
    parts = []
    for s, width, height in zip(centers, widths, heights, strict=True):
        tooth = _tooth(width * 1.02, height, 0.2 + 0.32 * s)
        x, z = arch_point(s, lip_z, is_upper=is_upper)
        x2, z2 = arch_point(s + 0.02, lip_z, is_upper=is_upper)
        yaw = np.arctan2(-(z2 - z), x2 - x)
        turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
        place = np.array([x, edge + up * height, z])
        vertices = tooth.vertices @ turn.T + place
        shade = _lip_shadow(vertices, edge, up, lip_z) * (1.0 if is_upper else 0.8)
        tooth = Mesh(vertices, tooth.faces, tooth.colors * shade[:, None], tooth.gloss)
        parts += [tooth, mirrored(tooth)]
    parts.append(_gum(edge + up * 0.98, lip_z, is_upper=is_upper))
    return join(parts)


def _lip_shadow(vertices: Float64, edge: float, up: int, lip_z: float) -> Float64:
    """Light (V,) that lips and cheeks leave to the teeth: least at the gums and at the back."""
    from_edge, behind = up * (vertices[:, 1] - edge), lip_z - vertices[:, 2]
    back = np.interp(behind, [0.6, 1.4, 2.8, 4.2], [1.0, 0.8, 0.45, 0.25])
    return np.asarray(back * np.interp(from_edge, [0.1, 0.8], [1.0, 0.72]))


def _gum(y: float, lip_z: float, *, is_upper: bool) -> Mesh:
    """A band that the teeth stand in, scalloped between them."""
    s, turn = np.linspace(-1.02, 1.02, 61), np.arange(10) / 10 * 2 * np.pi
    x, z = arch_point(s, lip_z, is_upper=is_upper)
    up = 1 if is_upper else -1
    height = y + 0.40 * np.sin(turn)[None] + up * 0.05 * np.cos(s * 19)[:, None] ** 2
    band = np.stack(
        [x[:, None] + 0 * turn, height, z[:, None] - 0.06 + 0.25 * np.cos(turn)[None]], -1
    )
    mesh = painted(band.reshape(-1, 3), grid_faces(61, 10), GUM, 0.6)
    return Mesh(mesh.vertices, mesh.faces, _darkened(mesh.colors, mesh.vertices), mesh.gloss)


def _darkened(colors: Float64, vertices: Float64) -> Float64:
    """Less light reaches deeper into the mouth."""
    shade = np.interp(vertices[:, 2], [3.5, 6.0, 8.2], [0.25, 0.6, 1.0])
    return colors * shade[:, None]


TONGUE_ROWS, TONGUE_COLUMNS = 26, 22
TONGUE_BACK, TONGUE_LENGTH = 1.30, 5.2


def tongue(mouth_y: float, lip_z: float) -> tuple[Mesh, Float64]:
    """The tongue at rest behind the lower teeth, and every vertex's place 0 (tip) .. 1 (root)."""
    s = np.linspace(0, 1, TONGUE_ROWS)
    turn = np.arange(TONGUE_COLUMNS) / TONGUE_COLUMNS * 2 * np.pi
    tip = np.sqrt(np.clip(1 - (1 - np.clip(s * 3.0, 0, 1)) ** 2, 0, 1))
    half_width = 0.002 + 1.48 * tip * (0.72 + 0.28 * np.clip(s * 2.2, 0, 1))
    half_height = 0.002 + 0.30 * tip + 0.34 * s
    height = mouth_y - 1.00 + 0.42 * np.sin(np.pi * np.clip(s * 1.05, 0, 1)) - 0.5 * s**2
    groove = -0.10 * np.exp(-((np.cos(turn) / 0.22) ** 2)) * (np.sin(turn) > 0)
    y = (
        height[:, None]
        + half_height[:, None] * np.sin(turn)
        + groove * np.clip(s * 4, 0, 1)[:, None]
    )
    z = np.broadcast_to((lip_z - TONGUE_BACK - TONGUE_LENGTH * s)[:, None], y.shape)
    vertices = np.stack([half_width[:, None] * np.cos(turn), y, z], -1).reshape(-1, 3)
    mesh = painted(
        vertices,
        grid_faces(TONGUE_ROWS, TONGUE_COLUMNS)[:, ::-1],
        np.array([0.84, 0.45, 0.46]),
        0.55,
    )
    colors = _darkened(mesh.colors, vertices + np.array([0, 0, 0.8]))
    return Mesh(vertices, mesh.faces, colors, mesh.gloss), np.repeat(s, TONGUE_COLUMNS)


# An ear: a relief over a disc of rings, and a skirt that sinks into the skull.


_EAR_COLUMNS, _EAR_RINGS = 48, 20
_EAR_WIDE, _EAR_TALL = 1.75, 2.95
"""Half the width and height, cm, where the outline is 1."""
_EAR_SKIRT = ((1.0, -0.16), (0.97, -0.28), (0.90, -0.42), (0.80, -0.62), (0.68, -1.0), (0.6, -1.6))
"""Radius and depth (cm) of the rings behind the rim."""
_ANTIHELIX = ((0.04, -0.50), (-0.24, -0.43), (-0.44, -0.22), (-0.47, 0.08), (-0.36, 0.34))
_CRURA = (
    ((-0.36, 0.34), (-0.26, 0.54), (-0.08, 0.72)),
    ((-0.36, 0.34), (-0.08, 0.36), (0.3, 0.32)),
)
_HELIX_ROOT = ((0.72, 0.24), (0.46, 0.10), (0.12, 0.02))
"""Ridges, as (forward, up) of a disc of radius 1."""


def _ridge(x: Float64, y: Float64, line: tuple[tuple[float, float], ...], wide: float) -> Float64:
    """1 on a line and 0 away from it."""
    nearest = np.full(x.shape, np.inf)
    for (x0, y0), (x1, y1) in pairwise(line):
        dx, dy = x1 - x0, y1 - y0
        t = np.clip(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy), 0, 1)
        nearest = np.minimum(nearest, (x - x0 - t * dx) ** 2 + (y - y0 - t * dy) ** 2)
    return np.asarray(np.exp(-nearest / wide**2))


def _bump(x: Float64, y: Float64, at: tuple[float, float], wide: float, tall: float) -> Float64:
    return np.asarray(np.exp(-(((x - at[0]) / wide) ** 2) - ((y - at[1]) / tall) ** 2))


def _ear_relief(radius: Float64, turn: Float64) -> Float64:
    """Height over the ear's plane, cm, at places of the disc; turn 0 front, pi/2 top, pi back."""
    x, y = radius * np.cos(turn), radius * np.sin(turn)
    degrees = np.degrees(turn)
    rolled = np.interp(
        degrees, [0, 20, 45, 170, 215, 250, 330, 360], [0.4, 1, 1, 0.9, 0.6, 0, 0, 0.4]
    )
    helix = rolled * np.exp(-(((radius - 0.90) / 0.085) ** 2))
    behind = np.interp(degrees, [40, 70, 190, 225], [0, 1, 1, 0])
    scapha = behind * np.exp(-(((radius - 0.74) / 0.085) ** 2))
    ridges = np.maximum(_ridge(x, y, _ANTIHELIX, 0.13), 0.8 * _ridge(x, y, _CRURA[0], 0.12))
    ridges = np.maximum(ridges, 0.75 * _ridge(x, y, _CRURA[1], 0.09))
    away = np.hypot((x - 0.16) / 0.60, (y + 0.08) / 0.50)
    bowl = smoothstep((1.12 - away) / 0.55)
    height = 0.26 * helix - 0.12 * scapha + 0.24 * ridges - 0.50 * bowl * (1 - 0.8 * ridges)
    height += 0.26 * bowl * _ridge(x, y, _HELIX_ROOT, 0.10)
    height += 0.50 * _bump(x, y, (0.62, -0.16), 0.17, 0.20)  # tragus
    height += 0.22 * _bump(x, y, (0.10, -0.55), 0.16, 0.11)  # antitragus
    height -= 0.16 * _bump(x, y, (0.40, -0.18), 0.13, 0.15)  # canal
    height += 0.06 * _bump(x, y, (0.0, -0.80), 0.35, 0.16)  # lobe
    return np.asarray(height - 0.20 * np.clip((radius - 0.90) / 0.1, 0, 1) ** 2)


def ear(identity: Identity) -> Mesh:
    """The left ear, its back sunk into the head."""
    rings = np.linspace(0.001, 1, _EAR_RINGS)
    skirt, depth = np.array(_EAR_SKIRT).T
    turn = np.arange(_EAR_COLUMNS) / _EAR_COLUMNS * 2 * np.pi
    outline = np.interp(
        np.degrees(turn),
        [0, 30, 60, 90, 120, 150, 180, 210, 240, 270, 300, 330, 360],
        [0.80, 0.88, 0.96, 1.0, 1.05, 1.06, 1.0, 0.92, 0.86, 0.91, 0.86, 0.79, 0.80],
    )
    outline = (outline + np.roll(outline, 1) + np.roll(outline, -1)) / 3
    radius = np.concatenate([rings, skirt])[:, None] * np.ones(_EAR_COLUMNS)
    relief = _ear_relief(*np.broadcast_arrays(rings[:, None], turn))
    height = np.concatenate([relief, relief[-1] + depth[:, None]])
    front = _EAR_WIDE * radius * outline * np.cos(turn)
    up = _EAR_TALL * radius * outline * np.sin(turn)
    local = np.stack([front, up, height], -1).reshape(-1, 3) * identity.ear_size
    yaw, roll = np.radians(24), np.radians(-9)
    forward = np.array([-np.sin(yaw), 0, np.cos(yaw)])
    outward = np.array([np.cos(yaw), 0, np.sin(yaw)])
    upward = np.array([0.0, 1.0, 0.0])
    lean_f = np.cos(roll) * forward + np.sin(roll) * upward
    lean_u = np.cos(roll) * upward - np.sin(roll) * forward
    # Just outside the side of the head, level with the nose.
    direction = np.array([[1.0, -0.14, -0.22]])
    on_skin = project(direction / np.linalg.norm(direction), identity)[0]
    center = np.asarray(on_skin + np.array([0.92, 0.0, -0.25]))
    vertices = center + local @ np.stack([lean_f, lean_u, outward])
    mesh = painted(vertices, grid_faces(len(radius), _EAR_COLUMNS), identity.skin, 0.2)
    # The bowl is darker, the rim redder.
    deep = np.interp(height, [-0.8, -0.45, -0.1, 0.1], [0.42, 0.68, 0.93, 1.02])
    deep[_EAR_RINGS:] = 0.85
    red = np.clip((radius - 0.6) / 0.4, 0, 1) * [[[0.0]], [[0.07]], [[0.07]]]
    colors = mesh.colors * deep.reshape(-1, 1) * (1 - red).reshape(3, -1).T
    uv = np.add(WHITE_UV, 0.03 * np.stack([front, up], -1).reshape(-1, 2) / 3)
    return Mesh(vertices, mesh.faces, np.clip(colors, 0, 1), mesh.gloss, uv, kind=np.array(SKIN))


# Shoulders in a shirt with a ribbed collar, which the neck stands in.


_BUST_COLUMNS = 144
_AXIS_Z = -3.1
"""Depth of the neck's middle where the collar is, cm."""
NECK_RADIUS = 5.25


def bust(identity: Identity) -> Mesh:
    """Collar and shoulders, from inside the collar down to the chest."""
    turn = (
        np.arange(_BUST_COLUMNS) / _BUST_COLUMNS * 2 * np.pi
    )  # 0 front, pi/2 the character's left
    c, s = np.cos(turn), np.sin(turn)
    neck = NECK_RADIUS * identity.neck_width
    high = -13.3 - 0.8 * c  # the collar lies lower in front
    rib = 0.045 * np.cos(turn * _BUST_COLUMNS / 3)
    rows = []
    for out, down in (
        (-0.25, 1.6),
        (0.10, 0.25),
        (0.30, 0.0),
        (0.62, 0.10),
        (0.85, 0.55),
        (0.95, 1.25),
    ):
        radius = neck + out + rib * (out > 0.2) + 0.55 * np.maximum(c, 0) ** 2
        rows.append(np.stack([radius * s, high - down, _AXIS_Z + radius * c], -1))
    half = 19.0 * (0.35 + 0.65 * identity.neck_width)
    for t in np.linspace(0.02, 1, 18):
        wide = neck + 1.0 + (half - neck - 1.0) * t
        deep = neck + 1.0 + (0.46 * half - neck - 1.0) * np.minimum(1.6 * t, 1)
        side = np.abs(s) ** 2.0
        slope = 3.6 * t**0.75 + 3.0 * smoothstep((t - 0.62) / 0.38) ** 2  # trapezius, then deltoid
        chest = 11.0 * t**1.15
        y = high * (1 - t) - 15.0 * t - 1.25 - (slope * side + chest * (1 - side))
        swell = 1 + 0.10 * np.maximum(c, 0) * np.sin(np.pi * np.minimum(t * 1.2, 1))
        rows.append(np.stack([wide * s, y, _AXIS_Z + 0.6 * t + deep * c * swell], -1))
    rows.append(rows[-1] * [1.02, 1, 1.04] - [0, 14, 0])
    vertices = np.concatenate(rows)
    color = np.array(identity.shirt)
    shade = np.repeat(
        np.interp(np.arange(len(rows)), [0, 2, 4, 5, 6, 8], [0.5, 0.9, 1.04, 0.94, 0.72, 1]),
        _BUST_COLUMNS,
    )
    return Mesh(
        vertices, grid_faces(len(rows), _BUST_COLUMNS)[:, ::-1], color * shade[:, None],
        np.full(len(vertices), 0.06), kind=np.array(CLOTH),
    )  # fmt: skip
