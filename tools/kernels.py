"""Source of ``*.bc``, the compiled loops of the software renderer: scan conversion and light.

They take the places of the fragment stage of a graphics card; `shading.glsl()` is the same light.
``python -m tools.kernels`` compiles them by numba to LLVM's bitcode of no particular
processor, which must be done after each change of this file, `compiled`, `shading` or `mesh`;
`rig.face.render.compiled` makes machine code of it without numba.
"""

# mypy: allow-untyped-decorators, allow-untyped-calls, allow-any-generics

import re
from hashlib import sha256
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np
from numba import njit, types
from numba.core import config

from rig.face import mesh
from rig.face.mesh import CLOTH, EYE, HAIR, PORES, SKIN
from rig.face.render import compiled, shading
from rig.face.render.compiled import EMPTY, KERNELS, PLACES, THRESHOLDS, TILE, file_of
from rig.face.render.shading import CLOTH_PORES, CLOTH_SHADE

F, I4 = np.float32, np.int32
_TO_LIGHT, _COLOR = shading.TO_LIGHT.astype(F), shading.LIGHT_COLORS.astype(F)
_WRAP = shading.WRAPS.astype(F)
_SLOPE = 1 / (1 + _WRAP)
_DEEP, _GLOW = np.array(shading.DEEP, F), np.array(shading.GLOW, F)
_DIM, _UNDER_LID = F(shading.DIM), np.array(shading.UNDER_LID, F)
_CATCH = shading.CATCH.astype(F)
_CREASE_TILT, _CREASE_RED = F(shading.CREASE_TILT), F(shading.CREASE_RED)
_IRIS = F(shading.IRIS)
_SKY, _GROUND = np.array(shading.SKY, F), np.array(shading.GROUND, F)
N_LIGHTS, _WINDOW_TURN = len(_COLOR), F(shading.WINDOW_TURN)
_WINDOW_BEGIN, _WINDOW_END = (F(edge) for edge in shading.WINDOW_EDGE)
_WINDOW_LIGHT = F(shading.WINDOW)
_PORE_TILT, _PORE_SHADE = F(shading.PORE_TILT), F(shading.PORE_SHADE)
_PORE_GLOSS, _SHEEN, _STRANDS = F(shading.PORE_GLOSS), F(shading.SHEEN), F(shading.STRANDS)
_TINT, _RIM, _HAIR_RIM = F(shading.TINT), F(shading.RIM), F(shading.HAIR_RIM)

PROCESSOR = "skylake-avx512"
WIDE = 16
"""For whose vectors loops are written, and how many numbers the longest have."""
_OPTIONS: dict[str, Any] = {"fastmath": True, "error_model": "numpy", "_nrt": False}
kernel = njit(**_OPTIONS)

_THRESHOLDS = np.array(THRESHOLDS, I4).reshape(2, 2) << 16

# Columns of a vertex: place on the screen (3), uv (2), normal (3), paint (4), light (2), accent.
X, Y, Z, LEFT, TOP, COLUMNS = 0, 1, 2, 3, 4, 15
# Where the rows of numbers of places begin in one array, those of the vertices first. With known
# distances between rows the compiler can tell that they do not overlap.
U, V, NX, NY, NZ, RED, GREEN, BLUE, GLOSS, AMBIENT, SEEN, ACCENT = (
    PLACES * column for column in range(LEFT, COLUMNS)
)
DEPTH, SHARE, STRAND, KEPT, KIND, RIM, WINDOW, CREASE = (
    PLACES * row for row in range(COLUMNS, COLUMNS + 8)
)
_FACE, _EMPTY = 2**32 - 1, EMPTY
"""Bits of a sample's face; all are set where there is none."""
TO_EYE, WRAP, SLOPE = 24 * PLACES, 27 * PLACES, 30 * PLACES
_SKIN, _HAIR, _EYE, _CLOTH = F(SKIN), F(HAIR), F(EYE), F(CLOTH)


@kernel
def normals(vertices: Any, faces: Any, weld: Any, found: Any) -> None:
    """Write unit normals (V, 3), the cross products of welded faces summed at their corners."""
    found[:] = 0
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        bx, by, bz = _difference(vertices, b, a)
        cx, cy, cz = _difference(vertices, c, a)
        x, y, z = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        for corner in (a, b, c):
            found[corner, 0] += x
            found[corner, 1] += y
            found[corner, 2] += z
    for v in range(len(found)):  # the first vertex of a point comes before the others
        x, y, z = found[weld[v], 0], found[weld[v], 1], found[weld[v], 2]
        found[v, 0], found[v, 1], found[v, 2] = _unit(x, y, z)


@kernel
def _difference(points: Any, a: Any, b: Any) -> Any:
    return points[a, 0] - points[b, 0], points[a, 1] - points[b, 1], points[a, 2] - points[b, 2]


@kernel
def draw(
    vertices: Any, normals: Any, accents: Any, matrix: Any, nearer: Any, table: Any, alpha: Any,
    faces: Any, stops: Any, starts: Any, listed: Any, far: Any, samples: Any, kind: Any, part: Any,
    to_eye: Any, atlas: Any, creases: Any, pores: Any,
    step: Any, empty: Any, places: Any, shown: Any, columns: Any, picture: Any,
) -> None:  # fmt: skip
    """Write a picture (H, W, 3) of faces at its samples, band by band, which stay in the cache.

    `nearer` (V,) is taken from the depth of vertices in clip space, of `matrix` (4, 4).
    `to_eye` (3, 3) points to the camera from the first pixel, and runs per column and per row.
    `starts`, `listed`, `far`, `samples` of a band, `places`, `shown` and `columns` are room.
    """
    for v in range(len(table)):
        x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        far_off = F(1) / _row(matrix[3], x, y, z)
        table[v, X] = (F(1) + _row(matrix[0], x, y, z) * far_off) * F(picture.shape[1])
        table[v, Y] = (F(1) - _row(matrix[1], x, y, z) * far_off) * F(picture.shape[0])
        deep = F(1) + _row(matrix[2], x, y, z) * far_off - nearer[v]
        table[v, Z], table[v, COLUMNS - 1] = max(F(0.5) * deep, F(0)), accents[v]
        for k in range(3):
            table[v, TOP + 1 + k] = normals[v, k]
    _sort(table, faces, stops[1], 2 * len(picture), samples, starts, listed)
    for band in range(len(starts) - 2):
        _fill(table, alpha, faces, stops, listed[starts[band] : starts[band + 1]], far,
              band * len(samples), samples)  # fmt: skip
        first = band * len(samples) // 2
        for row in range(first, min(first + len(samples) // 2, len(picture))):
            _color(row, samples[2 * (row - first) :], faces, table, kind, part, to_eye,
                   atlas, creases, pores, step[0], empty[row], places, shown, columns,
                   picture[row])  # fmt: skip


@kernel
def _row(row: Any, x: Any, y: Any, z: Any) -> Any:
    return row[0] * x + row[1] * y + row[2] * z + row[3]


@kernel
def nearest(
    table: Any, alpha: Any, faces: Any, stops: Any, starts: Any, listed: Any, far: Any, samples: Any
) -> None:
    """Write the nearest face and its depth at every sample; see `_fill`."""
    _sort(table, faces, stops[1], len(samples), samples, starts, listed)
    _fill(table, alpha, faces, stops, listed[: starts[1]], far, 0, samples)


@kernel
def _sort(
    table: Any, faces: Any, one_sided: Any, height: Any, samples: Any, starts: Any, listed: Any
) -> None:
    """List the faces to draw of each band of a picture, in order, from `starts` on.

    Of the first `one_sided` faces those are drawn that show their outside (counter-clockwise, y
    downwards).
    """
    starts[:] = 0
    kept, count = listed[-len(faces) :], 0
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        x, y = table[a, X], table[a, Y]
        bx, by = table[b, X] - x, table[b, Y] - y
        cx, cy = table[c, X] - x, table[c, Y] - y
        area = bx * cy - by * cx
        if area > F(-1e-6) and (f < one_sided or area < F(1e-6)):
            continue
        if x + max(bx, cx, F(0)) <= 0 or x + min(bx, cx, F(0)) >= samples.shape[1]:
            continue
        first, last = _bands(table, a, b, c, height, len(samples))
        for band in range(first, last):
            starts[band + 2] += 1
        if first < last:
            kept[count] = f
            count += 1
    for band in range(2, len(starts)):
        starts[band] += starts[band - 1]
    for f in kept[:count]:
        first, last = _bands(table, faces[f, 0], faces[f, 1], faces[f, 2], height, len(samples))
        for band in range(first, last):
            listed[starts[band + 1]] = f
            starts[band + 1] += 1


@kernel
def _bands(table: Any, a: Any, b: Any, c: Any, height: Any, rows: Any) -> Any:
    """First band of `rows` that a face touches, and the one after its last."""
    top, bottom = (
        min(table[a, Y], table[b, Y], table[c, Y]),
        max(table[a, Y], table[b, Y], table[c, Y]),
    )
    if bottom <= 0 or top >= height:
        return 0, 0
    return int(max(top, F(0))) // rows, int(min(bottom, F(height - 1))) // rows + 1


@kernel
def _fill(
    table: Any, alpha: Any, faces: Any, stops: Any, listed: Any, far: Any, first_row: Any,
    samples: Any,
) -> None:  # fmt: skip
    """Write the nearest of the listed faces and its depth at every sample of a band.

    A sample's bits are those of the depth and, in the lower half, the face: the least is nearest.
    Faces behind `far`, the depth of tiles of samples, which is found at each of the `stops`, are
    left out. Faces from the last stop on cover those samples where `alpha` at their uv is above the
    threshold of the sample within its pixel, which makes soft edges; each number of `alpha`
    (A + 1, A + 1) has the bytes of four neighbours.

    Neighbours compute a shared edge from its upper to its lower end, with the same numbers: they
    share no sample and leave none out.
    """
    samples[:] = _EMPTY
    far[:] = np.inf
    stage = 0
    for f in listed:
        if stage < len(stops) and f >= stops[stage]:
            _farthest(samples, far)
            while stage < len(stops) and f >= stops[stage]:
                stage += 1
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if not _is_behind(table, a, b, c, far, first_row):
            _fill_face(table, alpha, a, b, c, f, f >= stops[-1], first_row, samples)


@kernel
def _fill_face(
    table: Any, alpha: Any, a: Any, b: Any, c: Any, f: Any, is_thin: Any, first_row: Any,
    samples: Any,
) -> None:  # fmt: skip
    """Write a face, with or without alpha, where it is nearest."""
    origin, per_x, per_y = a, _slope(table, a, b, c, Z, Y), -_slope(table, a, b, c, Z, X)
    u_x, u_y, v_x, v_y, u, v = F(0), F(0), F(0), F(0), F(0), F(0)
    if is_thin:  # places in 256ths of texels
        side = F(256 * (len(alpha) - 1))
        u_x, u_y = (
            side * _slope(table, a, b, c, LEFT, Y),
            -side * _slope(table, a, b, c, LEFT, X),
        )
        v_x, v_y = side * _slope(table, a, b, c, TOP, Y), -side * _slope(table, a, b, c, TOP, X)
        u, v = side * table[a, LEFT] + F(128), side * table[a, TOP] + F(128)
    if table[b, Y] < table[a, Y]:
        a, b = b, a
    if table[c, Y] < table[a, Y]:
        a, c = c, a
    if table[c, Y] < table[b, Y]:
        b, c = c, b
    x, z, top = table[origin, X] - F(0.5), table[origin, Z], table[origin, Y] - F(0.5)
    ax, ay, bx, by = table[a, X], table[a, Y], table[b, X], table[b, Y]
    long, upper, lower = _edge(table, a, c), _edge(table, a, b), _edge(table, b, c)
    first = max(_after(ay), first_row)
    last = min(_after(table[c, Y]), first_row + len(samples))
    turn = _after(by)
    for row in range(first, last):
        middle = F(row) + F(0.5)
        one = ax + long * (middle - ay)
        other = bx + (upper if row < turn else lower) * (middle - by)
        start = max(_after(min(one, other)), 0)
        end = min(_after(max(one, other)), samples.shape[1])
        if start >= end:
            continue
        # Whole vectors, those samples of which count that lie between the edges.
        left = start & ~(TILE - 1)
        count = _whole(end - left, TILE)
        span = samples[row - first_row, left : left + count]
        begin, stop = I4(start - left), I4(end - left)
        dx, dy = F(left) - x, F(row) - top
        value = z + per_y * dy + per_x * dx
        if not is_thin:
            for k in range(count):
                at = I4(k)
                key = _key(value + per_x * F(at), f)
                span[k] = min(span[k], key if (begin <= at) & (at < stop) else _EMPTY)
        elif _is_nearer(count, span, value, per_x, begin, stop):
            _fill_thin(count, span, value, per_x, f, alpha, u + u_x * dx + u_y * dy, u_x,
                       v + v_x * dx + v_y * dy, v_x, row, begin, stop)  # fmt: skip


@kernel
def _is_nearer(count: Any, span: Any, value: Any, per_x: Any, begin: Any, stop: Any) -> Any:
    """Whether a face is nearer than what is drawn at some sample of a row."""
    found = I4(0)
    for k in range(count):
        at = I4(k)
        is_nearer = F(value + per_x * F(at)).view(I4) <= I4(span[k] >> 32)
        found |= I4(is_nearer & (begin <= at) & (at < stop))
    return found


@kernel
def _whole(count: Any, size: Any) -> Any:
    """Numbers of the vectors that hold `count`, 1 or more, so that the compiler knows it."""
    return ((count - 1) & 0xFFFFFF | (size - 1)) + 1


@kernel
def _after(place: Any) -> Any:
    """First sample whose middle is not before a place."""
    return np.int64(np.ceil(place - F(0.5)))


@kernel
def _slope(table: Any, a: Any, b: Any, c: Any, of: Any, along: Any) -> Any:
    """How a column runs over a face: per x, or less that per y."""
    x, y = table[a, X], table[a, Y]
    area = (table[b, X] - x) * (table[c, Y] - y) - (table[b, Y] - y) * (table[c, X] - x)
    to_b, to_c = table[b, of] - table[a, of], table[c, of] - table[a, of]
    start = table[a, along]
    return (to_b * (table[c, along] - start) - to_c * (table[b, along] - start)) / area


@kernel
def _edge(table: Any, top: Any, bottom: Any) -> Any:
    """Columns per row of an edge; 0 of a level one, which no row crosses."""
    height = table[bottom, Y] - table[top, Y]
    return (table[bottom, X] - table[top, X]) / height if height > 0 else F(0)


@kernel
def _key(depth: Any, f: Any) -> Any:
    return np.int64(F(depth).view(np.int32)) << 32 | f


@kernel
def _depth(key: Any) -> Any:
    return np.int32(key >> 32).view(F)


@kernel
def _fill_thin(
    count: Any, span: Any, value: Any, per_x: Any, f: Any, alpha: Any, u: Any, u_x: Any, v: Any, v_x: Any,
    row: Any, begin: Any, stop: Any,
) -> None:  # fmt: skip
    """Write a face with alpha in one row."""
    last = I4(len(alpha) - 1)
    even, odd = _THRESHOLDS[row & 1, 0], _THRESHOLDS[row & 1, 1]
    for k in range(count):
        at = I4(k)
        across, down = I4(u + u_x * F(at)), I4(v + v_x * F(at))
        right, below = min(max(I4(across >> 8), I4(0)), last), min(max(I4(down >> 8), I4(0)), last)
        across, down = I4(across & 255), I4(down & 255)
        four = I4(alpha[np.uint32(below), np.uint32(right)])
        rows = I4(I4(four & 0xFF00FF) * I4(256 - across)) + I4(I4(four >> 8 & 0xFF00FF) * across)
        cover = I4(I4(rows & 0xFFFF) * I4(256 - down)) + I4(I4(rows >> 16 & 0xFFFF) * down)
        is_there = (I4(cover) > (odd if at & 1 else even)) & (begin <= at) & (at < stop)
        span[k] = min(span[k], _key(value + per_x * F(at), f) if is_there else _EMPTY)


@kernel
def _is_behind(table: Any, a: Any, b: Any, c: Any, far: Any, first_row: Any) -> Any:
    """Whether a face lies behind all samples of the tiles of a band that it touches."""
    left = min(table[a, X], table[b, X], table[c, X])
    right = max(table[a, X], table[b, X], table[c, X])
    top = min(table[a, Y], table[b, Y], table[c, Y]) - F(first_row)
    bottom = max(table[a, Y], table[b, Y], table[c, Y]) - F(first_row)
    near = min(table[a, Z], table[b, Z], table[c, Z])
    for row in range(max(int(top) // TILE, 0), min(int(bottom) // TILE + 1, far.shape[0])):
        for column in range(max(int(left) // TILE, 0), min(int(right) // TILE + 1, far.shape[1])):
            if near < far[row, column]:
                return False
    return True


@kernel
def _farthest(samples: Any, far: Any) -> None:
    """Write the largest depth of each tile of `TILE` by `TILE` samples."""
    for row in range(far.shape[0]):
        for column in range(far.shape[1]):
            most = I4(0)
            for line in samples[row * TILE : (row + 1) * TILE, column * TILE : (column + 1) * TILE]:
                for k in range(len(line)):
                    most = max(most, I4(line[k] >> 32))
            far[row, column] = I4(most).view(F)


@kernel
def _color(
    row: Any, samples: Any, faces: Any, table: Any, kind: Any, part: Any, to_eye: Any, atlas: Any,
    creases: Any, pores: Any, step: Any, empty: Any, places: Any, shown: Any, columns: Any,
    picture: Any,
) -> None:  # fmt: skip
    """Write a row (W, 3) of the faces at its two rows of samples.

    Light is worked out once a pixel for each surface that its samples show (multisampling), of
    many pixels together: loops that compile to instructions on many numbers.
    """
    for left in range(0, len(picture), PLACES // 4):
        right = min(left + PLACES // 4, len(picture))
        count = _find(row, left, right, samples, part, step, places, shown, columns)
        if count:
            whole = _whole(count, WIDE)  # the last vector has copies
            for i in range(count, whole):
                shown[i], columns[i] = shown[count - 1], columns[count - 1]
                places[PLACES * X + i] = places[PLACES * X + count - 1]
                places[PLACES * Y + i] = places[PLACES * Y + count - 1]
            _interpolate(whole, faces, table, kind, places, shown)
            _paint(whole, row, to_eye, atlas, creases, pores, places, columns)
            _light(whole, places)
        i = 0
        for column in range(left, right):
            bare = empty[column]
            red, green, blue = bare[0], bare[1], bare[2]
            while i < count and columns[i] == column:
                share = F(0.25) * places[SHARE + i]
                red += share * (places[RED + i] - bare[0])
                green += share * (places[GREEN + i] - bare[1])
                blue += share * (places[BLUE + i] - bare[2])
                i += 1
            picture[column, 0] = int(red * F(255) + F(0.5))
            picture[column, 1] = int(green * F(255) + F(0.5))
            picture[column, 2] = int(blue * F(255) + F(0.5))


@kernel
def _find(
    row: Any, left: Any, right: Any, samples: Any, part: Any, step: Any, places: Any, shown: Any,
    columns: Any,
) -> Any:  # fmt: skip
    """Find the surfaces that some pixels of a row show; return how many places."""
    count = 0
    for column in range(left, right):
        first = count
        x = 2 * column
        a, b, c, d = samples[0, x], samples[0, x + 1], samples[1, x], samples[1, x + 1]
        one, far = a & _FACE, _depth(a)
        if one == b & _FACE == c & _FACE == d & _FACE:
            if one != _FACE:
                _add(places, shown, columns, count, one, far, x, 2 * row, column, F(4))
                count += 1
            continue
        if max(b, c, d) < _EMPTY and a < _EMPTY:
            apart = max(abs(_depth(b) - far), abs(_depth(c) - far), abs(_depth(d) - far))
            piece = part[one]
            is_one = piece == part[b & _FACE] == part[c & _FACE] == part[d & _FACE]
            if apart <= step and is_one:
                _add(places, shown, columns, count, one, far, x, 2 * row, column, F(4))
                count += 1
                continue
        for sample in range(4):
            sy, sx = sample // 2, 2 * column + sample % 2
            f, far = samples[sy, sx] & _FACE, _depth(samples[sy, sx])
            if f == _FACE:
                continue
            i = first
            while i < count and shown[i] != f:
                if abs(far - places[DEPTH + i]) <= step and part[f] == part[shown[i]]:
                    break
                i += 1
            if i == count:
                _add(places, shown, columns, count, f, far, sx, 2 * row + sy, column, F(0))
                count += 1
            places[SHARE + i] += F(1)
    return count


@kernel
def _add(
    places: Any, shown: Any, columns: Any, i: Any, f: Any, depth: Any, sx: Any, sy: Any,
    column: Any, share: Any,
) -> None:  # fmt: skip
    places[PLACES * X + i], places[PLACES * Y + i] = F(sx + 0.5), F(sy + 0.5)
    places[DEPTH + i], places[SHARE + i] = depth, share
    shown[i], columns[i] = f, column


@kernel
def _interpolate(
    count: Any, faces: Any, table: Any, kind: Any, places: Any, shown: Any
) -> None:  # fmt: skip
    """Write the values of the vertices at each place."""
    for i in range(count):
        a, b, c = faces[shown[i], 0], faces[shown[i], 1], faces[shown[i], 2]
        places[KIND + i] = F(kind[shown[i]])
        ax, ay = table[a, X], table[a, Y]
        bx, by, cx, cy = table[b, X] - ax, table[b, Y] - ay, table[c, X] - ax, table[c, Y] - ay
        x, y, scale = places[PLACES * X + i] - ax, places[PLACES * Y + i] - ay, F(1)
        scale /= bx * cy - by * cx
        to_b, to_c = (x * cy - y * cx) * scale, (y * bx - x * by) * scale
        for k in range(LEFT, COLUMNS):
            first = table[a, k]
            rise = to_b * (table[b, k] - first) + to_c * (table[c, k] - first)
            places[PLACES * k + i] = first + rise


@kernel
def _unit(x: Any, y: Any, z: Any) -> Any:
    scale = F(1) / np.sqrt(x * x + y * y + z * z + F(1e-12))
    return x * scale, y * scale, z * scale


@kernel
def _corner(side: Any, u: Any, v: Any) -> Any:
    """Texel left of and above a place in a picture, and how far it lies to the next ones."""
    across, down = _limited(u) * F(side) - F(0.5), _limited(v) * F(side) - F(0.5)
    x, y = min(max(I4(across), I4(0)), I4(side - 2)), min(max(I4(down), I4(0)), I4(side - 2))
    return np.uint32(x), np.uint32(y), _limited(across - F(x)), _limited(down - F(y))


@kernel
def _between(a: Any, b: Any, share: Any) -> Any:
    return a + share * (b - a)


@kernel
def _texels(picture: Any, x: Any, y: Any) -> Any:
    """Four texels, from `_corner`: each is four channels of a byte, the first one lowest."""
    right, below = x + np.uint32(1), y + np.uint32(1)
    return picture[y, x], picture[y, right], picture[below, x], picture[below, right]


@kernel
def _channel(texels: Any, across: Any, down: Any, k: Any) -> Any:
    """One channel between four texels."""
    a, b, c, d = texels
    high = _between(_byte(a, k), _byte(b, k), across)
    return _between(high, _between(_byte(c, k), _byte(d, k), across), down)


@kernel
def _byte(texel: Any, k: Any) -> Any:
    return F(I4(texel >> np.uint32(8 * k)) & I4(255))


@kernel
def _paint(
    count: Any, row: Any, to_eye: Any, atlas: Any, creases: Any, pores: Any, places: Any,
    columns: Any,
) -> None:  # fmt: skip
    """Put the maps, and what each kind of surface has, into the places of a row."""
    for i in range(count):
        kind, accent = places[KIND + i], places[ACCENT + i]
        x, y, across, down = _corner(len(atlas), places[U + i], places[V + i])
        texels = _texels(atlas, x, y)
        red = places[RED + i] * _channel(texels, across, down, 0) * F(1 / 255)
        green = places[GREEN + i] * _channel(texels, across, down, 1) * F(1 / 255)
        blue = places[BLUE + i] * _channel(texels, across, down, 2) * F(1 / 255)
        inside = max(-accent if kind == _SKIN else accent, F(0))
        dark = inside if kind <= _SKIN else F(0)  # of the mouth
        kept, deep = F(1) - _DIM * dark, dark * dark
        places[RED + i] = _between(red * kept, _DEEP[0], deep)
        places[GREEN + i] = _between(green * kept, _DEEP[1], deep)
        places[BLUE + i] = _between(blue * kept, _DEEP[2], deep)
        places[GLOSS + i] *= F(1) - dark
        places[CREASE + i] = max(accent, F(0)) if kind == _SKIN else F(0)
    x_eye, y_eye, z_eye = (
        to_eye[0, 0] + F(row) * to_eye[2, 0], to_eye[0, 1] + F(row) * to_eye[2, 1],
        to_eye[0, 2] + F(row) * to_eye[2, 2],
    )  # fmt: skip
    has_crease, has_eye = F(0), F(0)
    for i in range(count):
        has_crease = max(has_crease, places[CREASE + i])
        has_eye = max(has_eye, F(1) if places[KIND + i] == _EYE else F(0))
    for i in range(count):
        kind, red = places[KIND + i], places[RED + i]
        nx, ny, nz = _unit(places[NX + i], places[NY + i], places[NZ + i])
        across = F(I4(columns[i]))
        vx, vy, vz = _unit(
            x_eye + across * to_eye[1, 0], y_eye + across * to_eye[1, 1],
            z_eye + across * to_eye[1, 2],
        )  # fmt: skip
        is_thin = (kind == _HAIR) | (kind >= _CLOTH)
        back = F(2) * min(nx * vx + ny * vy + nz * vz, F(0)) if is_thin else F(0)
        is_skin = F(1) if kind == _SKIN else F(0)
        is_cloth = F(1) if kind == _CLOTH else F(0)
        often, side = F(PORES) + is_cloth * F((CLOTH_PORES - 1) * PORES), len(pores)
        u, v = places[U + i] * often, places[V + i] * often
        x = np.uint32(min(I4((u - np.floor(u)) * F(side)), I4(side - 1)))
        y = np.uint32(min(I4((v - np.floor(v)) * F(side)), I4(side - 1)))
        pore = pores[y, x]
        grain = _byte(pore, 0) * F(1 / 127.5) - F(1)
        tilt = is_skin * _PORE_TILT
        places[NX + i] = nx - back * vx + tilt * (_byte(pore, 1) * F(1 / 127.5) - F(1))
        places[NY + i] = ny - back * vy + tilt * (_byte(pore, 2) * F(1 / 127.5) - F(1))
        places[NZ + i] = nz - back * vz
        places[GLOSS + i] *= F(1) + _PORE_GLOSS * is_skin * grain
        places[KEPT + i] = F(1) + (_PORE_SHADE * is_skin + F(CLOTH_SHADE) * is_cloth) * grain
        places[STRAND + i] = min(F(3) * red, F(1)) if kind == _HAIR else F(1)
        places[RIM + i] = F(0) if kind == _EYE else _HAIR_RIM if kind == _HAIR else _RIM
        places[WINDOW + i] = F(0)
        places[TO_EYE + i], places[TO_EYE + PLACES + i] = vx, vy
        places[TO_EYE + 2 * PLACES + i] = vz
        for k in range(3):
            places[WRAP + k * PLACES + i] = _WRAP[np.uint32(kind), k]
            places[SLOPE + k * PLACES + i] = _SLOPE[np.uint32(kind), k]
    if has_crease > F(0.01):
        _crease(count, creases, places)
    if has_eye > F(0):
        for i in range(count):
            if places[KIND + i] == _EYE:
                wet = min(max(F(2.4) - F(4.5) * places[BLUE + i], F(0.2)), F(1))
                wet *= F(1) - F(0.6) * places[ACCENT + i]
                for k in range(3):
                    paint = places[RED + k * PLACES + i]
                    lit = F(1) - _UNDER_LID[k] * places[ACCENT + i]
                    places[RED + k * PLACES + i] = paint * lit * (F(1) + _IRIS * (F(1) - paint))
                places[STRAND + i] = F(0)
                places[WINDOW + i] = wet * _window(
                    places[NX + i], places[NY + i], places[NZ + i], places[TO_EYE + i],
                    places[TO_EYE + PLACES + i], places[TO_EYE + 2 * PLACES + i],
                )  # fmt: skip


@kernel
def _crease(count: Any, creases: Any, places: Any) -> None:
    """Tilt the normals of a row by the map of creases, and darken what lies in them."""
    for i in range(count):
        crease = places[CREASE + i]
        x, y, across, down = _corner(len(creases), places[U + i], places[V + i])
        texels, most = _texels(creases, x, y), crease * _CREASE_TILT
        tilt = most * F(1 / 127.5)
        nx = places[NX + i] + tilt * _channel(texels, across, down, 0) - most
        ny = places[NY + i] + tilt * _channel(texels, across, down, 1) - most
        nz = places[NZ + i] + tilt * _channel(texels, across, down, 2) - most
        dark = crease * (F(1) - _channel(texels, across, down, 3) * F(1 / 255))
        places[KEPT + i] *= F(1) - dark
        places[RED + i] *= F(1) + _CREASE_RED * dark
        places[NX + i], places[NY + i], places[NZ + i] = nx, ny, nz


@kernel
def _window(nx: Any, ny: Any, nz: Any, vx: Any, vy: Any, vz: Any) -> Any:
    """Reflections of a window and of the sky on a wet eye."""
    facing = F(2) * (nx * vx + ny * vy + nz * vz)
    x, y, z = facing * nx - vx, facing * ny - vy, facing * nz - vz
    turn = -_WINDOW_TURN * vx
    cx, cy, cz = _unit(_CATCH[0] + turn, _CATCH[1], _CATCH[2])
    edge = x * cx + y * cy + z * cz - _WINDOW_BEGIN
    glow = _limited(edge / (_WINDOW_END - _WINDOW_BEGIN))
    glow = glow * glow * (F(3) - F(2) * glow)
    return _WINDOW_LIGHT * glow * glow + F(0.03) * _limited(y + F(0.3))


@kernel
def _light(count: Any, places: Any) -> None:
    """Put light on the paint of each place: the sRGB colour, 0 to 1, of `shading.glsl()`."""
    for i in range(count):
        kind = places[KIND + i]
        is_hair, is_skin = F(1) if kind == _HAIR else F(0), F(1) if kind == _SKIN else F(0)
        nx, ny, nz = _unit(places[NX + i], places[NY + i], places[NZ + i])
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
        glow = (F(1) - ambient) * (F(1) - ambient) * (F(1) if kind <= _SKIN else F(0))
        red, green, blue = red + glow * _GLOW[0], green + glow * _GLOW[1], blue + glow * _GLOW[2]
        sheen, window, strands = _SHEEN * rim * ambient, places[WINDOW + i], places[STRAND + i]
        shine_r = window + sheen * _SKY[0]
        shine_g = window + sheen * _SKY[1]
        shine_b = window + sheen * _SKY[2]
        power = F(14) + F(340) * gloss * gloss
        strength = F(0.16) * min(gloss, F(0.28))
        strength += F(0.50) * gloss * gloss * np.sqrt(max(gloss, F(0)))
        strength *= strands
        aslant = _STRANDS * (strands - F(0.6))
        for k in range(N_LIGHTS):
            dx, dy, dz = _TO_LIGHT[k, 0], _TO_LIGHT[k, 1], _TO_LIGHT[k, 2]
            cosine = nx * dx + ny * dy + nz * dz
            seen = places[SEEN + i] if k == 0 else min(F(0.35) + F(0.65) * ambient, F(3) * ambient)
            bleed = seen * (F(1) - seen) * is_skin
            lit = _wrapped(cosine, places[WRAP + i], places[SLOPE + i])
            red += _COLOR[k, 0] * lit * (seen + F(0.3) * bleed)
            lit = _wrapped(cosine, places[WRAP + PLACES + i], places[SLOPE + PLACES + i])
            green += _COLOR[k, 1] * lit * (seen + F(0.12) * bleed)
            lit = _wrapped(cosine, places[WRAP + 2 * PLACES + i], places[SLOPE + 2 * PLACES + i])
            blue += _COLOR[k, 2] * lit * seen
            along = F(1) + dx * vx + dy * vy + dz * vz
            both = np.sqrt(max(F(2) * along, F(1e-6)))
            half = _limited((cosine + facing) / both)
            fall = (ny * (cosine + facing) - dy - vy) / (both * level) + aslant
            strand = max(F(1) - fall * fall, F(0)) * is_hair
            gate = _limited(F(5) * cosine)
            gate += is_hair * (_limited(F(0.3) + cosine) - gate)
            half = max(strand, half * (F(1) - is_hair))
            shine = gate * half / (power - power * half + half) * strength * seen
            shine_r += shine * _COLOR[k, 0]
            shine_g += shine * _COLOR[k, 1]
            shine_b += shine * _COLOR[k, 2]
        kept, bare, tint = places[KEPT + i], F(1) - is_hair, is_hair * _TINT
        paint_r, paint_g, paint_b = places[RED + i], places[GREEN + i], places[BLUE + i]
        places[RED + i] = _display(paint_r, kept * red, shine_r * (bare + tint * paint_r))
        places[GREEN + i] = _display(paint_g, kept * green, shine_g * (bare + tint * paint_g))
        places[BLUE + i] = _display(paint_b, kept * blue, shine_b * (bare + tint * paint_b))


@kernel
def _limited(x: Any) -> Any:
    return min(max(x, F(0)), F(1))


@kernel
def _wrapped(cosine: Any, wrap: Any, slope: Any) -> Any:
    lit = _limited((cosine + wrap) * slope)
    return lit * (F(0.72) + F(0.28) * lit)


@kernel
def _display(paint: Any, light: Any, shine: Any) -> Any:
    linear = paint * paint * light + shine
    return np.sqrt(_limited(linear * F(1.12) / (F(1) + F(0.12) * linear)))


def digest() -> bytes:
    """Hash of all that the bitcode is made of."""
    sources = [Path(str(module.__file__)) for module in (mesh, shading, compiled)]
    text = "".join(path.read_text(encoding="utf-8") for path in [*sources, Path(__file__)])
    return sha256(text.encode()).digest()


def build(name: str) -> bytes:
    """Compile one of `KERNELS` to bitcode, which any processor takes."""
    vars(config)["OPT"] = config._OptLevel(0)  # LLVM below is told that arrays do not overlap
    llvm.initialize_native_target()
    machine = llvm.Target.from_triple("x86_64-linux").create_target_machine(
        PROCESSOR, "-prefer-256-bit", opt=3
    )
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization = options.slp_vectorization = True
    options.loop_interleaving = False
    signature = tuple(
        types.Array(numba.from_dtype(np.dtype(kind[:2])), int(kind[2]), "C")
        for kind in KERNELS[name].split()
    )
    dispatcher = globals()[name]
    dispatcher.compile(signature)
    found = dispatcher.overloads[signature]
    text = re.sub(
        rf'(define [^\n]*@"?{re.escape(found.fndesc.llvm_func_name)}"?\()([^\n]*)',
        lambda line: line[1] + re.sub(r"ptr (?!noalias)", "ptr noalias ", line[2]),
        found.library.get_llvm_str(),
    )
    module = llvm.parse_assembly(text)
    for value in [*module.functions, *module.global_variables]:
        if value.name == found.fndesc.llvm_func_name:
            value.name = name
        elif not value.is_declaration:
            value.linkage = "internal"
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.add_strip_dead_prototype_pass()
    passes.run(module, builder)
    unknown = [f.name for f in module.functions if f.is_declaration and f.name[:5] != "llvm."]
    assert not unknown, f"not of this kernel: {unknown}"
    module.triple, module.data_layout, module.name = "", "", name
    return bytes(module.as_bitcode())


if __name__ == "__main__":
    for kernel_name in KERNELS:
        file_of(kernel_name).write_bytes(digest() + build(kernel_name))
