"""The embedded head as one mesh with morph targets, of the board or ARKit, and one picture."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.arrays import AnyFloat, Float32, Float64
from rig.controls import default_controls
from rig.conversion.arkit import arkit_controls
from rig.conversion.convert import convert
from rig.curves import RigCurves
from rig.face import Head, build_head
from rig.face.mesh import CLOTH, EYE, HAIR
from rig.mesh.glb import (
    RigidMotion,
    Surface,
    WeightAnimation,
    read_container,
    write_container,
    write_glb,
)
from rig.mesh.shapes import ShapeSet
from rig.mesh.trimesh import TriMesh
from rig.retarget.bake import BakedRig, bake, face_correctives

METRES_PER_CM = 0.01
PICTURE = 1024
"""Side of the pictures of exported heads, texels."""


@lru_cache(maxsize=2)
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
        Linear, for formats without textures.
    """
    head = build_head(identity)
    rig = bake(
        TriMesh(head.mesh.vertices, head.mesh.faces),
        head.pose,
        default_controls(),
        correctives=face_correctives(),
    )
    return rig, painted_colours(head)


def shown_controls() -> frozenset[str]:
    """Return the controls that a shape or corrective of the embedded heads shows."""
    rig, _ = morph_head(0)
    return frozenset(half.control for d in rig.drivers for group in d.groups for half in group)


SKIN_ROUGHNESS, HAIR_ROUGHNESS, EYE_ROUGHNESS = 0.52, 0.6, 0.08


def painted_colours(head: Head) -> Float64:
    """Linear colours (V, 3) of a head without a texture, its hollows darkened."""
    atlas = _shrunk(head)
    u, v = np.clip(head.mesh.uv * PICTURE, 0, PICTURE - 1).astype(np.int64).T
    return _hollow(head) * srgb_to_linear(atlas[v, u, :3] / 255)


def _hollow(head: Head) -> Float64:
    """Linear vertex colours (V, 3), by which a texture is multiplied."""
    return srgb_to_linear(head.mesh.colors) * (0.5 + 0.5 * head.mesh.light[:, :1])


def _shrunk(head: Head) -> NDArray[np.uint8]:
    from PIL import Image

    size = (PICTURE, PICTURE)
    return np.asarray(Image.fromarray(head.mesh.maps.atlas).resize(size, Image.Resampling.BOX))


def _png(picture: NDArray[np.uint8]) -> bytes:
    from PIL import Image

    stream = BytesIO()
    Image.fromarray(picture).save(stream, "PNG", compress_level=1)
    return stream.getvalue()


def textured(head: Head) -> tuple[Float64, Surface]:
    """Linear colours (V, 3) of a head under its textures, and the textures."""
    side = 64
    rough = np.full((side, side, 3), 255 * SKIN_ROUGHNESS, np.uint8)
    for kind, value in ((HAIR, HAIR_ROUGHNESS), (CLOTH, 0.9), (EYE, EYE_ROUGHNESS)):
        u, v = np.clip(side * head.mesh.uv[head.mesh.kind == kind], 0, side - 1).astype(int).T
        rough[v, u] = round(255 * value)
    return _hollow(head), Surface(head.mesh.uv, _png(_shrunk(head)), _png(rough), cutoff=0.5)


def baked_picture(head: Head) -> tuple[Float64, bytes]:
    """Texture coordinates (N, 3, 2) of all faces, and a PNG of all colours of a head.

    For formats whose materials cannot multiply a texture by vertex colours.
    """
    from scipy.ndimage import distance_transform_edt

    from rig.face.render.software import Screen, nearest_faces, planes  # compiles

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
    atlas = _shrunk(head)
    light = found[tuple(place)] * srgb_to_linear(atlas[..., :3] / 255)
    picture = np.round(255 * linear_to_srgb(np.clip(light, 0, 1))).astype(np.uint8)
    return head.mesh.uv[head.mesh.faces], _png(np.dstack([picture, atlas[..., 3]]))


def linear_to_srgb(light: AnyFloat) -> Float64:
    """Return sRGB values of linear light (IEC 61966-2-1)."""
    bright = 1.055 * np.maximum(light, 0) ** (1 / 2.4) - 0.055
    return np.where(light <= 0.0031308, 12.92 * light, bright)


def srgb_to_linear(colours: Float64) -> Float64:
    """Return linear light of sRGB values (IEC 61966-2-1)."""
    low = colours <= 0.04045
    return np.where(low, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


# The embedded head as a source of shapes: its mesh, landmarks and baked rig.


PARTS = ("cage", "eye_L", "eye_R", "teeth_upper", "teeth_lower", "tongue")
"""Parts that are carried to another head, without brows, lashes, ears and hair."""


@dataclass(frozen=True, eq=False)
class SourceHead:
    """A rigged head to take shapes from.

    Parameters
    ----------
    mesh : TriMesh
        `PARTS` of the embedded head, neutral, in cm; the cage is the first part.
    landmarks : dict of str to int
        All 26 of `rig.retarget.landmarks.LANDMARKS`.
    rig : BakedRig
        Its shapes for the 185 controls.
    """

    mesh: TriMesh
    landmarks: dict[str, int]
    rig: BakedRig


@lru_cache(maxsize=2)
def source_head(identity: int = 0) -> SourceHead:
    """Build the embedded head of an identity and bake its rig."""
    head = build_head(identity)
    kept = np.concatenate([np.arange(len(head.mesh.vertices))[head.slices[p]] for p in PARTS])
    new_index = np.full(len(head.mesh.vertices), -1, dtype=np.int64)
    new_index[kept] = np.arange(len(kept))
    others = head.mesh.faces[(head.mesh.faces >= head.slices["seam"].stop).all(axis=1)]
    faces = new_index[np.concatenate([head.cage.faces, others])]
    mesh = TriMesh(head.mesh.vertices[kept], faces[(faces >= 0).all(axis=1)])
    controls = default_controls()

    def evaluate(values: Float32) -> Float32:
        return head.pose(values)[:, kept]

    rig = bake(mesh, evaluate, controls, correctives=face_correctives())
    return SourceHead(rig.shapes.neutral, head.landmarks, rig)


# The head as a GLB with ARKit's 52 shapes, for any viewer.
#
# Viewers and face trackers use ARKit's names. Each shape is the board pose of
# that name in Unreal (`rig.conversion.arkit`). What shapes alone cannot express (a jaw and lids
# turn, lips seal) comes as correctives, whose drivers stand in ``mesh.extras.correctives``. For a
# take, with shapes of all 185 controls, use ``deitalk convert take/curves.csv face.glb``.


SHAPES = tuple(name[0].lower() + name[1:] for name in arkit_controls().names[:52])
"""ARKit's 52 blend shapes, by Apple's names."""
BASES = {"mouthClose": ("jawOpen", 1.0), "tongueOut": ("jawOpen", 0.4)}
"""Shapes that act on an open jaw only, as displacements from it."""
CORRECTIVES: dict[str, dict[str, float]] = {
    "jawOpen_half": {"jawOpen": 0.5},
    "eyeBlinkLeft_half": {"eyeBlinkLeft": 0.5},
    "eyeBlinkRight_half": {"eyeBlinkRight": 0.5},
    "mouthClose_half": {"jawOpen": 0.5, "mouthClose": 0.5},
}
"""Pose in which each is fully on; `corrective_weights` fades them in and out."""


Weight = Any
"""A number, or numbers of each frame."""


@dataclass(frozen=True)
class Morphs:
    """A head's linear shapes.

    Attributes
    ----------
    names : tuple of str
        ARKit's 52, then the correctives.
    deltas : ndarray [shape=(K, V, 3)], cm
    """

    names: tuple[str, ...]
    deltas: Float32


@lru_cache(maxsize=1)
def arkit_morphs(head: Head) -> Morphs:
    """Shapes of a head under ARKit's names, and correctives."""
    rest = head.mesh.vertices
    deltas: dict[str, Float64] = {}
    for name in SHAPES:
        base = dict([BASES[name]]) if name in BASES else {}
        with_it = {**base, name: 1.0}
        deltas[name] = arkit_pose(head, with_it) - (arkit_pose(head, base) if base else rest)
    for name, pose in CORRECTIVES.items():
        shown = rest + _added(deltas, {**pose, **corrective_weights(pose)})
        deltas[name] = arkit_pose(head, pose) - shown
    return Morphs(tuple(deltas), np.stack(list(deltas.values())).astype(np.float32))


def _added(deltas: dict[str, Float64], weights: dict[str, float]) -> Float64:
    return np.asarray(sum(weights[name] * deltas[name] for name in weights if name in deltas))


def arkit_pose(head: Head, pose: dict[str, float]) -> Float64:
    """Vertices (V, 3) of the head itself, cm, for ARKit weights."""
    controls = arkit_controls()
    values = controls.rest.copy()
    for name, weight in pose.items():
        values[controls.index(name[0].upper() + name[1:])] = weight
    curves = RigCurves(values[None], controls.names, 30.0, control_set=controls.id)
    board = convert(curves, default_controls().id)
    return np.asarray(head.pose(board.values[0]), np.float64)


def corrective_weights(weights: Mapping[str, Weight]) -> dict[str, Weight]:
    """Weights of the correctives for weights of ARKit's shapes, numbers or one of each frame.

    A half is on at 0.5 and off at 0 and 1; ``mouthClose_half`` takes the weight of mouthClose.
    """
    get = {name: weights.get(name, 0.0) for name in ("jawOpen", "mouthClose")}
    halves = {name.removesuffix("_half"): weights.get(name.removesuffix("_half"), 0.0)
              for name in CORRECTIVES}  # fmt: skip
    halves["mouthClose"] = np.minimum(get["jawOpen"], get["mouthClose"])
    return {
        f"{name}_half": np.maximum(1 - abs(2 * weight - 1), 0) for name, weight in halves.items()
    }


def arkit_weights(curves: RigCurves) -> Float32:
    """Weights [shape=(T, 56)] of ARKit's 52 shapes, from 0 to 1, and of the correctives.

    Raises
    ------
    ControlError
        If the curves are not ARKit's.
    """
    values = curves.reorder(arkit_controls()).values[:, : len(SHAPES)].clip(0, 1)
    moving = {name for pose in CORRECTIVES.values() for name in pose}
    added = corrective_weights({name: values[:, SHAPES.index(name)] for name in moving})
    columns = [added[name] for name in CORRECTIVES]
    return np.column_stack([values, *columns]).astype(np.float32)


def write_animation(
    path: Path | str,
    curves: RigCurves,
    identity: int | str = 0,
    *,
    motion: RigidMotion | None = None,
) -> None:
    """Write an embedded head with an animation of its ARKit shapes.

    Parameters
    ----------
    path : Path or str
        The ``.glb``.
    curves : RigCurves
        Of ARKit.
    identity : int or str
        Number or name of the head.
    motion : RigidMotion, optional
        Of the head as a whole, in metres.
    """
    animation = WeightAnimation(arkit_weights(curves), curves.fps, motion=motion)
    write_head(path, build_head(identity), animation=animation)


def write_head(path: Path | str, head: Head, *, animation: WeightAnimation | None = None) -> Morphs:
    """Write the head, y up, facing +z, in metres, its shapes as sparse morph targets.

    Parameters
    ----------
    path : Path or str
        The ``.glb``.
    head : Head
        Whose.
    animation : WeightAnimation, optional
        Of `arkit_weights`.

    Returns
    -------
    morphs : Morphs
        What was written.
    """
    morphs = arkit_morphs(head)
    shapes = ShapeSet(TriMesh(head.mesh.vertices, head.mesh.faces), morphs.names, morphs.deltas)
    colours, surface = textured(head)
    write_glb(
        path, shapes, animation=animation, colours=colours, surface=surface, metres=METRES_PER_CM
    )
    # Extras of the file: whose head it is, and the pose in which each corrective is fully on.
    document, binary = read_container(path)
    (mesh,) = document["meshes"]
    mesh["name"] = head.identity.name
    mesh["extras"]["correctives"] = {name: {"peak_at": pose} for name, pose in CORRECTIVES.items()}
    write_container(path, document, binary)
    return morphs
