"""Rendering in numpy, without OpenGL or compiled code.

Four samples a pixel find the nearest face. Light is worked out once a pixel, and once more for
each sample on another surface than the pixel's first sample (multisampling).
"""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from rig.arrays import Float32, Float64, Int32, Int64
from rig.face.geometry.mesh import Mesh, adjacency, unit
from rig.face.render.camera import FAR, NEAR, View
from rig.face.render.picture import Picture
from rig.face.render.raster import Screen, front_faces, middle_of, nearest_faces, planes
from rig.face.render.shading import background, shade

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
