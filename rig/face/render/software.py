"""Rendering without a graphics card, by compiled loops (`kernels`); four samples a pixel."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import connected_components

from rig.arrays import Float32, Float64, Int32, Int64
from rig.face.geometry.mesh import HAIR, PORES, Maps, Mesh, adjacency, unit
from rig.face.render import kernels
from rig.face.render.camera import FAR, NEAR, View
from rig.face.render.picture import Picture
from rig.face.render.shading import background


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
    kernels.fill(screen.x, screen.y, screen.depth, faces, nearest, depth)
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
        kernels.color(samples, surface, self._to_eye, self._maps, self._step, self._empty, picture)
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
