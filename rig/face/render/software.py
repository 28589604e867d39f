"""Rendering without a graphics card, by compiled loops; four samples a pixel."""

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
from numba import njit
from scipy.sparse.csgraph import connected_components

from rig.arrays import Float32, Float64, Int32, Int64
from rig.face.geometry.mesh import EYE, HAIR, PORES, SKIN, Maps, Mesh, adjacency, unit
from rig.face.render import shading
from rig.face.render.shading import FAR, NEAR, Picture, View, background

# Compiled loops of the software renderer: scan conversion and light (numba).
#
# They take the places of the fragment stage of a graphics card; `shading.glsl` is the same light.

# mypy: allow-untyped-decorators, allow-untyped-calls, allow-any-generics


_TO_LIGHT = shading.TO_LIGHT
_COLOR = shading.LIGHT_COLORS
_WRAP = shading.WRAPS
_SKY, _GROUND = np.array(shading.SKY), np.array(shading.GROUND)
N_LIGHTS = len(_COLOR)


def compiled(function: Callable[..., Any]) -> Any:
    """Compile at the first call; the machine code is kept where a folder can be written."""
    options: dict[str, Any] = {"fastmath": True, "error_model": "numpy"}
    try:
        return njit(cache=True, **options)(function)
    except RuntimeError:  # numba finds no such folder: a read-only installation and home
        return njit(**options)(function)


# Columns of a vertex: place on the screen (2), normal (3), paint (4), light (2), accent, uv (2).
X, Y, NORMAL, PAINT, LIGHT, ACCENT, UV, COLUMNS = 0, 1, 2, 5, 9, 11, 12, 14


@compiled
def fill(x: Any, y: Any, z: Any, faces: Any, nearest: Any, depth: Any) -> None:
    """Write the nearest face and its depth at every sample (H, W) that faces cover.

    Neighbours compute a shared edge from its upper to its lower end, with the same numbers: they
    share no sample and leave none out.
    """
    height, width = nearest.shape
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        area = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
        per_x = ((z[b] - z[a]) * (y[c] - y[a]) - (z[c] - z[a]) * (y[b] - y[a])) / area
        per_y = ((z[c] - z[a]) * (x[b] - x[a]) - (z[b] - z[a]) * (x[c] - x[a])) / area
        if y[b] < y[a]:
            a, b = b, a
        if y[c] < y[a]:
            a, c = c, a
        if y[c] < y[b]:
            b, c = c, b
        first = max(int(np.ceil(y[a] - 0.5)), 0)
        last = min(int(np.ceil(y[c] - 0.5)), height)
        for row in range(first, last):
            at = row + 0.5
            one = _crossing(x, y, a, c, at)
            other = _crossing(x, y, a, b, at) if at < y[b] else _crossing(x, y, b, c, at)
            left = max(int(np.ceil(min(one, other) - 0.5)), 0)
            right = min(int(np.ceil(max(one, other) - 0.5)), width)
            value = z[a] + per_y * (at - y[a]) + per_x * (left + 0.5 - x[a])
            for column in range(left, right):
                if value < depth[row, column]:
                    depth[row, column] = value
                    nearest[row, column] = f
                value += per_x


@compiled
def _crossing(x: Any, y: Any, top: Any, bottom: Any, at: Any) -> Any:
    """Where the edge from `top` to `bottom` crosses a row."""
    height = y[bottom] - y[top]
    if height == 0:
        return x[top]
    return x[top] + (x[bottom] - x[top]) / height * (at - y[top])


@compiled
def color(
    samples: Any, surface: Any, to_eye: Any, maps: Any, step: Any, empty: Any, picture: Any
) -> None:
    """Write a picture (H, W, 3) of the faces at its samples (2 H, 2 W).

    Light is worked out once a pixel, and once more for each sample on another surface than the
    pixel's first sample (multisampling).
    """
    nearest, depth = samples
    faces, table, kind, part = surface
    height, width = picture.shape[:2]
    light, first = np.zeros(3), np.zeros(3)
    own, values = np.zeros(3), np.zeros(COLUMNS)
    for row in range(height):
        for column in range(width):
            light[:] = 0
            face = -2
            for sample in range(4):
                sy, sx = 2 * row + sample // 2, 2 * column + sample % 2
                f = nearest[sy, sx]
                is_same = sample > 0 and f == face
                if not is_same and sample > 0 and f >= 0 and face >= 0:
                    near = abs(depth[sy, sx] - depth[2 * row, 2 * column]) <= step
                    is_same = near and part[faces[f, 0]] == part[faces[face, 0]]
                if is_same:
                    light += first
                    continue
                if f < 0:
                    own[:] = empty[row]
                else:
                    _interpolate(table, faces[f], sx + 0.5, sy + 0.5, values)
                    _shade(values, kind[faces[f, 0]], to_eye[row, column], maps, own)
                light += own
                if sample == 0:
                    first[:] = own
                    face = f
            for k in range(3):
                picture[row, column, k] = int(light[k] * 63.75 + 0.5)


@compiled
def _interpolate(table: Any, face: Any, x: Any, y: Any, values: Any) -> None:
    a, b, c = table[face[0]], table[face[1]], table[face[2]]
    bx, by, cx, cy = b[X] - a[X], b[Y] - a[Y], c[X] - a[X], c[Y] - a[Y]
    area = bx * cy - by * cx
    to_b = ((x - a[X]) * cy - (y - a[Y]) * cx) / area
    to_c = ((y - a[Y]) * bx - (x - a[X]) * by) / area
    for k in range(NORMAL, COLUMNS):
        values[k] = a[k] + to_b * (b[k] - a[k]) + to_c * (c[k] - a[k])


@compiled
def _unit(x: Any, y: Any, z: Any) -> Any:
    scale = 1 / sqrt(x * x + y * y + z * z + 1e-12)
    return x * scale, y * scale, z * scale


@compiled
def _skin(values: Any, creases: Any, pores: Any) -> None:
    """Put pores into the gloss and creases into the normal; leave in ACCENT what colours keep."""
    u, v, accent = values[UV], values[UV + 1], values[ACCENT]
    side = len(pores)
    row, column = int(v * PORES * side) % side, int(u * PORES * side) % side
    kept = 1 + 0.16 * (pores[row, column, 0] / 127.5 - 1)
    values[PAINT + 3] *= 1 + 0.7 * (pores[row, column, 1] / 127.5 - 1)
    nx, ny, nz = _unit(values[NORMAL], values[NORMAL + 1], values[NORMAL + 2])
    if accent > 0.01:
        row, column = int(v * len(creases)), int(u * len(creases))
        nx += accent * (creases[row, column, 0] / 127.5 - 1)
        ny += accent * (creases[row, column, 1] / 127.5 - 1)
        nz += accent * (creases[row, column, 2] / 127.5 - 1)
        kept *= 1 - accent * (1 - creases[row, column, 3] / 255)
    values[NORMAL], values[NORMAL + 1], values[NORMAL + 2] = nx, ny, nz
    values[ACCENT] = kept


@compiled
def _shade(values: Any, kind: Any, v: Any, maps: Any, out: Any) -> None:
    """Colour (3,) sRGB 0..1 of one place of a surface, as the shader of `shading.glsl` gives it."""
    atlas, creases, pores = maps
    row, column = int(values[UV + 1] * len(atlas)), int(values[UV] * len(atlas))
    tint_r, tint_g, tint_b = atlas[row, column, 0], atlas[row, column, 1], atlas[row, column, 2]
    strand = (tint_r / 127.5) ** 2 if kind == HAIR else 1.0
    dark = values[ACCENT]
    if kind == SKIN:
        _skin(values, creases, pores)
        kept = values[ACCENT]
    else:
        kept = 1.0 if kind == HAIR else 1 - 0.85 * dark
    nx, ny, nz = _unit(values[NORMAL], values[NORMAL + 1], values[NORMAL + 2])
    gloss, ambient = values[PAINT + 3], values[LIGHT]
    facing = nx * v[0] + ny * v[1] + nz * v[2]
    up = 0.5 + 0.5 * ny
    rim = (1 - max(facing, 0.0)) ** 3 * 0.35 if kind != EYE else 0.0
    red = (_GROUND[0] + (_SKY[0] - _GROUND[0]) * up + rim * _SKY[0]) * ambient
    green = (_GROUND[1] + (_SKY[1] - _GROUND[1]) * up + rim * _SKY[1]) * ambient
    blue = (_GROUND[2] + (_SKY[2] - _GROUND[2]) * up + rim * _SKY[2]) * ambient
    shine_r = shine_g = shine_b = 0.0
    power = 14 + 340 * gloss * gloss
    strength = (0.16 * min(gloss, 0.28) + 0.50 * gloss * gloss * sqrt(max(gloss, 0.0))) * strand
    for k in range(N_LIGHTS):
        dx, dy, dz = _TO_LIGHT[k, 0], _TO_LIGHT[k, 1], _TO_LIGHT[k, 2]
        cosine = nx * dx + ny * dy + nz * dz
        seen = values[LIGHT + 1] if k == 0 else 0.35 + 0.65 * ambient
        bleed = seen * (1 - seen) if kind == SKIN else 0.0
        red += _COLOR[k, 0] * _wrapped(cosine, _WRAP[kind, 0]) * (seen + 0.55 * bleed)
        green += _COLOR[k, 1] * _wrapped(cosine, _WRAP[kind, 1]) * (seen + 0.12 * bleed)
        blue += _COLOR[k, 2] * _wrapped(cosine, _WRAP[kind, 2]) * seen
        if cosine > 0:
            along = 1 + dx * v[0] + dy * v[1] + dz * v[2]
            half = (cosine + facing) / sqrt(max(2 * along, 1e-6))
            half = min(max(half, 0.0), 1.0)
            shine = half / (power - power * half + half) * strength * seen
            shine_r += shine * _COLOR[k, 0]
            shine_g += shine * _COLOR[k, 1]
            shine_b += shine * _COLOR[k, 2]
    window = _window(nx, ny, nz, v, facing) * (1 - dark) if kind == EYE else 0.0
    out[0] = _display(values[PAINT] * tint_r / 127.5, kept * red, shine_r + window)
    out[1] = _display(values[PAINT + 1] * tint_g / 127.5, kept * green, shine_g + window)
    out[2] = _display(values[PAINT + 2] * tint_b / 127.5, kept * blue, shine_b + window)


@compiled
def _wrapped(cosine: Any, wrap: Any) -> Any:
    lit = min(max((cosine + wrap) / (1 + wrap), 0.0), 1.0)
    return lit * (0.72 + 0.28 * lit)


@compiled
def _window(nx: Any, ny: Any, nz: Any, v: Any, facing: Any) -> Any:
    """Reflection of a large lamp and of the sky on a wet eye."""
    dx, dy, dz = _TO_LIGHT[0, 0], _TO_LIGHT[0, 1], _TO_LIGHT[0, 2]
    toward = dx * v[0] + dy * v[1] + dz * v[2]
    mirror = 2 * facing * (nx * dx + ny * dy + nz * dz) - toward
    glow = min(max((mirror - 0.955) / 0.02, 0.0), 1.0)
    return 0.8 * glow * glow * (3 - 2 * glow) + 0.10 * min(max(2 * facing * ny - v[1], 0.0), 1.0)


@compiled
def _display(paint: Any, light: Any, shine: Any) -> Any:
    linear = paint * paint * light + shine
    return sqrt(min(max(linear * 1.12 / (1 + 0.12 * linear), 0.0), 1.0))


@dataclass(frozen=True)
class Screen:
    """A picture's grid of samples, and where a mesh's vertices fall on it.

    `x`, `y` (V,) count samples from the top left corner; `depth` (V,) grows away from the
    camera and is not negative.
    """

    width: int
    height: int
    x: Float32
    y: Float32
    depth: Float32


def front_faces(screen: Screen, faces: Int64) -> Int64:
    """Faces that show their outside and touch the picture (counter-clockwise, y downwards)."""
    ax, bx, cx = (screen.x[faces[:, k]] for k in range(3))
    ay, by, cy = (screen.y[faces[:, k]] for k in range(3))
    is_front = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) < -1e-6
    is_front &= np.maximum(np.maximum(ax, bx), cx) > 0
    is_front &= np.minimum(np.minimum(ax, bx), cx) < screen.width
    is_front &= np.maximum(np.maximum(ay, by), cy) > 0
    is_front &= np.minimum(np.minimum(ay, by), cy) < screen.height
    return faces[is_front]


def planes(screen: Screen, faces: Int64, values: Float32) -> tuple[Float32, Float32, Float32]:
    """How vertex values (V, k) run over each face: at its first corner, per x and per y.

    Each of the three arrays is (N, k).
    """
    a, b, c = (faces[:, k] for k in range(3))
    bx, by = screen.x[b] - screen.x[a], screen.y[b] - screen.y[a]
    cx, cy = screen.x[c] - screen.x[a], screen.y[c] - screen.y[a]
    area = (bx * cy - by * cx)[:, None]
    first = values[a]
    to_b, to_c = values[b] - first, values[c] - first
    per_x = (to_b * cy[:, None] - to_c * by[:, None]) / area
    per_y = (to_c * bx[:, None] - to_b * cx[:, None]) / area
    return first, per_x, per_y


def nearest_faces(screen: Screen, faces: Int64) -> tuple[Int32, Float32]:
    """Nearest face and its depth (height, width) at every sample; -1 and inf where there is none.

    Parameters
    ----------
    screen : Screen
        The picture and where vertices fall on it.
    faces : ndarray [shape=(N, 3)]
        Faces to draw, all from their outside (`front_faces`).
    """
    nearest = np.full((screen.height, screen.width), -1, np.int32)
    depth = np.full(nearest.shape, np.inf, np.float32)
    fill(screen.x, screen.y, screen.depth, faces, nearest, depth)
    return nearest, depth


STEP_CM = 0.2
"""Largest difference of depth between samples of one surface."""


class SoftwareRenderer:
    """Draws one mesh's poses."""

    def __init__(self, mesh: Mesh, size: tuple[int, int], view: View) -> None:
        self._mesh, self._size = mesh, size
        self._matrix = view.matrix(size[0] / size[1])
        paint = np.c_[mesh.colors, mesh.gloss, mesh.light]
        self._paint, self._uv = paint.astype(np.float32), mesh.uv.astype(np.float32)
        self._kind, self._part = mesh.kind.astype(np.int8), _parts(mesh)
        # Unit vectors (height, width, 3) from what each pixel shows towards the camera.
        width, height = size
        x, y = (np.arange(width) + 0.5) / width, (np.arange(height)[:, None] + 0.5) / height
        far = np.stack(np.broadcast_arrays(2 * x - 1, 1 - 2 * y, 1.0, 1.0), -1)
        point = far @ np.linalg.inv(self._matrix).T
        away = np.array(view.position) - point[..., :3] / point[..., 3:]
        self._to_eye = unit(away).astype(np.float32)
        self._empty = background(height)[:, 0].astype(np.float32)
        distance = float(np.linalg.norm(np.subtract(view.position, view.target)))
        self._step = np.float32(STEP_CM * NEAR * FAR / (FAR - NEAR) / distance**2)
        pixels_per_cm = height / (2 * distance * np.tan(np.radians(view.degrees) / 2))
        self._maps = _sharp_maps(mesh.maps, pixels_per_cm)

    def draw(self, vertices: Float64, normals: Float64, accents: Float32) -> Picture:
        """Picture (height, width, 3) uint8 of the mesh with these vertices and normals."""
        width, height = 2 * self._size[0], 2 * self._size[1]
        clip = vertices @ self._matrix[:, :3].T + self._matrix[:, 3]
        x, y, z = (clip[:, :3] / clip[:, 3:]).astype(np.float32).T
        screen = Screen(
            width, height, (x + 1) * (width / 2), (1 - y) * (height / 2), np.maximum(z + 1, 0) / 2
        )
        faces = front_faces(screen, self._mesh.faces)
        columns = [screen.x, screen.y, normals, self._paint, accents, self._uv]
        surface = faces, np.column_stack(columns).astype(np.float32), self._kind, self._part
        picture = np.empty((*self._size[::-1], 3), np.uint8)
        samples = nearest_faces(screen, faces)
        color(samples, surface, self._to_eye, self._maps, self._step, self._empty, picture)
        return picture

    def close(self) -> None:
        """Nothing to free."""


def _parts(mesh: Mesh) -> Int32:
    """Number (V,) of the connected piece each vertex belongs to; hair is one piece."""
    parts = connected_components(adjacency(mesh.faces, len(mesh.vertices)))[1].astype(np.int32)
    return np.where(mesh.kind == HAIR, np.int32(-1), parts)


TEXELS_PER_CM = 31.0
"""Of an atlas of 1,024 texels at the middle of a face."""


def _sharp_maps(maps: Maps, pixels_per_cm: float) -> tuple[Picture, Picture, Picture]:
    """The maps at about one texel a pixel: means of 2 x 2 texels as often as it takes."""

    def shrunk(picture: Picture, texels_per_cm: float) -> Picture:
        while texels_per_cm > 1.5 * pixels_per_cm and picture.shape[0] > 1:
            quads = picture.reshape(picture.shape[0] // 2, 2, picture.shape[1] // 2, 2, -1)
            picture = np.round(quads.mean((1, 3))).astype(np.uint8)
            texels_per_cm /= 2
        return np.ascontiguousarray(picture)

    share = TEXELS_PER_CM / 1024
    return (
        shrunk(maps.atlas, share * maps.atlas.shape[0]),
        shrunk(maps.creases, share * maps.creases.shape[0]),
        shrunk(maps.pores, share * PORES * maps.pores.shape[0]),
    )
