"""Rendering without a graphics card, by compiled loops; four samples a pixel."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rig.arrays import AnyFloat, Bool, Float32, Float64, Int32, Int64
from rig.face.mesh import CLOTH, FINE, FINE_CM, HAIR, PORES, SKIN, Mesh
from rig.face.render.compiled import MOST_ALPHA, PLACES, ROWS, TILE, run
from rig.face.render.picture import Picture
from rig.face.render.shading import FAR, NEAR, View, background


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
    """Faces that show their outside (counter-clockwise, y downwards)."""
    ax, bx, cx = (screen.x[faces[:, k]] for k in range(3))
    ay, by, cy = (screen.y[faces[:, k]] for k in range(3))
    return faces[(bx - ax) * (cy - ay) - (by - ay) * (cx - ax) < -1e-6]


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


def nearest_faces(screen: Screen, faces: Int64, n_first: int = 0) -> tuple[Int32, Float32]:
    """Nearest face and its depth (height, width) at every sample; -1 and inf where there is none.

    Parameters
    ----------
    screen : Screen
        The picture and where vertices fall on it.
    faces : ndarray [shape=(N, 3)]
        Faces to draw, from both sides.
    n_first : int, optional
        How many are filled first, behind which the others are left out early.
    """
    place = np.column_stack([screen.x, screen.y, screen.depth])
    room = _room(screen.width, screen.height, screen.height, len(faces))
    samples = room[-1]
    run("nearest", place, np.zeros((1, 1), np.uint32), np.ascontiguousarray(faces, np.uint32),
        np.array([n_first, 0, len(faces)]), *room)  # fmt: skip
    end = 2 * screen.width
    return samples.view(np.int32)[:, :end:2], samples.view(np.float32)[:, 1:end:2]


def _room(width: int, height: int, rows: int, faces: int) -> tuple[NDArray[Any], ...]:
    """Room for a drawing in bands of rows: ends of their faces, faces, depth of tiles, samples."""
    bands = -(-height // rows)
    return (
        np.empty(bands + 2, np.int64), np.empty((bands + 1) * faces, np.uint32),
        np.empty((-(-rows // TILE), -(-width // TILE)), np.float32),
        np.empty((rows, -(-width // TILE) * TILE), np.int64),
    )  # fmt: skip


BAND = 64
"""Rows of samples that are drawn together: they stay in the cache of a core."""
STEP_CM = 0.2
"""Largest difference of depth between samples of one surface."""


class Renderer:
    """Draws poses of one mesh, in `size` (width, height), from one view.

    `many` is for more than ten pictures: the first comes later, the others sooner.
    """

    def __init__(
        self, mesh: Mesh, size: tuple[int, int], view: View, *, many: bool = False
    ) -> None:
        self._size, matrix, self._many = size, view.matrix(size[0] / size[1]), many
        self._matrix = matrix.astype(np.float32)
        width, height = size
        distance = float(np.linalg.norm(np.subtract(view.position, view.target)))
        self._step = np.array([STEP_CM * NEAR * FAR / (FAR - NEAR) / distance**2], np.float32)
        pixels_per_cm = height / (2 * distance * np.tan(np.radians(view.degrees) / 2))
        # The maps at about one texel a pixel: means of 2 x 2 texels as often as it takes.
        maps = mesh.maps

        texels = 1.5 * pixels_per_cm * 1024
        wanted = texels / TEXELS_PER_CM

        def shrunk(picture: Picture, wanted: float) -> Picture:
            halvings = int(np.ceil(np.log2(len(picture) / wanted)))
            halvings = min(halvings, len(picture).bit_length() - 2)
            if halvings < 1:
                return picture
            mode = "RGB" if picture.shape[2] == 3 else "CMYK"  # RGBA would weigh by alpha
            image = Image.frombuffer(
                mode, picture.shape[1::-1], picture.tobytes(), "raw", mode, 0, 1
            )
            return np.asarray(image.reduce(2**halvings))

        atlas = shrunk(maps.atlas_for(wanted), wanted)
        creases = shrunk(maps.creases, wanted)
        pores = shrunk(maps.pores, texels / SKIN_TEXELS_PER_CM / PORES)
        self._maps = (_packed(atlas), _packed(creases), _packed(pores))
        alpha = atlas[..., 3]
        self._alpha = _neighbours(alpha)
        # Skin, which hides most of the others, before what has one side, two, and soft edges.
        kind = mesh.kind[mesh.faces[:, 0]]
        is_hair = np.isin(kind, (HAIR, FINE))
        group = np.where(kind == SKIN, 0, np.where(is_hair | (kind == CLOTH), 2, 1))
        hair = np.flatnonzero(is_hair)
        soft = hair[~_opaque(alpha, mesh.uv.T[:, mesh.faces[hair].T])]
        group[soft] = 3
        depth = np.zeros(len(group))  # soft ones from the front on
        depth[soft] = np.linalg.norm(mesh.vertices - view.position, axis=1)[mesh.faces[soft]].max(1)
        order = np.lexsort((depth, group))
        self._faces = mesh.faces[order].astype(np.uint32)
        self._stops = np.bincount(group, minlength=4).cumsum()[:3]
        self._weld = mesh.weld.astype(np.uint32)
        self._welded = self._weld[self._faces]
        self._kind, self._part = kind[order].astype(np.uint8), _parts(mesh)[self._faces[:, 0]]
        self._nearer = 2 * self._step * np.float32(FINE_CM / STEP_CM) * (mesh.kind == FINE)
        # Of each vertex: place on the screen (3), uv (2), normal (3), paint (4), light (2), accent.
        self._table = np.zeros((len(mesh.vertices), 15), np.float32)
        self._table[:, 3:5] = mesh.uv.clip(0, 1)
        self._table[:, 8:11], self._table[:, 11] = mesh.colors, mesh.gloss
        self._table[:, 12:14] = mesh.light
        # Towards the camera from what the first pixel shows, and how it runs per column and row.
        back = np.linalg.inv(matrix)
        back /= back[3, 2:].sum()
        x, y, far = back[:3, 0] / width, -back[:3, 1] / height, back[:3, 2:].sum(1)
        first = view.position - far - (1 - width) * x - (1 - height) * y
        self._to_eye = np.array([first, -2 * x, -2 * y], np.float32)
        self._empty = background(width, height)
        self._room = _room(2 * width, 2 * height, BAND, len(self._faces))
        self._places = (np.zeros(ROWS * PLACES, np.float32), np.zeros(PLACES, np.uint32),
                        np.zeros(PLACES, np.uint32))  # fmt: skip

    def normals(self, vertices: AnyFloat) -> Float32:
        """Unit normals (V, 3) of the mesh with these vertices (V, 3), without a seam."""
        found = np.empty(vertices.shape, np.float32)
        run("normals", np.ascontiguousarray(vertices, np.float32), self._welded, self._weld,
            found, often=self._many)  # fmt: skip
        return found

    def render(
        self,
        vertices: AnyFloat,
        normals: Float32 | None = None,
        accents: Float32 | None = None,
    ) -> Picture:
        """Picture (height, width, 3) uint8 of the mesh with these vertices (V, 3).

        `normals` (V, 3) may be given where several views share them; `accents` (V,) are those of
        `rig.face.accents` (none: 0).
        """
        if normals is None:
            normals = self.normals(vertices)
        if accents is None:
            accents = np.zeros(len(vertices), np.float32)
        picture = np.empty((*self._size[::-1], 3), np.uint8)
        run("draw", np.ascontiguousarray(vertices, np.float32), normals, accents, self._matrix,
            self._nearer, self._table, self._alpha, self._faces, self._stops, *self._room,
            self._kind, self._part, self._to_eye, *self._maps, self._step, self._empty,
            *self._places, picture, often=self._many)  # fmt: skip
        return picture


def _packed(picture: Picture) -> NDArray[np.uint32]:
    """Texels (A, A) of a picture of three or four channels, the first one lowest."""
    four = picture
    if picture.shape[2] < 4:
        four = np.zeros((*picture.shape[:2], 4), np.uint8)
        four[..., :3] = picture
    return np.ascontiguousarray(four).view("<u4")[..., 0]


def _neighbours(alpha: Picture) -> NDArray[np.uint32]:
    """Bytes of the four texels round each corner of texels, row by row."""
    edged = np.pad(alpha, 1, mode="edge")
    upper, lower = edged[:-1], edged[1:]
    four = np.empty((len(upper), len(upper), 4), np.uint8)
    for k, corner in enumerate((upper[:, :-1], upper[:, 1:], lower[:, :-1], lower[:, 1:])):
        four[..., k] = corner
    return four.view("<u4")[..., 0]


def _opaque(alpha: NDArray[np.uint8], uv: Float64) -> Bool:
    """Which faces, with corners (2, 3, N) in a picture, cover all their samples."""
    side = len(alpha)
    low = np.clip(np.floor(uv.min(1) * side - 0.5), 0, side - 1).astype(np.int64)
    high = np.clip(np.floor(uv.max(1) * side + 0.5), 0, side - 1).astype(np.int64) + 1
    if not low.size:
        return np.zeros(0, bool)
    start = low.min(1)
    (left, top), (right, bottom) = low - start[:, None], high - start[:, None]
    part = alpha[start[1] :, start[0] :][: bottom.max(), : right.max()]
    holes = np.zeros((len(part) + 1, part.shape[1] + 1), np.int32)  # above and left of each corner
    holes[1:, 1:] = (part <= MOST_ALPHA).cumsum(1, dtype=np.int32).cumsum(0, dtype=np.int32)
    found = holes[bottom, right] - holes[top, right] - holes[bottom, left] + holes[top, left]
    return np.asarray(found == 0)


def _parts(mesh: Mesh) -> Int32:
    """Least vertex (V,) of the connected piece each vertex belongs to; hair is one piece."""
    is_hair = np.isin(mesh.kind, (HAIR, FINE))
    label = mesh.weld.astype(np.int32)
    corners = label[mesh.faces[~is_hair[mesh.faces[:, 0]]]].T
    one, other = np.tile(corners[0], 2), corners[1:].ravel()
    while len(one):  # an edge gives the larger of the names at its ends the smaller one
        np.minimum.at(label, np.maximum(one, other), np.minimum(one, other))
        while not np.array_equal(label, further := label[label]):
            label = further
        one, other = label[one], label[other]
        apart = one != other
        one, other = one[apart], other[apart]
    return np.where(is_hair, np.int32(-1), label[mesh.weld])


TEXELS_PER_CM, SKIN_TEXELS_PER_CM = 28.0, 12.0
"""Of an atlas of 1,024 texels, of locks and at the middle of a face."""
