"""The embedded head as one mesh with morph targets, for formats that carry a mesh."""

from functools import lru_cache
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.arrays import AnyFloat, Float64
from rig.controls import default_controls
from rig.mesh.glb import Surface
from rig.mesh.shapes import ShapeSet
from rig.mesh.trimesh import TriMesh
from rig.retarget.bake import BakedRig, bake, control_halves, face_correctives

if TYPE_CHECKING:
    from rig.face.head import Head
    from rig.face.identity import Identity

METRES_PER_CM = 0.01


@lru_cache(maxsize=1)
def morph_head(identity: int | str = 0) -> tuple[BakedRig, Float64]:
    """Return the head baked to morph targets, in cm, and its linear vertex colours.

    Parameters
    ----------
    identity : int or str
        Number or name of an embedded head.

    Returns
    -------
    rig : BakedRig
        One shape per half of a control's range, and correctives.
    colours : array [shape=(V, 3), range 0 to 1]
        Linear, as glTF and USD take them.
    """
    from rig.face import build_head
    from rig.face.head import load_or_build
    from rig.face.identity import resolve_identity

    head = build_head(identity)
    stored = load_or_build("morphs", resolve_identity(identity), _baked)
    controls = default_controls()
    drivers = dict(control_halves(controls) + face_correctives())
    names = tuple(str(name) for name in stored["names"])
    deltas = np.zeros((len(names), len(head.mesh.vertices), 3), np.float32)
    deltas[stored["shape"], stored["vertex"]] = stored["delta"]
    deltas.setflags(write=False)
    shapes = ShapeSet(TriMesh(stored["rest"], head.mesh.faces), names, deltas)
    rig = BakedRig(shapes, tuple(drivers[name] for name in names), controls)
    return rig, painted_colours(head)


def shown_controls() -> frozenset[str]:
    """Return the controls that a shape or corrective of the embedded heads shows."""
    from rig.face.head import load_or_build
    from rig.face.identity import resolve_identity

    names = load_or_build("morphs", resolve_identity(0), _baked)["names"]
    drivers = dict(control_halves(default_controls()) + face_correctives())
    shown = [group for name in names for group in drivers[str(name)].groups]
    return frozenset(half.control for group in shown for half in group)


BRIGHTEST = 1.2
"""Largest factor of a texture: vertex colours carry it, textures are divided by it."""
SKIN_ROUGHNESS, HAIR_ROUGHNESS, EYE_ROUGHNESS = 0.52, 0.45, 0.08


def painted_colours(head: "Head") -> Float64:
    """Linear colours (V, 3) of a head without a texture, its hollows darkened."""
    hollow = 0.5 + 0.5 * head.mesh.light[:, :1]
    return srgb_to_linear(head.mesh.colors) * hollow


def textured(head: "Head") -> tuple[Float64, Surface]:
    """Linear colours (V, 3) of a head under its textures, and the textures."""
    from PIL import Image

    from rig.face.geometry.mesh import IRIS_UV, STRANDS_UV

    def file(picture: NDArray[np.uint8], kind: str) -> bytes:
        stream = BytesIO()
        Image.fromarray(picture).save(stream, kind, quality=86)
        return stream.getvalue()

    share = (head.mesh.maps.atlas / 127.5) ** 2 / BRIGHTEST
    base = np.round(255 * linear_to_srgb(share.clip(0, 1))).astype(np.uint8)
    rough = np.full((64, 64, 3), 255 * SKIN_ROUGHNESS, np.uint8)
    for (u, v, side), value in ((STRANDS_UV, HAIR_ROUGHNESS), (IRIS_UV, EYE_ROUGHNESS)):
        rough[int(64 * v) : int(64 * (v + side)) + 2, int(64 * u) : int(64 * (u + side)) + 2] = (
            255 * value
        )
    colours = np.minimum(BRIGHTEST * painted_colours(head), 1)
    return colours, Surface(head.mesh.uv, file(base, "JPEG"), file(rough, "PNG"))


def baked_picture(head: "Head") -> tuple[Float64, bytes]:
    """Texture coordinates (N, 3, 2) and a JPEG of all colours of a head; see `rig.face.baked`."""
    from PIL import Image

    from rig.face.baked import baked

    uv, picture = baked(head, painted_colours(head))
    stream = BytesIO()
    image = Image.fromarray(np.round(255 * linear_to_srgb(picture)).astype(np.uint8))
    image.save(stream, "JPEG", quality=92, subsampling=0)  # neighbouring faces differ in colour
    return uv, stream.getvalue()


def linear_to_srgb(light: AnyFloat) -> Float64:
    """Return sRGB values of linear light (IEC 61966-2-1)."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def _baked(identity: "Identity") -> dict[str, NDArray[Any]]:
    """Shapes of a head as plain arrays, without the vertices that do not move."""
    from rig.face import build_head

    head = build_head(identity)
    rig = bake(
        TriMesh(head.mesh.vertices, head.mesh.faces),
        lambda values: np.asarray(head.pose(values)),
        default_controls(),
        correctives=face_correctives(),
    )
    shape, vertex = np.nonzero(rig.shapes.deltas.any(axis=2))
    return {
        "rest": rig.shapes.neutral.vertices,
        "names": np.array(rig.shapes.names),
        "shape": shape.astype(np.int32),
        "vertex": vertex.astype(np.int32),
        "delta": rig.shapes.deltas[shape, vertex],
    }


def srgb_to_linear(colours: Float64) -> Float64:
    """Return linear light of sRGB values (IEC 61966-2-1)."""
    low = colours <= 0.04045
    return np.where(low, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


def in_metres(shapes: ShapeSet) -> ShapeSet:
    """Return shapes that are in cm in glTF's unit."""
    neutral = shapes.neutral.with_vertices(shapes.neutral.vertices * METRES_PER_CM)
    return ShapeSet(neutral, shapes.names, shapes.deltas * METRES_PER_CM)
