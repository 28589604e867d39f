"""Pictures of the skin, drawn from places on it: colour, creases and pores.

All are functions of the rest position and of seeded noise; `Maps` says what their values mean.
Letters: A texels along a side.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from rig.arrays import Bool, Float64
from rig.face.geometry.hair import HAIR_AXIS, brow_place, rise
from rig.face.geometry.mesh import (
    IRIS_UV,
    STRANDS_UV,
    Maps,
    Mesh,
    adjacency,
    smoothstep,
    unit,
    vertex_normals,
)
from rig.face.geometry.skin import Skin
from rig.face.geometry.topology import MOUTH
from rig.face.identity import Identity
from rig.face.render.shading import TO_LIGHT

ATLAS, CREASES, TILE = 1024, 512, 256
Picture = NDArray[np.uint8]


def build_maps(skin: Skin, uv: Float64, identity: Identity) -> Maps:
    """Draw the maps of one identity; `uv` (V, 2) from `rig.face.geometry.skin.skin_uv`."""
    rng = np.random.default_rng(19)
    return Maps(_atlas(skin, uv, identity, rng), _creases(skin, uv), _pores(rng))


def _places(skin: Skin, uv: Float64, side: int) -> tuple[Float64, Float64, Bool]:
    """What each texel shows: position (A, A, 3), how much of it is lip, whether it is skin."""
    from rig.face.render.software import Screen, front_faces, nearest_faces, planes

    x, y = (side * uv.T).astype(np.float32)
    screen = Screen(side, side, x, y, np.zeros(len(uv), np.float32))
    outer = skin.faces[(skin.ring[skin.faces] >= 0).all(1)]
    faces = front_faces(screen, outer)
    nearest, _ = nearest_faces(screen, faces)
    is_mouth = skin.kind == MOUTH
    lip = np.where(is_mouth, np.interp(skin.ring, [2, 3, 4], [1.0, 0.6, 0.0]), 0.0)
    first, per_x, per_y = planes(screen, faces, np.c_[skin.vertices, lip].astype(np.float32))
    row, column = np.indices((side, side)) + 0.5
    corner = faces[nearest, 0]
    shown = first[nearest] + per_x[nearest] * (column - x[corner])[..., None]
    shown = shown + per_y[nearest] * (row - y[corner])[..., None]
    return shown[..., :3], np.clip(shown[..., 3], 0, 1), nearest >= 0


def _noise(rng: np.random.Generator, side: int, width: float) -> Float64:
    """Smooth noise (A, A) that repeats, of mean 0 and standard deviation 1."""
    field = gaussian_filter(rng.standard_normal((side, side)), width, mode="wrap")
    return np.asarray((field - field.mean()) / field.std())


def _coded(values: Float64) -> Picture:
    """Factors around 1 as the atlas stores them."""
    return np.clip(np.round(127.5 * values), 0, 255).astype(np.uint8)


def _atlas(skin: Skin, uv: Float64, identity: Identity, rng: np.random.Generator) -> Picture:
    place, lip, is_skin = _places(skin, uv, ATLAS)
    x, y, z = np.moveaxis(place, -1, 0)
    far, front = np.abs(x), smoothstep(z / 3)
    mouth_y = skin.anatomy.mouth_y
    patches, blotches = _noise(rng, ATLAS, 22), _noise(rng, ATLAS, 7)
    fine, grain = _noise(rng, ATLAS, 2.2), _noise(rng, ATLAS, 0.8)
    light = 1 + 0.010 * patches + 0.010 * blotches + 0.010 * fine
    red = 0.5 * _noise(rng, ATLAS, 30) + 0.5 * _noise(rng, ATLAS, 9)
    color = np.repeat(light[..., None], 3, 2)
    color *= 1 + np.clip(red, -2, 2)[..., None] * np.array([0.004, -0.014, -0.013])
    fair = np.clip((np.mean(identity.skin) - 0.45) / 0.25, 0, 1)
    spots = smoothstep((_noise(rng, ATLAS, 1.7) - 1.55) / 0.5)
    on_cheeks = np.exp(-((y + 2.6) ** 2) / 4 - (far - 2.2) ** 2 / 9) * front
    freckles = 0.24 * identity.freckles * fair * spots * (0.15 + on_cheeks)
    color *= 1 - freckles[..., None] * np.array([0.5, 0.9, 1.2])
    socket = np.exp(-(((far - skin.anatomy.eye[0]) / 1.9) ** 2) - ((y + 1.25) / 0.75) ** 2)
    color *= 1 - (0.07 * socket * front)[..., None] * np.array([0.7, 1.0, 0.75])
    grows = _beard(far, y, z, mouth_y) * (1 - lip)
    hairs = smoothstep((_noise(rng, ATLAS, 0.55) - 1.3 + 1.7 * grows) / 1.5) * grows
    stubble = identity.beard * (0.42 * grows + 0.40 * hairs)
    color *= 1 - stubble[..., None] * np.array([0.66, 0.60, 0.54])
    lines = np.sin(17 * x + 2.2 * blotches) * np.sin(7 * x + 0.7 * patches)
    color *= 1 + (lip * (0.075 * lines + 0.03 * fine))[..., None]
    edge = 0.30 * _under_brow(far, y, identity) * front
    hair = np.minimum(np.divide(identity.hair, identity.skin), 1.0)
    color *= 1 - edge[..., None] * (1 - hair)
    scalp = smoothstep(
        (rise(unit(place - HAIR_AXIS).reshape(-1, 3)).reshape(x.shape) + 0.035) / 0.11
    )
    color *= 1 - (scalp * (0.55 + 0.08 * np.clip(grain, -2, 2)))[..., None] * (1 - hair)
    color[~is_skin] = 1.0
    atlas = _coded(color)
    for (u, v, wide), swatch in ((STRANDS_UV, _strands(rng)), (IRIS_UV, _iris(rng))):
        a, b, n = round(v * ATLAS) - 4, round(u * ATLAS) - 4, round(wide * ATLAS) + 8
        padded = np.pad(swatch, ((4, 4), (4, 4)), "edge")[:n, :n]
        atlas[max(a, 0) : a + n, max(b, 0) : b + n] = _coded(padded)[
            max(-a, 0) :, max(-b, 0) :, None
        ]
    return atlas


def _beard(far: Float64, y: Float64, z: Float64, mouth_y: float) -> Float64:
    """Where stubble grows, 0..1: jaw, chin, lip and sideburns."""
    cheek = mouth_y + 1.5 + 0.55 * np.maximum(far - 3.2, 0) ** 1.4 + np.exp(-((far / 1.7) ** 2))
    jaw = smoothstep((cheek - y) / 1.6) * smoothstep((y + 14.5) / 2.5) * smoothstep((z + 1.5) / 2)
    bare = np.exp(-(((far - 3.4) / 0.9) ** 2) - ((y - mouth_y - 0.6) / 1.2) ** 2)
    return np.asarray(jaw * (1 - 0.6 * bare))


def _under_brow(far: Float64, y: Float64, identity: Identity) -> Float64:
    """Colour between the hairs of a brow, 0..1."""
    s = np.linspace(0, 1, 80)
    x, middle, half = brow_place(s, identity)
    at = np.interp(far, x, s, left=-0.2, right=1.2)
    away = (y - np.interp(far, x, middle)) / np.interp(far, x, np.maximum(half, 0.12))
    ends = smoothstep((at + 0.02) / 0.10) * smoothstep((1.02 - at) / 0.2)
    return np.asarray(np.exp(-(np.abs(away) ** 3)) * ends)


def _strands(rng: np.random.Generator) -> Float64:
    """Hair along v, (n, n)."""
    n = round(STRANDS_UV[2] * ATLAS)
    rows = gaussian_filter(rng.standard_normal((n, n)), (26, 0.7))
    coarse = gaussian_filter(rng.standard_normal((n, n)), (40, 2.6))
    field = rows / rows.std() + 0.8 * coarse / coarse.std()
    return np.asarray(np.clip(1 + 0.17 * field, 0.4, 1.6))


def _iris(rng: np.random.Generator) -> Float64:
    """Fibres from the pupil (v = 0) to the rim, (n, n)."""
    n = round(IRIS_UV[2] * ATLAS)
    v = np.linspace(0, 1, n)[:, None]
    fibres = gaussian_filter(rng.standard_normal((n, n)), (18, 0.9))
    collar = 0.28 * np.exp(-(((v - 0.30 - 0.04 * _noise(rng, n, 5)) / 0.10) ** 2))
    inside = smoothstep(v / 0.08) * smoothstep((1 - v) / 0.12)
    return np.asarray(1 + inside * (0.30 * fibres / fibres.std() + collar - 0.05))


def _pores(rng: np.random.Generator) -> Picture:
    """Colour and gloss (C, C, 2) of a square that repeats."""
    pits = smoothstep((_noise(rng, TILE, 4.0) - 0.7) / 1.1)
    cells = 0.5 * _noise(rng, TILE, 2.2) + 0.5 * _noise(rng, TILE, 6.0)
    color = 1 - 0.55 * pits + 0.16 * cells
    gloss = 1 - 0.75 * pits + 0.30 * cells
    both = np.stack([color / color.mean(), gloss / gloss.mean()], -1)
    return _coded(both)


def _creases(skin: Skin, uv: Float64) -> Picture:
    """Tilt of the normals and depth (B, B, 4) of all creases at their full depth."""
    place, _, is_skin = _places(skin, uv, CREASES)
    is_front = is_skin & (place[..., 2] > 1)
    x, y = np.abs(place[..., 0]), place[..., 1]
    step = 0.02
    height = _grooves(x, y, skin)
    along_x = (_grooves(x + step, y, skin) - height) / step
    along_y = (_grooves(x, y + step, skin) - height) / step
    tilt = np.stack([-along_x * np.sign(place[..., 0]), -along_y, 0 * x], -1)
    tilt *= 0.9 / np.maximum(np.linalg.norm(tilt, axis=-1, keepdims=True), 0.9)
    shade = 1 - 0.34 * np.clip(-height / 0.11, 0, 1)
    coded = np.concatenate([127.5 * (1 + tilt), 255 * shade[..., None]], -1)
    coded[~is_front] = (127.5, 127.5, 127.5, 255)
    return np.round(coded).astype(np.uint8)


def _groove(away: Float64, width: float, fade: Float64) -> Float64:
    """Height of a furrow between two soft ridges, cm."""
    bottom = np.exp(-((away / width) ** 2))
    ridges = np.exp(-(((np.abs(away) - 2.1 * width) / (1.1 * width)) ** 2))
    return np.asarray(fade * width * (0.36 * ridges - 0.8 * bottom))


def _grooves(x: Float64, y: Float64, skin: Skin) -> Float64:
    """Depth of the face's creases at places of its left half, cm; negative inside."""
    eye_x, eye_r = skin.anatomy.eye[0], skin.anatomy.eye_radius
    mouth_y = skin.anatomy.mouth_y
    height = np.zeros_like(x)
    for k, base in enumerate((3.35, 4.25, 5.15, 6.0)):  # forehead
        line = base + 0.16 * np.sin(1.1 * x + k) - 0.012 * x**2
        fade = smoothstep((4.9 - 0.25 * k - x) / 1.6) * (1.0 - 0.12 * k)
        height += _groove(y - line, 0.14, fade)
    knit = 0.52 + 0.10 * np.maximum(y - 1.2, 0)  # glabella
    height += _groove(x - knit, 0.12, smoothstep((y - 0.5) / 0.6) * smoothstep((2.9 - y) / 0.8))
    height += _groove(y - 0.45 - 0.25 * x, 0.10, 0.8 * smoothstep((0.8 - x) / 0.4))
    outer = x - eye_x - eye_r - 0.25  # crow's feet
    for slope in (0.62, 0.18, -0.22, -0.62):
        fade = smoothstep(outer / 0.35) * smoothstep((1.75 - outer) / 0.7)
        height += _groove(y - slope * (outer + 0.35) + 0.15, 0.085, fade)
    bag = -1.62 + 0.16 * (x - eye_x) ** 2  # under the lower lid
    height += _groove(y - bag, 0.10, 0.7 * smoothstep((1.7 - np.abs(x - eye_x)) / 0.9))
    down = np.clip((-3.6 - y) / (-3.6 - mouth_y + 0.8), 0, 1.2)  # nasolabial
    fold = 1.62 + 1.75 * down**0.85
    fade = smoothstep((-3.3 - y) / 0.8) * smoothstep((y - mouth_y + 1.3) / 1.2)
    return height + _groove(x - fold, 0.30, 0.62 * fade)


# Light that hair, nose, chin and shoulders keep from a head at rest, found from depth pictures.

SIDE, REACH_CM, BIAS_CM = 420, 24.0, 0.14
DIRECTIONS, KEY_SPREAD, KEY_SAMPLES = 40, 0.16, 10
SMOOTHINGS, LEAST_AMBIENT = 3, 0.25
"""Rounds of means of neighbours, and the ambient light of places that see no sky."""


def occlusion(mesh: Mesh) -> Float64:
    """Share (V, 2) of the ambient and of the first light that reaches each vertex, 0..1."""
    normals = vertex_normals(mesh.vertices, mesh.faces)
    i = np.arange(DIRECTIONS) + 0.5
    polar, turn = np.arccos(1 - 2 * i / DIRECTIONS), np.pi * (1 + 5**0.5) * i
    sky = np.stack([np.sin(polar) * np.cos(turn), np.cos(polar), np.sin(polar) * np.sin(turn)], -1)
    rng = np.random.default_rng(5)
    key = unit(TO_LIGHT[0] + KEY_SPREAD * rng.standard_normal((KEY_SAMPLES, 3)))
    seen = np.zeros((len(normals), 2))
    total = np.full((len(normals), 2), 1e-6)
    for directions, column in ((sky, 0), (key, 1)):
        for direction in directions:
            cosine = np.maximum(normals @ direction, 0)
            weight = cosine * (1 + direction[1]) if column == 0 else np.ones(len(cosine))
            seen[:, column] += weight * _lit(mesh, normals, direction)
            total[:, column] += weight
    share = seen / total
    near = adjacency(mesh.faces, len(share))
    for _ in range(SMOOTHINGS):
        share = 0.5 * share + 0.5 * (near @ share) / np.maximum(near.sum(1), 1).reshape(-1, 1)
    share = np.asarray(share)
    share[:, 0] = LEAST_AMBIENT + (1 - LEAST_AMBIENT) * share[:, 0]
    return np.asarray(share)


def _lit(mesh: Mesh, normals: Float64, direction: Float64) -> Float64:
    """Whether nothing lies between each vertex and a far light, 0..1."""
    from rig.face.render.software import Screen, nearest_faces

    right = unit(np.cross([0.0, 1.0, 0.01], direction))
    frame = np.stack([right, np.cross(direction, right), direction])
    x, y, z = frame @ (mesh.vertices - [0, -4, 0]).T
    scale = SIDE / (2 * REACH_CM)
    at = ((x * scale + SIDE / 2), (SIDE / 2 - y * scale), 60.0 - z)
    screen = Screen(SIDE, SIDE, *(values.astype(np.float32) for values in at))
    a, b, c = mesh.faces.T
    area = (at[0][b] - at[0][a]) * (at[1][c] - at[1][a]) - (at[1][b] - at[1][a]) * (
        at[0][c] - at[0][a]
    )
    _, depth = nearest_faces(screen, mesh.faces[np.abs(area) > 1e-6])
    # A little above the surface, so that it does not shade itself.
    from_x = at[0] + 0.5 * BIAS_CM * scale * (normals @ frame[0])
    from_y = at[1] - 0.5 * BIAS_CM * scale * (normals @ frame[1])
    lit = np.zeros(len(x))
    for dx, dy in ((-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)):
        column = np.clip((from_x + dx).astype(int), 0, SIDE - 1)
        row = np.clip((from_y + dy).astype(int), 0, SIDE - 1)
        lit += 0.25 * (depth[row, column] > at[2] - BIAS_CM)
    return lit
