"""Scan conversion in numpy: the nearest triangle at every sample of a picture.

A triangle becomes one span of samples for each row it crosses, and spans become fragments; all
triangles go through each step together. Depth and triangle share one integer, so that the
nearest fragment is a minimum.
"""

from dataclasses import dataclass

import numpy as np

from rig.arrays import Float32, Int32, Int64

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
    for cut in _cuts(spans.length):
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


def _cuts(lengths: Int32) -> list[Int64]:
    """Spans in groups whose samples fit a processor's cache."""
    ends = np.cumsum(lengths)
    stops = np.arange(FRAGMENTS, ends[-1] if len(ends) else 0, FRAGMENTS)
    return np.split(np.arange(len(ends)), np.searchsorted(ends, stops))


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
