"""A z-buffer rasteriser in numpy: no OpenGL, no compiled code.

Triangles are grouped by the size of their bounding box; each group tests all its pixels at once.
The nearest fragment of every pixel is then shaded.
"""

import numpy as np

from rig.face.mesh import Array, Index, Mask, Mesh
from rig.face.render.camera import View
from rig.face.render.lettering import Picture
from rig.face.render.shading import background, shade


class SoftwareRenderer:
    """Draws one mesh's poses; `supersample` squared samples a pixel."""

    def __init__(self, mesh: Mesh, size: tuple[int, int], view: View, supersample: int = 2) -> None:
        self.mesh, self.size, self.view, self.supersample = mesh, size, view, supersample

    def draw(self, vertices: Array, normals: Array) -> Picture:
        """Picture (height, width, 3) uint8 of the mesh with these vertices and normals."""
        width, height = (n * self.supersample for n in self.size)
        clip = np.c_[vertices, np.ones(len(vertices))] @ self.view.matrix(width / height).T
        screen = clip[:, :3] / clip[:, 3:]
        xy = (screen[:, :2] * [0.5, -0.5] + 0.5) * [width, height]
        faces = self.mesh.faces[_is_front(xy, self.mesh.faces)]
        pixel, face, bary = _visible(xy, screen[:, 2], faces, width, height)
        corners = faces[face]

        def across(values: Array) -> Array:
            return np.asarray(np.einsum("fk,fkc->fc", bary, values[corners]))

        points = across(vertices)
        to_eye = np.array(self.view.position) - points
        to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)
        paint = across(np.c_[self.mesh.colors, self.mesh.gloss])
        picture = np.broadcast_to(background(height), (height, width, 3)).copy()
        picture.reshape(-1, 3)[pixel] = shade(paint[:, :3], across(normals), to_eye, paint[:, 3])
        k = self.supersample
        mean = picture.reshape(height // k, k, width // k, k, 3).mean((1, 3))
        return np.asarray(mean * 255 + 0.5, np.uint8)

    def close(self) -> None:
        """Nothing to free."""


def _is_front(xy: Array, faces: Index) -> Mask:
    """Faces whose corners run counter-clockwise on a screen whose y axis points down."""
    a, b, c = (xy[faces[:, k]] for k in range(3))
    return np.asarray(
        (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) < (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    )


def _visible(
    xy: Array, depth: Array, faces: Index, width: int, height: int
) -> tuple[Index, Index, Array]:
    """Pixel index, face and barycentric weights of every visible sample."""
    corner = xy[faces]
    low = np.floor(corner.min(1)).astype(np.int64)
    extent = (np.ceil(corner.max(1)) - low).max(1)
    low_in, high_in = corner.max(1), corner.min(1)
    on_screen = (low_in > 0).all(1) & (high_in < [width, height]).all(1)
    found = [_fragments(corner, low, np.zeros(0, np.int64), 1, width, height)]
    smallest = 0.0
    for box in (2, 4, 6, 9, 14, 24, 48, 96, 192, 384, 10_000):
        group = np.flatnonzero(on_screen & (extent <= box) & (extent > smallest))
        smallest = box
        if len(group):
            side = min(box, int(extent[group].max()))
            for part in np.array_split(group, max(1, len(group) * side * side // 2_000_000)):
                found.append(_fragments(corner, low, part, side, width, height))
    pixel, face, bary = (np.concatenate(column) for column in zip(*found, strict=True))
    z = (bary * depth[faces[face]]).sum(1)
    nearest = np.full(width * height, np.inf)
    np.minimum.at(nearest, pixel, z)
    wins = z <= nearest[pixel]
    return pixel[wins], face[wins], bary[wins]


def _fragments(
    corner: Array, low: Index, group: Index, side: int, width: int, height: int
) -> tuple[Index, Index, Array]:
    """Samples inside the triangles of one group whose boxes are at most `side` pixels wide."""
    step = np.stack(np.meshgrid(np.arange(side), np.arange(side), indexing="ij"), -1).reshape(-1, 2)
    pixel = low[group][:, None] + step  # (group, side * side, 2)
    a, b, c = (corner[group][:, k] for k in range(3))
    ab, ac = b - a, c - a
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    safe = np.where(np.abs(area) < 1e-9, np.inf, area)[:, None]
    ap = pixel + 0.5 - a[:, None]
    v = (ap[..., 0] * ac[:, None, 1] - ap[..., 1] * ac[:, None, 0]) / safe
    w = (ab[:, None, 0] * ap[..., 1] - ab[:, None, 1] * ap[..., 0]) / safe
    u = 1 - v - w
    inside = (u >= 0) & (v >= 0) & (w >= 0) & np.isfinite(safe)
    inside &= (pixel >= 0).all(-1) & (pixel < [width, height]).all(-1)
    which, where = np.nonzero(inside)
    at = pixel[which, where]
    bary = np.stack([u[which, where], v[which, where], w[which, where]], -1)
    return at[:, 1] * width + at[:, 0], group[which], bary
