"""The embedded head as one mesh with morph targets, of the board or ARKit, and one picture."""

from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np

from rig.arrays import AnyFloat, Float64
from rig.controls import default_controls
from rig.face import Head, build_head
from rig.face.identity import Identity
from rig.face.mesh import CLOTH, EYE, HAIR
from rig.face.moves import moves
from rig.face.render.picture import png
from rig.mesh.glb import Surface
from rig.mesh.shapes import SparseShapes
from rig.mesh.trimesh import TriMesh
from rig.retarget.bake import BakedRig, bake, control_halves, face_correctives

if TYPE_CHECKING:
    from PIL import Image

METRES_PER_CM = 0.01
PICTURE = 1024
"""Side of the pictures of exported heads, texels."""


@lru_cache(maxsize=2)
def morph_head(identity: int | str | Identity = 0) -> BakedRig[SparseShapes]:
    """Return the head baked to morph targets, in cm: one for each half of a control, correctives.

    Parameters
    ----------
    identity : int, str or Identity
        Number or name of an embedded head.
    """
    head = build_head(identity)
    neutral = TriMesh(head.mesh.vertices, head.mesh.faces)
    return bake(neutral, partial(moves, head), default_controls(), correctives=face_correctives())


@lru_cache(maxsize=1)
def shown_controls() -> frozenset[str]:
    """Return the controls that a shape or corrective of the embedded heads shows."""
    controls, motion = default_controls(), build_head(0).motion
    halves = [*controls.names, *(f"{name}_negative" for name in controls.names), ""]
    sealing = [name for name, row in zip(halves, motion.bind, strict=True) if row.any()]
    shown = {*motion.names, *sealing, "CTRL_C_eye_parallelLook.ty"}
    drivers = [driver for name, driver in control_halves(controls) if name in shown]
    drivers += [driver for _, driver in face_correctives()]
    return frozenset(half.control for d in drivers for group in d.groups for half in group)


SKIN_ROUGHNESS, HAIR_ROUGHNESS, EYE_ROUGHNESS = 0.52, 0.6, 0.08


def painted_colours(head: Head) -> Float64:
    """Linear colours (V, 3) of a head without a texture, its hollows darkened."""
    atlas = np.asarray(_shrunk(head))
    u, v = np.clip(head.mesh.uv * PICTURE, 0, PICTURE - 1).astype(np.int64).T
    return _hollow(head) * srgb_to_linear(atlas[v, u, :3] / 255)


def _hollow(head: Head) -> Float64:
    """Linear vertex colours (V, 3), by which a texture is multiplied."""
    return srgb_to_linear(head.mesh.colors) * (0.5 + 0.5 * head.mesh.light[:, :1])


def _shrunk(head: Head) -> "Image.Image":
    from PIL import Image

    picture = Image.fromarray(head.mesh.maps.atlas_for(PICTURE))
    return picture.reduce(max(picture.width // PICTURE, 1))


def textured(head: Head) -> tuple[Float64, Surface]:
    """Linear colours (V, 3) of a head under its textures, and the textures."""
    side = 64
    rough = np.full((side, side, 3), 255 * SKIN_ROUGHNESS, np.uint8)
    for kind, value in ((HAIR, HAIR_ROUGHNESS), (CLOTH, 0.9), (EYE, EYE_ROUGHNESS)):
        u, v = np.clip(side * head.mesh.uv[head.mesh.kind == kind], 0, side - 1).astype(int).T
        rough[v, u] = round(255 * value)
    return _hollow(head), Surface(
        head.mesh.uv, png(np.asarray(_shrunk(head))), png(rough), cutoff=0.5
    )


def baked_picture(head: Head) -> tuple[Float64, bytes]:
    """Texture coordinates (N, 3, 2) of all faces, and a PNG of all colours of a head.

    For formats whose materials cannot multiply a texture by vertex colours.
    """
    from scipy.ndimage import distance_transform_edt

    from rig.face.render.software import Screen, nearest_faces, planes

    x, y = (PICTURE * head.mesh.uv.T).astype(np.float32)
    screen = Screen(PICTURE, PICTURE, x, y, np.zeros(len(x), np.float32))
    a, b, c = head.mesh.faces.T
    area = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
    faces = head.mesh.faces[np.abs(area) > 1e-6]
    nearest, _ = nearest_faces(screen, faces)
    first, per_x, per_y = planes(screen, faces, _hollow(head).astype(np.float32))
    row, column = np.indices(nearest.shape) + np.float32(0.5)
    corner = faces[nearest, 0]
    found = first[nearest] + per_x[nearest] * (column - x[corner])[..., None]
    found += per_y[nearest] * (row - y[corner])[..., None]
    _, place = distance_transform_edt(nearest < 0, return_indices=True)
    atlas = np.asarray(_shrunk(head))
    light = found[tuple(place)] * srgb_to_linear(atlas[..., :3] / 255)
    picture = np.round(255 * linear_to_srgb(np.clip(light, 0, 1))).astype(np.uint8)
    return head.mesh.uv[head.mesh.faces], png(np.dstack([picture, atlas[..., 3]]))


def linear_to_srgb(light: AnyFloat) -> Float64:
    """Return sRGB values of linear light (IEC 61966-2-1)."""
    bright = 1.055 * np.maximum(light, 0) ** (1 / 2.4) - 0.055
    return np.where(light <= 0.0031308, 12.92 * light, bright)


def srgb_to_linear(colours: Float64) -> Float64:
    """Return linear light of sRGB values (IEC 61966-2-1)."""
    low = colours <= 0.04045
    return np.where(low, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
