"""One picture of a whole head: what its vertex colours and its atlas make together.

For formats whose materials cannot multiply a texture by vertex colours. The left half is the skin
in its own place of the atlas; in the right one every other face has half a square.
"""

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates

from rig.arrays import Float32, Float64
from rig.face.head import Head
from rig.face.maps import ATLAS
from rig.face.render.software import Screen, nearest_faces, planes

INSET = 0.5
"""Size of a face in the picture over that of its half of a square, so that none bleeds."""
CORNERS = np.array([[[0, 0], [0, 1], [1, 0]], [[1, 1], [1, 0], [0, 1]]], np.float64)
"""Of the two halves of a square."""


def baked(head: Head, colours: Float64) -> tuple[Float64, Float32]:
    """Lay out all faces of a head and paint them.

    Parameters
    ----------
    head : Head
        Whose.
    colours : array [shape=(V, 3)]
        Linear colours of the vertices, which the atlas multiplies.

    Returns
    -------
    uv : array [shape=(N, 3, 2), range 0 to 1]
        Of the corners of each face, from the left and from the top of the picture.
    picture : array [shape=(1024, 2048, 3), range 0 to 1]
        Linear colours.
    """
    faces, atlas_uv = head.mesh.faces, head.mesh.uv[head.mesh.faces]
    place = ATLAS * atlas_uv
    to_b, to_c = place[:, 1] - place[:, 0], place[:, 2] - place[:, 0]
    is_own = to_b[:, 0] * to_c[:, 1] - to_b[:, 1] * to_c[:, 0] < -1e-6  # as drawn, y downwards
    is_own &= np.arange(len(faces)) < len(head.skin.faces)
    is_own[: len(head.skin.faces)] &= (head.features.ring[head.skin.faces] >= 0).all(axis=1)
    corners, values = place.copy(), np.concatenate([colours[faces], atlas_uv], axis=2)
    other = np.flatnonzero(~is_own)
    columns = int(np.ceil(np.sqrt(len(other) / 2)))
    cell, half = np.divmod(np.arange(len(other)), 2)
    squares = np.stack([cell % columns, cell // columns], axis=-1)[:, None] + CORNERS[half]
    corners[other] = (squares / columns + [1, 0]) * ATLAS
    middle = corners.mean(axis=1, keepdims=True)
    shown = np.where(is_own[:, None, None], corners, middle + INSET * (corners - middle))
    mean = values[other].mean(axis=1, keepdims=True)
    values[other] = mean + (values[other] - mean) / INSET
    return shown / [2 * ATLAS, ATLAS], _painted(head, corners, values)


def _painted(head: Head, corners: Float64, values: Float64) -> Float32:
    """Colours of every texel, of the values of corners: colours, and places in the atlas."""
    x, y = corners.reshape(-1, 2).T.astype(np.float32)
    screen = Screen(2 * ATLAS, ATLAS, x, y, np.zeros(len(x), np.float32))
    apart = np.arange(len(x)).reshape(-1, 3)
    nearest, _ = nearest_faces(screen, apart)
    first, per_x, per_y = planes(screen, apart, values.reshape(len(x), -1).astype(np.float32))
    row, column = np.indices(nearest.shape) + np.float32(0.5)
    corner = 3 * nearest
    found = first[nearest] + per_x[nearest] * (column - x[corner])[..., None]
    found += per_y[nearest] * (row - y[corner])[..., None]
    share = (head.mesh.maps.atlas / 127.5) ** 2
    at = ATLAS * found[..., :2:-1].reshape(-1, 2).T - 0.5  # row and column
    factors = [map_coordinates(share[..., k], at, order=1, mode="nearest") for k in range(3)]
    painted = found[..., :3] * np.stack(factors, axis=-1).reshape(*nearest.shape, 3)
    _, place = distance_transform_edt(nearest < 0, return_indices=True)
    return np.asarray(np.clip(painted[tuple(place)], 0, 1), np.float32)
