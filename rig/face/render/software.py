"""Rendering in numpy, without OpenGL or compiled code.

Four samples a pixel find the nearest face. Light is worked out once a pixel, and once more for
each sample on another surface than the pixel's first sample (multisampling).
"""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from rig.arrays import Float32, Float64, Int32, Int64
from rig.face.geometry.mesh import Mesh, adjacency, unit
from rig.face.render.camera import FAR, NEAR, View
from rig.face.render.picture import Picture
from rig.face.render.shading import background, shade

# Scan conversion in numpy: the nearest triangle at every sample of a picture.
#
# A triangle becomes one span of samples for each row it crosses, and spans become fragments; all
# triangles go through each step together. Depth and triangle share one integer, so that the
# nearest fragment is a minimum.

FRAGMENTS = 65_536
"""Fragments made at a time."""
_NOTHING = (int(np.float32(np.inf).view(np.int32)) << 32) | 0xFFFFFFFF


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


@dataclass(frozen=True)
class _Spans:
    """Runs of samples in one row: triangle, row, first column and length."""

    triangle: Int32
    row: Int32
    column: Int32
    length: Int32


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
    spans, depth = _spans(screen, faces), planes(screen, faces, screen.depth[:, None])
    at, per_x, per_y = (plane[:, 0] for plane in depth)
    corner = faces[spans.triangle, 0]
    slope = per_x[spans.triangle]
    start = at[spans.triangle] + slope * (middle_of(spans.column) - screen.x[corner])
    start += per_y[spans.triangle] * (middle_of(spans.row) - screen.y[corner])
    nearest = np.full(screen.width * screen.height, _NOTHING)
    # Spans in groups whose samples fit a processor's cache.
    ends = np.cumsum(spans.length)
    stops = np.arange(FRAGMENTS, ends[-1] if len(ends) else 0, FRAGMENTS)
    for cut in np.split(np.arange(len(ends)), np.searchsorted(ends, stops)):
        sample, key = _fragments(screen, spans, cut, start, slope)
        np.minimum.at(nearest, sample, key)
    shape = screen.height, screen.width
    face = nearest.astype(np.int32).reshape(shape)  # the low half; all ones read as -1
    return face, (nearest >> 32).astype(np.int32).view(np.float32).reshape(shape)


def middle_of(sample: Int64 | Int32) -> Float32:
    """Place of samples' middles, float32."""
    return sample.astype(np.float32) + np.float32(0.5)


def _fragments(
    screen: Screen, spans: _Spans, cut: Int64, start: Float32, slope: Float32
) -> tuple[Int32, Int64]:
    """Every sample of some spans, and its depth and triangle as one number."""
    length = spans.length[cut]
    step = _ramp(length)
    z = np.repeat(start[cut], length) + np.repeat(slope[cut], length) * step.astype(np.float32)
    sample = np.repeat(spans.row[cut] * screen.width + spans.column[cut], length) + step
    key = np.maximum(z, 0).view(np.int32).astype(np.int64)  # bits sort as the floats >= 0 do
    return sample, key << 32 | np.repeat(spans.triangle[cut], length)


def _ramp(counts: Int32) -> Int32:
    """0, 1, ... counts[0] - 1, 0, 1, ... counts[1] - 1, and so on."""
    ends = np.cumsum(counts, dtype=np.int32)
    total = int(ends[-1]) if len(ends) else 0
    return np.asarray(np.arange(total, dtype=np.int32) - np.repeat(ends - counts, counts))


def _first(edge: Float32, limit: int) -> Int32:
    """Index of the first sample whose centre lies at or past `edge`, within 0 .. limit."""
    return np.asarray(np.clip(np.ceil(edge - np.float32(0.5)), 0, limit), np.int32)


def _spans(screen: Screen, faces: Int64) -> _Spans:
    """Spans of all faces; neighbours share no sample and leave none out."""
    order = np.argsort(screen.y[faces], axis=1)
    high, middle, low = np.take_along_axis(faces, order, axis=1).T
    y_high, y_middle = screen.y[high], screen.y[middle]
    first = _first(y_high, screen.height)
    rows = _first(screen.y[low], screen.height) - first
    triangle = np.repeat(np.arange(len(faces), dtype=np.int32), rows)
    row = _ramp(rows) + first[triangle]
    y = middle_of(row)
    long_edge = _along(screen, high, low, triangle, y)
    is_above = y < y_middle[triangle]
    short_edge = np.where(
        is_above,
        _along(screen, high, middle, triangle, y),
        _along(screen, middle, low, triangle, y),
    )
    column = _first(np.minimum(long_edge, short_edge), screen.width)
    length = _first(np.maximum(long_edge, short_edge), screen.width) - column
    kept = np.flatnonzero(length)
    return _Spans(triangle[kept], row[kept], column[kept], length[kept])


def _along(screen: Screen, top: Int64, bottom: Int64, triangle: Int32, y: Float32) -> Float32:
    """Where the edge from `top` to `bottom` of each span's triangle crosses the span's row.

    Both triangles at an edge compute the same numbers, so no crack opens between them.
    """
    height = screen.y[bottom] - screen.y[top]
    slope = (screen.x[bottom] - screen.x[top]) / np.where(height == 0, np.float32(1), height)
    x, y_top = screen.x[top], screen.y[top]
    return np.asarray(x[triangle] + slope[triangle] * (y - y_top[triangle]))


T = TypeVar("T", bound=np.generic)
STEP_CM = 0.2
"""Largest difference of depth between samples of one surface."""
CHUNK = 8192
"""Pixels shaded at a time: few enough for a processor's cache."""


class SoftwareRenderer:
    """Draws one mesh's poses."""

    def __init__(self, mesh: Mesh, size: tuple[int, int], view: View) -> None:
        self._faces, self._size = mesh.faces, size
        self._matrix = view.matrix(size[0] / size[1])
        self._paint = np.c_[mesh.colors, mesh.gloss].astype(np.float32)
        self._part = _parts(mesh)
        # Unit vectors (3, height * width) from what each pixel shows towards the camera.
        width, height = size
        x, y = (np.arange(width) + 0.5) / width, (np.arange(height)[:, None] + 0.5) / height
        far = np.stack(np.broadcast_arrays(2 * x - 1, 1 - 2 * y, 1.0, 1.0), -1).reshape(-1, 4)
        point = far @ np.linalg.inv(self._matrix).T
        away = np.array(view.position) - point[:, :3] / point[:, 3:]
        self._to_eye = np.ascontiguousarray(unit(away).T, np.float32)
        rows = (background(size[1])[:, 0] * 255).astype(np.float32)
        self._empty = np.repeat(rows, size[0], axis=0).T.copy()
        distance = np.linalg.norm(np.subtract(view.position, view.target))
        self._step = np.float32(STEP_CM * NEAR * FAR / (FAR - NEAR) / distance**2)

    def draw(self, vertices: Float64, normals: Float64) -> Picture:
        """Picture (height, width, 3) uint8 of the mesh with these vertices and normals."""
        width, height = 2 * self._size[0], 2 * self._size[1]
        clip = vertices @ self._matrix[:, :3].T + self._matrix[:, 3]
        x, y, z = (clip[:, :3] / clip[:, 3:]).astype(np.float32).T
        screen = Screen(
            width, height, (x + 1) * (width / 2), (1 - y) * (height / 2), np.maximum(z + 1, 0) / 2
        )
        faces = front_faces(screen, self._faces)
        nearest, depths = nearest_faces(screen, faces)
        face, depth = _by_pixel(nearest), _by_pixel(depths)
        surfaces = _Surfaces(screen, faces, np.c_[normals, self._paint].astype(np.float32))
        picture = self._empty.copy()
        drawn = np.flatnonzero(face[0] >= 0)
        picture[:, drawn] = self._colors(surfaces, drawn, face[0, drawn], 0)
        more = np.zeros_like(picture)
        for sample in (1, 2, 3):
            at = self._differs(faces, face, depth, sample)
            own, is_empty = face[sample, at], face[sample, at] < 0
            color = np.where(is_empty, self._empty[:, at], 0)
            color[:, ~is_empty] = self._colors(surfaces, at[~is_empty], own[~is_empty], sample)
            more[:, at] += color - picture[:, at]
        picture += 0.25 * more
        return (picture.T + np.float32(0.5)).astype(np.uint8).reshape(*self._size[::-1], 3)

    def close(self) -> None:
        """Nothing to free."""

    def _differs(self, faces: Int64, face: Int32, depth: Float32, sample: int) -> Int64:
        """Pixels with a sample on another surface than sample 0."""
        at = np.flatnonzero(face[sample] != face[0])
        part = np.append(self._part[faces[:, 0]], -1)  # face -1 is the backdrop
        is_other = part[face[sample, at]] != part[face[0, at]]
        with np.errstate(invalid="ignore"):
            is_other |= np.abs(depth[sample, at] - depth[0, at]) > self._step
        return np.asarray(at[is_other])

    def _colors(self, surfaces: "_Surfaces", pixels: Int64, face: Int32, sample: int) -> Float32:
        """Colours (3, n) 0..255 of faces seen by one sample of some pixels."""
        width = self._size[0]
        out = np.empty((3, len(pixels)), np.float32)
        for start in range(0, len(pixels), CHUNK):
            part = slice(start, start + CHUNK)
            y, x = np.divmod(pixels[part], width)
            values = surfaces.at(face[part], 2 * x + sample % 2, 2 * y + sample // 2)
            out[:, part] = shade(values[3:6], values[:3], self._to_eye[:, pixels[part]], values[6])
        return out * np.float32(255)


class _Surfaces:
    """Vertex values spread linearly over each face."""

    def __init__(self, screen: Screen, faces: Int64, values: Float32) -> None:
        corner = faces[:, 0]
        table = [screen.x[corner, None], screen.y[corner, None], *planes(screen, faces, values)]
        self._table, self._count = np.concatenate(table, axis=1), values.shape[1]

    def at(self, face: Int32, column: Int64, row: Int64) -> Float32:
        """Values (k, n) of faces (n,) at samples."""
        entry = np.ascontiguousarray(self._table.take(face, axis=0).T)
        x, y = middle_of(column) - entry[0], middle_of(row) - entry[1]
        first, per_x, per_y = entry[2:].reshape(3, self._count, -1)
        return np.asarray(first + per_x * x + per_y * y)


def _by_pixel(grid: NDArray[T]) -> NDArray[T]:
    """Samples (2 h, 2 w) as (4, h * w), so that the four of a pixel share a column."""
    height, width = grid.shape
    quads = grid.reshape(height // 2, 2, width // 2, 2).transpose(1, 3, 0, 2)
    return np.ascontiguousarray(quads).reshape(4, -1)


def _parts(mesh: Mesh) -> Int32:
    """Number (V,) of the connected piece each vertex belongs to."""
    return connected_components(adjacency(mesh.faces, len(mesh.vertices)))[1].astype(np.int32)
