"""Source of ``kernels.bc``, the compiled loops of the software renderer: scan conversion and light.

They take the places of the fragment stage of a graphics card; `shading.glsl()` is the same light.
``python -m rig.face.render.kernels`` compiles them by numba to LLVM's bitcode of no particular
processor; `rig.face.render.compiled` makes machine code of that, in a tenth of a second and without
numba.
"""

# mypy: allow-untyped-decorators, allow-untyped-calls, allow-any-generics

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
from rig.face.render.compiled import FILE, KERNELS, PLACES, THRESHOLDS, TILE

F = np.float32
_TO_LIGHT, _COLOR = shading.TO_LIGHT.astype(F), shading.LIGHT_COLORS.astype(F)
_WRAP = shading.WRAPS.astype(F)
_SLOPE = 1 / (1 + _WRAP)
_SKY, _GROUND = np.array(shading.SKY, F), np.array(shading.GROUND, F)
N_LIGHTS, _PORE_TILT = len(_COLOR), F(shading.PORE_TILT)

kernel = njit(fastmath=True, error_model="numpy", _nrt=False)

_THRESHOLDS = np.array(THRESHOLDS, F)

# Columns of a vertex: place on the screen (2), normal (3), paint (4), light (2), accent, uv (2).
X, Y, NORMAL, COLUMNS = 0, 1, 2, 14
# Where the rows of numbers of places begin in one array, those of the vertices first. With known
# distances between rows the compiler can tell that they do not overlap.
NX, NY, NZ, RED, GREEN, BLUE, GLOSS, AMBIENT, SEEN, ACCENT, U, V = (
    PLACES * column for column in range(NORMAL, COLUMNS)
)
DEPTH, SHARE, STRAND, KEPT, BLEED, RIM, WINDOW, IS_HAIR = (
    PLACES * row for row in range(COLUMNS, COLUMNS + 8)
)
TO_EYE, WRAP, SLOPE = 22 * PLACES, 25 * PLACES, 28 * PLACES


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
def fill(
    x: Any, y: Any, z: Any, uv: Any, alpha: Any, faces: Any, first: Any, one_sided: Any,
    solid: Any, far: Any, nearest: Any, depth: Any,
) -> None:  # fmt: skip
    """Write the nearest face, from `first` on, and its depth at every sample (H, W).

    Of the first `one_sided` faces only those that show their outside (counter-clockwise, y
    downwards) are drawn. Faces from `solid` on cover those samples where `alpha` (A, A) at `uv`
    (V, 2) is above the threshold of the sample within its pixel, which makes soft edges.

    Neighbours compute a shared edge from its upper to its lower end, with the same numbers: they
    share no sample and leave none out. Faces behind `far`, the depth of tiles of samples
    (`farthest`), are left out.
    """
    height, width = nearest.shape
    for f in range(first, len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        area = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
        if area > F(-1e-6) and (f < one_sided or area < F(1e-6)):
            continue
        left, right = min(x[a], x[b], x[c]), max(x[a], x[b], x[c])
        top, bottom = min(y[a], y[b], y[c]), max(y[a], y[b], y[c])
        if right <= 0 or left >= width or bottom <= 0 or top >= height:
            continue
        if _is_behind(left, right, top, bottom, min(z[a], z[b], z[c]), far):
            continue
        scale = F(1) / area
        per_x = _per_x(z[a], z[b], z[c], y, a, b, c) * scale
        per_y = -_per_x(z[a], z[b], z[c], x, a, b, c) * scale
        origin = a
        if y[b] < y[a]:
            a, b = b, a
        if y[c] < y[a]:
            a, c = c, a
        if y[c] < y[b]:
            b, c = c, b
        long, upper, lower = _slope(x, y, a, c), _slope(x, y, a, b), _slope(x, y, b, c)
        middle = int(np.ceil(y[b] - 0.5))
        for row in range(max(int(np.ceil(y[a] - 0.5)), 0), min(int(np.ceil(y[c] - 0.5)), height)):
            at = row + 0.5
            one = x[a] + long * (at - y[a])
            other = x[a] + upper * (at - y[a]) if row < middle else x[b] + lower * (at - y[b])
            start = max(int(np.ceil(min(one, other) - 0.5)), 0)
            end = min(int(np.ceil(max(one, other) - 0.5)), width)
            dx, dy = F(start + 0.5 - x[origin]), F(at - y[origin])
            value = z[origin] + per_y * dy + per_x * dx
            if f < solid:
                for column in range(start, end):
                    if value < depth[row, column]:
                        depth[row, column] = value
                        nearest[row, column] = f
                    value += per_x
            elif start < end:
                _fill_thin(x, y, uv, alpha, faces[f], scale, row, start, end, value, per_x, f,
                           nearest, depth)  # fmt: skip


@kernel
def _per_x(va: Any, vb: Any, vc: Any, y: Any, a: Any, b: Any, c: Any) -> Any:
    """How a value changes along a row times twice the face's area."""
    return (vb - va) * (y[c] - y[a]) - (vc - va) * (y[b] - y[a])


@kernel
def _fill_thin(
    x: Any, y: Any, uv: Any, alpha: Any, face: Any, scale: Any, row: Any, start: Any, end: Any,
    value: Any, per_x: Any, f: Any, nearest: Any, depth: Any,
) -> None:  # fmt: skip
    """Write a face with alpha in one row."""
    a, b, c = face[0], face[1], face[2]
    side = F(len(alpha)) * scale
    u_x = _per_x(uv[a, 0], uv[b, 0], uv[c, 0], y, a, b, c) * side
    u_y = -_per_x(uv[a, 0], uv[b, 0], uv[c, 0], x, a, b, c) * side
    v_x = _per_x(uv[a, 1], uv[b, 1], uv[c, 1], y, a, b, c) * side
    v_y = -_per_x(uv[a, 1], uv[b, 1], uv[c, 1], x, a, b, c) * side
    dx, dy = F(start + 0.5 - x[a]), F(row + 0.5 - y[a])
    u = uv[a, 0] * F(len(alpha)) + u_x * dx + u_y * dy
    v = uv[a, 1] * F(len(alpha)) + v_x * dx + v_y * dy
    for column in range(start, end):
        if value < depth[row, column]:
            step = F(column - start)
            cover = _cover(alpha, u + u_x * step, v + v_x * step)
            if cover > _THRESHOLDS[2 * (row % 2) + column % 2]:
                depth[row, column] = value
                nearest[row, column] = f
        value += per_x


@kernel
def _cover(alpha: Any, u: Any, v: Any) -> Any:
    """Alpha at a place in texels, between the texels."""
    last = len(alpha) - 1
    u, v = min(max(u - F(0.5), F(0)), F(last)), min(max(v - F(0.5), F(0)), F(last))
    x, y = int(u), int(v)
    right, below = min(x + 1, last), min(y + 1, last)
    across, down = u - F(x), v - F(y)
    high = _between(F(alpha[y, x]), F(alpha[y, right]), across)
    low = _between(F(alpha[below, x]), F(alpha[below, right]), across)
    return _between(high, low, down)


@kernel
def _between(a: Any, b: Any, share: Any) -> Any:
    return a + share * (b - a)


@kernel
def _is_behind(left: Any, right: Any, top: Any, bottom: Any, near: Any, far: Any) -> Any:
    """Whether what lies within bounds lies behind all samples of the tiles that it touches."""
    for row in range(max(int(top) // TILE, 0), min(int(bottom) // TILE + 1, far.shape[0])):
        for column in range(max(int(left) // TILE, 0), min(int(right) // TILE + 1, far.shape[1])):
            if near < far[row, column]:
                return False
    return True


@kernel
def farthest(depth: Any, far: Any) -> None:
    """Write the largest depth of each tile of `TILE` by `TILE` samples."""
    far[:] = 0
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            at = row // TILE, column // TILE
            far[at] = max(far[at], depth[row, column])


@kernel
def _slope(x: Any, y: Any, top: Any, bottom: Any) -> Any:
    """Of an edge: columns per row; 0 of a level one, which no row crosses."""
    height = y[bottom] - y[top]
    return (x[bottom] - x[top]) / height if height > 0 else F(0)


@kernel
def color(
    nearest: Any, depth: Any, faces: Any, table: Any, kind: Any, part: Any, to_eye: Any,
    atlas: Any, creases: Any, pores: Any, step: Any, empty: Any, places: Any, shown: Any,
    columns: Any, picture: Any,
) -> None:  # fmt: skip
    """Write a picture (H, W, 3) of the faces at its samples (2 H, 2 W).

    Light is worked out once a pixel for each surface that its samples show (multisampling), of
    many pixels together: loops that compile to instructions on many numbers. `places`
    (`ROWS` times `PLACES`), `shown` and `columns` are room for those.
    """
    height, width = picture.shape[:2]
    for row in range(height):
        red_, green_, blue_ = empty[row, 0], empty[row, 1], empty[row, 2]
        for left in range(0, width, PLACES // 4):
            right = min(left + PLACES // 4, width)
            count = _find(row, left, right, nearest, depth, faces, part, step[0], places, shown,
                          columns)  # fmt: skip
            _interpolate(count, faces, table, places, shown)
            _paint(row, count, to_eye, atlas, creases, pores, places, columns, shown, faces, kind)
            _light(count, places)
            i = 0
            for column in range(left, right):
                red, green, blue = red_, green_, blue_
                while i < count and columns[i] == column:
                    share = F(0.25) * places[SHARE + i]
                    red += share * (places[RED + i] - red_)
                    green += share * (places[GREEN + i] - green_)
                    blue += share * (places[BLUE + i] - blue_)
                    i += 1
                picture[row, column, 0] = int(red * F(255) + F(0.5))
                picture[row, column, 1] = int(green * F(255) + F(0.5))
                picture[row, column, 2] = int(blue * F(255) + F(0.5))


@kernel
def _find(
    row: Any, left: Any, right: Any, nearest: Any, depth: Any, faces: Any, part: Any, step: Any,
    places: Any, shown: Any, columns: Any,
) -> Any:  # fmt: skip
    """Find the surfaces that some pixels of a row show; return how many places."""
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
                places[X * PLACES + i], places[Y * PLACES + i] = F(sx + 0.5), F(sy + 0.5)
                places[DEPTH + i], places[SHARE + i] = far, F(0)
                shown[i], columns[i] = f, column
                count += 1
            places[SHARE + i] += F(1)
    return count


@kernel
def _interpolate(count: Any, faces: Any, table: Any, places: Any, shown: Any) -> None:
    """Write the values of the vertices at each place."""
    for i in range(count):
        a, b, c = faces[shown[i], 0], faces[shown[i], 1], faces[shown[i], 2]
        ax, ay = table[a, X], table[a, Y]
        bx, by, cx, cy = table[b, X] - ax, table[b, Y] - ay, table[c, X] - ax, table[c, Y] - ay
        x, y, scale = places[X * PLACES + i] - ax, places[Y * PLACES + i] - ay, F(1)
        scale /= bx * cy - by * cx
        to_b, to_c = (x * cy - y * cx) * scale, (y * bx - x * by) * scale
        for k in range(NORMAL, COLUMNS):
            first = table[a, k]
            rise = to_b * (table[b, k] - first) + to_c * (table[c, k] - first)
            places[k * PLACES + i] = first + rise


@kernel
def _unit(x: Any, y: Any, z: Any) -> Any:
    scale = F(1) / np.sqrt(x * x + y * y + z * z + F(1e-12))
    return x * scale, y * scale, z * scale


@kernel
def _corner(side: Any, u: Any, v: Any) -> Any:
    """Texel left of and above a place in a picture, and how far it lies to the next ones."""
    across, down = _limited(u) * F(side) - F(0.5), _limited(v) * F(side) - F(0.5)
    x, y = min(max(int(across), 0), side - 2), min(max(int(down), 0), side - 2)
    return x, y, _limited(across - F(x)), _limited(down - F(y))


@kernel
def _texel(picture: Any, x: Any, y: Any, across: Any, down: Any, k: Any) -> Any:
    """One channel of a picture between its texels, from `_corner`."""
    high = _between(F(picture[y, x, k]), F(picture[y, x + 1, k]), across)
    low = _between(F(picture[y + 1, x, k]), F(picture[y + 1, x + 1, k]), across)
    return _between(high, low, down)


@kernel
def _paint(
    row: Any, count: Any, to_eye: Any, atlas: Any, creases: Any, pores: Any, places: Any,
    columns: Any, shown: Any, faces: Any, kinds: Any,
) -> None:  # fmt: skip
    """Put the maps, and what each kind of surface has, into the places of a row."""
    for i in range(count):
        kind, u, v = kinds[faces[shown[i], 0]], places[U + i], places[V + i]
        accent = places[ACCENT + i]
        nx, ny, nz = _unit(places[NX + i], places[NY + i], places[NZ + i])
        away = to_eye[row, columns[i]]
        vx, vy, vz = away[0], away[1], away[2]
        if (kind == HAIR or kind >= CLOTH) and nx * vx + ny * vy + nz * vz < F(0):
            nx, ny, nz = -nx, -ny, -nz
        x, y, across, down = _corner(len(atlas), u, v)
        for k in range(3):
            places[RED + k * PLACES + i] *= _texel(atlas, x, y, across, down, k) * F(1 / 255)
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
            y, x = int(v * F(PORES * side)) % side, int(u * F(PORES * side)) % side
            kept = F(1) + F(0.16) * (F(pores[y, x, 0]) * F(1 / 127.5) - F(1))
            places[GLOSS + i] *= F(1) + F(0.7) * (F(pores[y, x, 0]) * F(1 / 127.5) - F(1))
            nx += _PORE_TILT * (F(pores[y, x, 1]) * F(1 / 127.5) - F(1))
            ny += _PORE_TILT * (F(pores[y, x, 2]) * F(1 / 127.5) - F(1))
            if accent > F(0.01):
                x, y, across, down = _corner(len(creases), u, v)
                tilt = accent * F(1 / 127.5)
                nx += tilt * _texel(creases, x, y, across, down, 0) - accent
                ny += tilt * _texel(creases, x, y, across, down, 1) - accent
                nz += tilt * _texel(creases, x, y, across, down, 2) - accent
                shade = F(1) - _texel(creases, x, y, across, down, 3) * F(1 / 255)
                kept *= F(1) - accent * shade
            nx, ny, nz = _unit(nx, ny, nz)
            places[KEPT + i] = kept
        places[NX + i], places[NY + i], places[NZ + i] = nx, ny, nz


@kernel
def _window(nx: Any, ny: Any, nz: Any, vx: Any, vy: Any, vz: Any) -> Any:
    """Reflection of a large lamp and of the sky on a wet eye."""
    facing = nx * vx + ny * vy + nz * vz
    dx, dy, dz = _TO_LIGHT[0, 0], _TO_LIGHT[0, 1], _TO_LIGHT[0, 2]
    toward = dx * vx + dy * vy + dz * vz
    mirror = F(2) * facing * (nx * dx + ny * dy + nz * dz) - toward
    glow = _limited((mirror - F(0.972)) / F(0.008))
    sky = _limited(F(2) * facing * ny - vy)
    return F(0.9) * glow * glow * (F(3) - F(2) * glow) + F(0.02) * sky


@kernel
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


def build() -> bytes:
    """Compile `KERNELS` to bitcode, for instructions on eight numbers, that any processor takes."""
    config.CPU_NAME, config.CPU_FEATURES = "x86-64-v3", ""
    whole = llvm.parse_assembly("")
    for name, kinds in KERNELS.items():
        signature = tuple(
            types.Array(numba.from_dtype(np.dtype(kind[:2])), int(kind[2]), "C")
            if len(kind) > 2
            else types.int64
            for kind in kinds.split()
        )
        dispatcher = globals()[name]
        dispatcher.compile(signature)
        found = dispatcher.overloads[signature]
        module = llvm.parse_assembly(found.library.get_llvm_str())
        for function in module.functions:
            if function.name == found.fndesc.llvm_func_name:
                function.name = name
            elif not function.is_declaration:
                function.linkage = "internal"
        for variable in module.global_variables:
            if not variable.is_declaration:
                variable.linkage = "internal"
        whole.link_in(module)
    llvm.initialize_native_target()
    machine = llvm.Target.from_default_triple().create_target_machine()
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.add_strip_dead_prototype_pass()
    passes.run(whole, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
    unknown = [f.name for f in whole.functions if f.is_declaration and f.name[:5] != "llvm."]
    assert not unknown, f"not of these kernels: {unknown}"
    whole.triple, whole.data_layout, whole.name = "", "", "kernels"
    return bytes(whole.as_bitcode())


if __name__ == "__main__":
    FILE.write_bytes(digest() + build())
