"""Rendering without a graphics card, by compiled loops; four samples a pixel."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba.core.config
import numpy as np
from numba import njit
from numpy.typing import NDArray
from PIL import Image

from rig.arrays import Bool, Float32, Float64, Int32, Int64
from rig.face.mesh import CLOTH, EYE, FINE, FINE_CM, HAIR, PORES, SKIN, Mesh, unit
from rig.face.render import shading
from rig.face.render.picture import Picture
from rig.face.render.shading import FAR, NEAR, View, background

# Compiled loops of the software renderer: scan conversion and light (numba).
#
# They take the places of the fragment stage of a graphics card; `shading.glsl()` is the same light.

# mypy: allow-untyped-decorators, allow-untyped-calls, allow-any-generics


F = np.float32
_TO_LIGHT, _COLOR = shading.TO_LIGHT.astype(F), shading.LIGHT_COLORS.astype(F)
_WRAP = shading.WRAPS.astype(F)
_SLOPE = 1 / (1 + _WRAP)
_SKY, _GROUND = np.array(shading.SKY, F), np.array(shading.GROUND, F)
N_LIGHTS, _PORE_TILT = len(_COLOR), F(shading.PORE_TILT)


def compiled(function: Callable[..., Any]) -> Any:
    """Compile at the first call; the machine code is kept where a folder can be written."""
    options: dict[str, Any] = {"fastmath": True, "error_model": "numpy"}
    try:
        return njit(cache=True, **options)(function)
    except RuntimeError:  # numba finds no such folder: a read-only installation and home
        return njit(**options)(function)


# A .numba_config.yaml in the working folder could name a cache, whose files are pickles.
numba.core.config._config_fname = ""
numba.core.config.reload_config()

TILE = 8
"""Side of a tile, samples."""
THRESHOLDS = np.array([40, 168, 216, 96], np.uint8)
"""Least alpha of the four samples of a pixel, of 255."""

# Columns of a vertex: place on the screen (2), normal (3), paint (4), light (2), accent, uv (2).
X, Y, NORMAL, COLUMNS = 0, 1, 2, 14
PLACES = 512
"""Most places whose light is worked out together: a power of two, four for each pixel."""
# Where the rows of numbers of places begin in one array, those of the vertices first. With known
# distances between rows the compiler can tell that they do not overlap.
NX, NY, NZ, RED, GREEN, BLUE, GLOSS, AMBIENT, SEEN, ACCENT, U, V = (
    PLACES * column for column in range(NORMAL, COLUMNS)
)
DEPTH, SHARE, STRAND, KEPT, BLEED, RIM, WINDOW, IS_HAIR = (
    PLACES * row for row in range(COLUMNS, COLUMNS + 8)
)
TO_EYE, WRAP, SLOPE, ROWS = 22 * PLACES, 25 * PLACES, 28 * PLACES, 31


@compiled
def fill(
    x: Any, y: Any, z: Any, uv: Any, alpha: Any, faces: Any, first_face: Any, n_solid: Any,
    far: Any, nearest: Any, depth: Any,
) -> None:  # fmt: skip
    """Write the nearest face and its depth at every sample (H, W) that faces cover.

    Faces from `n_solid` on cover those samples where `alpha` (A, A) at `uv` (V, 2) is above the
    threshold of the sample within its pixel, which makes soft edges.

    Neighbours compute a shared edge from its upper to its lower end, with the same numbers: they
    share no sample and leave none out. Faces behind `far`, the depth of tiles of samples
    (`farthest`), are left out.
    """
    height, width = nearest.shape
    for f in range(first_face, len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if _is_behind(x, y, z, a, b, c, far):
            continue
        area = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
        per_x = ((z[b] - z[a]) * (y[c] - y[a]) - (z[c] - z[a]) * (y[b] - y[a])) / area
        per_y = ((z[c] - z[a]) * (x[b] - x[a]) - (z[b] - z[a]) * (x[c] - x[a])) / area
        is_thin = f >= n_solid
        side = F(len(alpha))
        ua, va, xa, ya = uv[a, 0] * side, uv[a, 1] * side, x[a], y[a]
        u_x = ((uv[b, 0] * side - ua) * (y[c] - ya) - (uv[c, 0] * side - ua) * (y[b] - ya)) / area
        u_y = ((uv[c, 0] * side - ua) * (x[b] - xa) - (uv[b, 0] * side - ua) * (x[c] - xa)) / area
        v_x = ((uv[b, 1] * side - va) * (y[c] - ya) - (uv[c, 1] * side - va) * (y[b] - ya)) / area
        v_y = ((uv[c, 1] * side - va) * (x[b] - xa) - (uv[b, 1] * side - va) * (x[c] - xa)) / area
        if y[b] < y[a]:
            a, b = b, a
        if y[c] < y[a]:
            a, c = c, a
        if y[c] < y[b]:
            b, c = c, b
        long, upper, lower = _slope(x, y, a, c), _slope(x, y, a, b), _slope(x, y, b, c)
        first = max(int(np.ceil(y[a] - 0.5)), 0)
        middle = int(np.ceil(y[b] - 0.5))
        last = min(int(np.ceil(y[c] - 0.5)), height)
        for row in range(first, last):
            at = row + 0.5
            one = x[a] + long * (at - y[a])
            other = x[a] + upper * (at - y[a]) if row < middle else x[b] + lower * (at - y[b])
            left = max(int(np.ceil(min(one, other) - 0.5)), 0)
            right = min(int(np.ceil(max(one, other) - 0.5)), width)
            value = z[a] + per_y * (at - y[a]) + per_x * (left + 0.5 - x[a])
            for column in range(left, right):
                covers = value < depth[row, column]
                if covers and is_thin:
                    dx, dy = column + F(0.5) - xa, row + F(0.5) - ya
                    u, v = ua + u_x * dx + u_y * dy, va + v_x * dx + v_y * dy
                    covers = _cover(alpha, u, v) > THRESHOLDS[2 * (row % 2) + column % 2]
                if covers:
                    depth[row, column] = value
                    nearest[row, column] = f
                value += per_x


@compiled
def _cover(alpha: Any, u: Any, v: Any) -> Any:
    """Alpha at a place in texels, between the texels."""
    last = len(alpha) - 1
    u, v = min(max(u - F(0.5), F(0)), F(last)), min(max(v - F(0.5), F(0)), F(last))
    x, y = int(u), int(v)
    right, below = min(x + 1, last), min(y + 1, last)
    high = alpha[y, x] + (u - x) * (F(alpha[y, right]) - F(alpha[y, x]))
    low = alpha[below, x] + (u - x) * (F(alpha[below, right]) - F(alpha[below, x]))
    return high + (v - y) * (low - high)


@compiled
def _is_behind(x: Any, y: Any, z: Any, a: Any, b: Any, c: Any, far: Any) -> Any:
    """Whether a face lies behind all samples of the tiles that it touches."""
    left, right = min(x[a], x[b], x[c]), max(x[a], x[b], x[c])
    top, bottom = min(y[a], y[b], y[c]), max(y[a], y[b], y[c])
    near = min(z[a], z[b], z[c])
    for row in range(max(int(top) // TILE, 0), min(int(bottom) // TILE + 1, far.shape[0])):
        for column in range(max(int(left) // TILE, 0), min(int(right) // TILE + 1, far.shape[1])):
            if near < far[row, column]:
                return False
    return True


@compiled
def farthest(depth: Any, far: Any) -> None:
    """Write the largest depth of each tile of `TILE` by `TILE` samples."""
    far[:] = 0
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            at = row // TILE, column // TILE
            far[at] = max(far[at], depth[row, column])


@compiled
def _slope(x: Any, y: Any, top: Any, bottom: Any) -> Any:
    """Of an edge: columns per row; 0 of a level one, which no row crosses."""
    height = y[bottom] - y[top]
    return (x[bottom] - x[top]) / height if height > 0 else 0.0 * height


@compiled
def color(
    samples: Any, surface: Any, to_eye: Any, maps: Any, step: Any, empty: Any, picture: Any
) -> None:
    """Write a picture (H, W, 3) of the faces at its samples (2 H, 2 W).

    Light is worked out once a pixel for each surface that its samples show (multisampling), of
    many pixels together: loops that compile to instructions on many numbers.
    """
    height, width = picture.shape[:2]
    places, shown = np.zeros(ROWS * PLACES, F), np.zeros(PLACES, np.int64)
    columns, kinds = np.zeros(PLACES, np.int64), np.zeros(PLACES, np.int64)
    for row in range(height):
        for left in range(0, width, PLACES // 4):
            right = min(left + PLACES // 4, width)
            count = _find(row, left, right, samples, surface, step, places, shown, columns)
            _interpolate(count, surface, places, shown, kinds)
            _paint(row, count, to_eye, maps, places, columns, kinds)
            _light(count, places)
            i = 0
            for column in range(left, right):
                red, green, blue = empty[row, 0], empty[row, 1], empty[row, 2]
                while i < count and columns[i] == column:
                    share = F(0.25) * places[SHARE + i]
                    red += share * (places[RED + i] - empty[row, 0])
                    green += share * (places[GREEN + i] - empty[row, 1])
                    blue += share * (places[BLUE + i] - empty[row, 2])
                    i += 1
                picture[row, column, 0] = int(red * F(255) + F(0.5))
                picture[row, column, 1] = int(green * F(255) + F(0.5))
                picture[row, column, 2] = int(blue * F(255) + F(0.5))


@compiled
def _find(
    row: Any, left: Any, right: Any, samples: Any, surface: Any, step: Any, places: Any,
    shown: Any, columns: Any,
) -> Any:  # fmt: skip
    """Find the surfaces that some pixels of a row show; return how many places."""
    nearest, depth = samples
    faces, _, _, part = surface
    count = 0
    for column in range(left, right):
        first = count
        for sample in range(4):
            sy, sx = 2 * row + sample // 2, 2 * column + sample % 2
            f, far = nearest[sy, sx], depth[sy, sx]
            if f < 0:
                continue
            i = first
            while i < count and shown[i] != f:
                is_near = abs(far - places[DEPTH + i]) <= step
                if is_near and part[faces[f, 0]] == part[faces[shown[i], 0]]:
                    break
                i += 1
            if i == count:
                places[X * PLACES + i], places[Y * PLACES + i] = sx + 0.5, sy + 0.5
                places[DEPTH + i], places[SHARE + i] = far, 0
                shown[i], columns[i] = f, column
                count += 1
            places[SHARE + i] += 1
    return count


@compiled
def _interpolate(count: Any, surface: Any, places: Any, shown: Any, kinds: Any) -> None:
    """Write the values of the vertices and the kind of surface at each place."""
    faces, table, kind, _ = surface
    for i in range(count):
        a, b, c = faces[shown[i], 0], faces[shown[i], 1], faces[shown[i], 2]
        kinds[i] = kind[a]
        ax, ay = table[a, X], table[a, Y]
        bx, by, cx, cy = table[b, X] - ax, table[b, Y] - ay, table[c, X] - ax, table[c, Y] - ay
        x, y, area = places[X * PLACES + i] - ax, places[Y * PLACES + i] - ay, bx * cy - by * cx
        to_b, to_c = (x * cy - y * cx) / area, (y * bx - x * by) / area
        for k in range(NORMAL, COLUMNS):
            first = table[a, k]
            rise = to_b * (table[b, k] - first) + to_c * (table[c, k] - first)
            places[k * PLACES + i] = first + rise


@compiled
def _unit(x: Any, y: Any, z: Any) -> Any:
    scale = F(1) / np.sqrt(x * x + y * y + z * z + F(1e-12))
    return x * scale, y * scale, z * scale


@compiled
def _texel(picture: Any, u: Any, v: Any, k: Any) -> Any:
    """One channel of a picture at a place, between its texels."""
    side = len(picture)
    across, down = _limited(u) * side - F(0.5), _limited(v) * side - F(0.5)
    x, y = min(max(int(across), 0), side - 2), min(max(int(down), 0), side - 2)
    across, down = _limited(across - x), _limited(down - y)
    high = picture[y, x, k] + across * (F(picture[y, x + 1, k]) - F(picture[y, x, k]))
    low = picture[y + 1, x, k] + across * (F(picture[y + 1, x + 1, k]) - F(picture[y + 1, x, k]))
    return high + down * (low - high)


@compiled
def _paint(
    row: Any, count: Any, to_eye: Any, maps: Any, places: Any, columns: Any, kinds: Any
) -> None:
    """Put the maps, and what each kind of surface has, into the places of a row."""
    atlas, creases, pores = maps
    for i in range(count):
        kind, u, v, accent = kinds[i], places[U + i], places[V + i], places[ACCENT + i]
        nx, ny, nz = _unit(places[NX + i], places[NY + i], places[NZ + i])
        away = to_eye[row, columns[i]]
        vx, vy, vz = away[0], away[1], away[2]
        if (kind == HAIR or kind >= CLOTH) and nx * vx + ny * vy + nz * vz < F(0):
            nx, ny, nz = -nx, -ny, -nz
        for k in range(3):
            places[RED + k * PLACES + i] *= _texel(atlas, u, v, k) / F(255)
        places[STRAND + i] = min(F(3) * places[RED + i], F(1)) if kind == HAIR else F(1)
        places[KEPT + i] = F(1) if kind != EYE else F(1) - F(0.85) * accent
        places[RIM + i] = F(0) if kind == EYE else F(0.35)
        places[WINDOW + i], places[IS_HAIR + i] = F(0), F(1) if kind == HAIR else F(0)
        places[BLEED + i] = F(1) if kind == SKIN else F(0)
        for k in range(3):
            places[TO_EYE + k * PLACES + i] = away[k]
            places[WRAP + k * PLACES + i] = _WRAP[kind, k]
            places[SLOPE + k * PLACES + i] = _SLOPE[kind, k]
        if kind == EYE:
            open_ = _limited(F(4) * (F(0.7) - accent))  # a lid cuts the reflection off
            places[WINDOW + i] = _window(nx, ny, nz, vx, vy, vz) * open_
        elif kind == SKIN:
            side = len(pores)
            y, x = int(v * PORES * side) % side, int(u * PORES * side) % side
            kept = F(1) + F(0.16) * (pores[y, x, 0] / F(127.5) - F(1))
            places[GLOSS + i] *= F(1) + F(0.7) * (pores[y, x, 0] / F(127.5) - F(1))
            nx += _PORE_TILT * (pores[y, x, 1] / F(127.5) - F(1))
            ny += _PORE_TILT * (pores[y, x, 2] / F(127.5) - F(1))
            if accent > F(0.01):
                nx += accent * (_texel(creases, u, v, 0) / F(127.5) - F(1))
                ny += accent * (_texel(creases, u, v, 1) / F(127.5) - F(1))
                nz += accent * (_texel(creases, u, v, 2) / F(127.5) - F(1))
                kept *= F(1) - accent * (F(1) - _texel(creases, u, v, 3) / F(255))
            nx, ny, nz = _unit(nx, ny, nz)
            places[KEPT + i] = kept
        places[NX + i], places[NY + i], places[NZ + i] = nx, ny, nz


@compiled
def _window(nx: Any, ny: Any, nz: Any, vx: Any, vy: Any, vz: Any) -> Any:
    """Reflection of a large lamp and of the sky on a wet eye."""
    facing = nx * vx + ny * vy + nz * vz
    dx, dy, dz = _TO_LIGHT[0, 0], _TO_LIGHT[0, 1], _TO_LIGHT[0, 2]
    toward = dx * vx + dy * vy + dz * vz
    mirror = F(2) * facing * (nx * dx + ny * dy + nz * dz) - toward
    glow = _limited((mirror - F(0.972)) / F(0.008))
    sky = _limited(F(2) * facing * ny - vy)
    return F(0.9) * glow * glow * (F(3) - F(2) * glow) + F(0.02) * sky


@compiled
def _light(count: Any, places: Any) -> None:
    """Put light on the paint of each place: the sRGB colour, 0 to 1, of `shading.glsl()`."""
    for i in range(count):
        nx, ny, nz = places[NX + i], places[NY + i], places[NZ + i]
        vx, vy, vz = (places[TO_EYE + i], places[TO_EYE + PLACES + i],
                      places[TO_EYE + 2 * PLACES + i])  # fmt: skip
        gloss, ambient = places[GLOSS + i], places[AMBIENT + i]
        facing = nx * vx + ny * vy + nz * vz
        up, away = F(0.5) + F(0.5) * ny, F(1) - max(facing, F(0))
        rim = away * away * away * places[RIM + i]
        level = np.sqrt(max(F(1) - ny * ny, F(0.05)))  # of the way in which strands hang
        red = (_GROUND[0] + (_SKY[0] - _GROUND[0]) * up + rim * _SKY[0]) * ambient
        green = (_GROUND[1] + (_SKY[1] - _GROUND[1]) * up + rim * _SKY[1]) * ambient
        blue = (_GROUND[2] + (_SKY[2] - _GROUND[2]) * up + rim * _SKY[2]) * ambient
        shine_r = shine_g = shine_b = places[WINDOW + i]
        power = F(14) + F(340) * gloss * gloss
        strength = F(0.16) * min(gloss, F(0.28))
        strength += F(0.50) * gloss * gloss * np.sqrt(max(gloss, F(0)))
        strength *= places[STRAND + i]
        for k in range(N_LIGHTS):
            dx, dy, dz = _TO_LIGHT[k, 0], _TO_LIGHT[k, 1], _TO_LIGHT[k, 2]
            cosine = nx * dx + ny * dy + nz * dz
            seen = places[SEEN + i] if k == 0 else min(F(0.35) + F(0.65) * ambient, F(3) * ambient)
            bleed = seen * (F(1) - seen) * places[BLEED + i]
            lit = _wrapped(cosine, places[WRAP + i], places[SLOPE + i])
            red += _COLOR[k, 0] * lit * (seen + F(0.3) * bleed)
            lit = _wrapped(cosine, places[WRAP + PLACES + i], places[SLOPE + PLACES + i])
            green += _COLOR[k, 1] * lit * (seen + F(0.12) * bleed)
            lit = _wrapped(cosine, places[WRAP + 2 * PLACES + i], places[SLOPE + 2 * PLACES + i])
            blue += _COLOR[k, 2] * lit * seen
            along = F(1) + dx * vx + dy * vy + dz * vz
            both = np.sqrt(max(F(2) * along, F(1e-6)))
            half = _limited((cosine + facing) / both)
            half = half if cosine > F(0) else F(0)
            fall = (ny * (cosine + facing) - dy - vy) / (both * level)
            strand = max(F(1) - fall * fall, F(0)) * places[IS_HAIR + i]
            gate = F(1) + places[IS_HAIR + i] * (_limited(F(0.3) + cosine) - F(1))
            half = max(strand, half * (F(1) - places[IS_HAIR + i]))
            shine = gate * half / (power - power * half + half) * strength * seen
            shine_r += shine * _COLOR[k, 0]
            shine_g += shine * _COLOR[k, 1]
            shine_b += shine * _COLOR[k, 2]
        kept = places[KEPT + i]
        places[RED + i] = _display(places[RED + i], kept * red, shine_r)
        places[GREEN + i] = _display(places[GREEN + i], kept * green, shine_g)
        places[BLUE + i] = _display(places[BLUE + i], kept * blue, shine_b)


@compiled
def _limited(x: Any) -> Any:
    return min(max(x, F(0)), F(1))


@compiled
def _wrapped(cosine: Any, wrap: Any, slope: Any) -> Any:
    lit = _limited((cosine + wrap) * slope)
    return lit * (F(0.72) + F(0.28) * lit)


@compiled
def _display(paint: Any, light: Any, shine: Any) -> Any:
    linear = paint * paint * light + shine
    return np.sqrt(_limited(linear * F(1.12) / (F(1) + F(0.12) * linear)))


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


def front_faces(screen: Screen, faces: Int64, two_sided: Bool | None = None) -> Int64:
    """Faces that show their outside and touch the picture (counter-clockwise, y downwards).

    Of the `two_sided` ones those that show their inside too, turned.
    """
    ax, bx, cx = (screen.x[faces[:, k]] for k in range(3))
    ay, by, cy = (screen.y[faces[:, k]] for k in range(3))
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    is_front = area < -1e-6
    if two_sided is not None:
        turned = two_sided & (area > 1e-6)
        faces, is_front = np.where(turned[:, None], faces[:, ::-1], faces), is_front | turned
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


def nearest_faces(
    screen: Screen,
    faces: Int64,
    n_solid: int | None = None,
    uv: Float32 | None = None,
    alpha: NDArray[np.uint8] | None = None,
) -> tuple[Int32, Float32]:
    """Nearest face and its depth (height, width) at every sample; -1 and inf where there is none.

    Parameters
    ----------
    screen : Screen
        The picture and where vertices fall on it.
    faces : ndarray [shape=(N, 3)]
        Faces to draw, all from their outside (`front_faces`).
    n_solid : int, optional
        How many are filled first, behind which the others are left out early, and which cover all
        their samples. Default all.
    uv : ndarray [shape=(V, 2)], optional
        Places of vertices in `alpha`.
    alpha : ndarray of uint8 [shape=(A, A)], optional
        How much of the other faces is there.
    """
    count = len(faces) if n_solid is None else n_solid
    uv = np.zeros((len(screen.x), 2), np.float32) if uv is None else uv
    alpha = np.full((1, 1), 255, np.uint8) if alpha is None else alpha
    nearest = np.full((screen.height, screen.width), -1, np.int32)
    depth = np.full(nearest.shape, np.inf, np.float32)
    far = np.full((-(-screen.height // TILE), -(-screen.width // TILE)), np.inf, np.float32)
    place = screen.x, screen.y, screen.depth
    fill(*place, uv, alpha, faces[:count], 0, count, far, nearest, depth)
    if count < len(faces):
        farthest(depth, far)
        fill(*place, uv, alpha, faces, count, count, far, nearest, depth)
    return nearest, depth


STEP_CM = 0.2
"""Largest difference of depth between samples of one surface."""


class Renderer:
    """Draws poses of one mesh, in `size` (width, height), from one view."""

    def __init__(self, mesh: Mesh, size: tuple[int, int], view: View) -> None:
        self._size, self._mesh = size, mesh
        is_hair = np.isin(mesh.kind[mesh.faces[:, 0]], (HAIR, FINE))
        self._faces = mesh.faces[np.argsort(is_hair, kind="stable")]  # hair last
        self._two_sided = np.isin(mesh.kind[self._faces[:, 0]], (HAIR, FINE, CLOTH))
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
        # The maps at about one texel a pixel: means of 2 x 2 texels as often as it takes.
        maps = mesh.maps

        def shrunk(picture: Picture, texels_per_cm: float) -> Picture:
            halvings = int(np.ceil(np.log2(texels_per_cm / (1.5 * pixels_per_cm))))
            halvings = min(halvings, len(picture).bit_length() - 2)
            if halvings < 1:
                return np.ascontiguousarray(picture)
            mode = "RGB" if picture.shape[2] == 3 else "CMYK"  # RGBA would weigh by alpha
            image = Image.frombuffer(
                mode, picture.shape[1::-1], picture.tobytes(), "raw", mode, 0, 1
            )
            return np.asarray(image.reduce(2**halvings))

        share = TEXELS_PER_CM / 1024
        self._maps = (
            shrunk(maps.atlas, share * maps.atlas.shape[0]),
            shrunk(maps.creases, share * maps.creases.shape[0]),
            shrunk(maps.pores, share * PORES * maps.pores.shape[0]),
        )
        self._alpha = np.ascontiguousarray(self._maps[0][..., 3])

    def render(
        self,
        vertices: Float64,
        normals: Float64 | None = None,
        accents: Float32 | None = None,
    ) -> Picture:
        """Picture (height, width, 3) uint8 of the mesh with these vertices (V, 3).

        `normals` (V, 3) may be given where several views share them; `accents` (V,) are those of
        `rig.face.accents` (none: 0).
        """
        if normals is None:
            normals = self._mesh.normals(vertices)
        if accents is None:
            accents = np.zeros(len(vertices), np.float32)
        width, height = 2 * self._size[0], 2 * self._size[1]
        clip = vertices @ self._matrix[:, :3].T + self._matrix[:, 3]
        x, y, z = (clip[:, :3] / clip[:, 3:]).astype(np.float32).T
        depth = np.maximum(z + 1, 0) / 2
        depth[self._kind == FINE] -= self._step * np.float32(FINE_CM / STEP_CM)
        screen = Screen(width, height, (x + 1) * (width / 2), (1 - y) * (height / 2), depth)
        faces = front_faces(screen, self._faces, self._two_sided)
        columns = [screen.x, screen.y, normals, self._paint, accents, self._uv]
        surface = faces, np.column_stack(columns).astype(np.float32), self._kind, self._part
        picture = np.empty((*self._size[::-1], 3), np.uint8)
        n_solid = int((~np.isin(self._kind[faces[:, 0]], (HAIR, FINE))).sum())
        samples = nearest_faces(screen, faces, n_solid, self._uv, self._alpha)
        color(samples, surface, self._to_eye, self._maps, self._step, self._empty, picture)
        return picture


def _parts(mesh: Mesh) -> Int32:
    """Least vertex (V,) of the connected piece each vertex belongs to; hair is one piece."""
    label, corners, before = mesh.weld.copy(), mesh.weld[mesh.faces.T], np.zeros(0, np.int64)
    while not np.array_equal(label, before):
        before, names = label.copy(), label[corners]
        np.minimum.at(label, names.ravel(), np.tile(names.min(0), 3))
        while not np.array_equal(label, label[label]):
            label = label[label]
    return np.where(np.isin(mesh.kind, (HAIR, FINE)), -1, label[mesh.weld]).astype(np.int32)


TEXELS_PER_CM = 28.0
"""Of an atlas of 1,024 texels at the middle of a face."""
