"""The embedded head as one mesh with morph targets, of the board or ARKit, and one picture."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.arrays import AnyFloat, Float32, Float64, Int64
from rig.controls import default_controls
from rig.conversion.arkit import arkit_controls
from rig.conversion.convert import convert
from rig.curves import RigCurves
from rig.face import Head, build_head
from rig.face.geometry.topology import EYE_L, EYE_R, MOUTH, NOSTRIL_L, NOSTRIL_R
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
from rig.retarget.bake import BakedRig, bake, control_halves, face_correctives

if TYPE_CHECKING:
    from rig.face.head import Head
    from rig.face.identity import Identity


# One picture of a whole head: what its vertex colours and its atlas make together.
#
# For formats whose materials cannot multiply a texture by vertex colours. The left half is the skin
# in its own place of the atlas; in the right one every other face has half a square.


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
    side = len(head.mesh.maps.atlas)
    place = side * atlas_uv
    to_b, to_c = place[:, 1] - place[:, 0], place[:, 2] - place[:, 0]
    is_own = to_b[:, 0] * to_c[:, 1] - to_b[:, 1] * to_c[:, 0] < -1e-6  # as drawn, y downwards
    is_own &= np.arange(len(faces)) < len(head.skin.faces)
    is_own[: len(head.skin.faces)] &= (head.features.ring[head.skin.faces] >= 0).all(axis=1)
    corners, values = place.copy(), np.concatenate([colours[faces], atlas_uv], axis=2)
    other = np.flatnonzero(~is_own)
    columns = int(np.ceil(np.sqrt(len(other) / 2)))
    cell, half = np.divmod(np.arange(len(other)), 2)
    squares = np.stack([cell % columns, cell // columns], axis=-1)[:, None] + CORNERS[half]
    corners[other] = (squares / columns + [1, 0]) * side
    middle = corners.mean(axis=1, keepdims=True)
    shown = np.where(is_own[:, None, None], corners, middle + INSET * (corners - middle))
    mean = values[other].mean(axis=1, keepdims=True)
    values[other] = mean + (values[other] - mean) / INSET
    return shown / [2 * side, side], _painted(head, corners, values)


def _painted(head: Head, corners: Float64, values: Float64) -> Float32:
    """Colours of every texel, of the values of corners: colours, and places in the atlas."""
    from scipy.ndimage import distance_transform_edt, map_coordinates

    from rig.face.render.software import Screen, nearest_faces, planes  # compiles

    x, y = corners.reshape(-1, 2).T.astype(np.float32)
    side = len(head.mesh.maps.atlas)
    screen = Screen(2 * side, side, x, y, np.zeros(len(x), np.float32))
    apart = np.arange(len(x)).reshape(-1, 3)
    nearest, _ = nearest_faces(screen, apart)
    first, per_x, per_y = planes(screen, apart, values.reshape(len(x), -1).astype(np.float32))
    row, column = np.indices(nearest.shape) + np.float32(0.5)
    corner = 3 * nearest
    found = first[nearest] + per_x[nearest] * (column - x[corner])[..., None]
    found += per_y[nearest] * (row - y[corner])[..., None]
    share = (head.mesh.maps.atlas / 127.5) ** 2
    at = side * found[..., :2:-1].reshape(-1, 2).T - 0.5  # row and column
    factors = [map_coordinates(share[..., k], at, order=1, mode="nearest") for k in range(3)]
    painted = found[..., :3] * np.stack(factors, axis=-1).reshape(*nearest.shape, 3)
    _, place = distance_transform_edt(nearest < 0, return_indices=True)
    return np.asarray(np.clip(painted[tuple(place)], 0, 1), np.float32)


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
    from rig.face.identity import resolve_identity

    head = build_head(identity)
    stored = _stored(resolve_identity(identity))
    controls = default_controls()
    drivers = dict(control_halves(controls) + face_correctives())
    names = tuple(str(name) for name in stored["names"])
    deltas = np.zeros((len(names), len(head.mesh.vertices), 3), np.float32)
    deltas[stored["shape"], stored["vertex"]] = stored["delta"]
    deltas.setflags(write=False)
    shapes = ShapeSet(TriMesh(stored["rest"], head.mesh.faces), names, deltas)
    rig = BakedRig(shapes, tuple(drivers[name] for name in names), controls)
    return rig, painted_colours(head)


@lru_cache(maxsize=1)
def _stored(identity: "Identity") -> dict[str, NDArray[Any]]:
    from rig.face.head import load_or_build

    return load_or_build("morphs", identity, _baked)


def shown_controls() -> frozenset[str]:
    """Return the controls that a shape or corrective of the embedded heads shows."""
    from rig.face.identity import resolve_identity

    names = _stored(resolve_identity(0))["names"]
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

    levels = (np.arange(256) / 127.5) ** 2 / BRIGHTEST
    base = np.round(255 * linear_to_srgb(levels.clip(0, 1))).astype(np.uint8)[head.mesh.maps.atlas]
    rough = np.full((64, 64, 3), 255 * SKIN_ROUGHNESS, np.uint8)
    for (u, v, side), value in ((STRANDS_UV, HAIR_ROUGHNESS), (IRIS_UV, EYE_ROUGHNESS)):
        rough[int(64 * v) : int(64 * (v + side)) + 2, int(64 * u) : int(64 * (u + side)) + 2] = (
            255 * value
        )
    colours = np.minimum(BRIGHTEST * painted_colours(head), 1)
    return colours, Surface(head.mesh.uv, file(base, "JPEG"), file(rough, "PNG"))


def baked_picture(head: "Head") -> tuple[Float64, bytes]:
    """Texture coordinates (N, 3, 2) and a JPEG of all colours of a head; see `baked`."""
    from PIL import Image

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


# The embedded head as a source of shapes: its mesh, landmarks and baked rig.


PARTS = ("skin", "eye_L", "eye_R", "teeth_upper", "teeth_lower", "tongue")
"""Parts that are carried to another head, without brows, lashes, ears and hair."""


@dataclass(frozen=True, eq=False)
class SourceHead:
    """A rigged head to take shapes from.

    Parameters
    ----------
    mesh : TriMesh
        `PARTS` of the embedded head, neutral, in cm; the skin is the first and largest part.
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
    faces = new_index[head.mesh.faces]
    mesh = TriMesh(head.mesh.vertices[kept], faces[(faces >= 0).all(axis=1)])
    controls = default_controls()

    def evaluate(values: Float32) -> Float32:
        return np.asarray(head.pose(values)[:, kept])

    rig = bake(mesh, evaluate, controls, correctives=face_correctives())
    return SourceHead(rig.shapes.neutral, head_landmarks(head), rig)


def head_landmarks(head: Head) -> dict[str, int]:
    """Vertices of the 26 landmarks on the skin of an embedded head.

    Mouth and eyes are known by their loops, which start at the subject's left (an eye's at its
    outer corner) and run over the top; the others are extremes of the profile.
    """
    skin = head.features
    rim, red = skin.loop(MOUTH, 0), skin.loop(MOUTH, 3)
    quarter = len(rim) // 4
    share = skin.vertices[rim[:quarter], 0] / skin.vertices[rim[0], 0]
    half = int(np.argmin(np.abs(share - 0.5)))
    found = {
        "mouth_corner_left": rim[0],
        "mouth_corner_right": rim[2 * quarter],
        "upper_rim": rim[quarter],
        "lower_rim": rim[3 * quarter],
        "upper_rim_left": rim[half],
        "upper_rim_right": rim[2 * quarter - half],
        "lower_rim_left": rim[-half],
        "lower_rim_right": rim[2 * quarter + half],
        "upper_lip_top": red[quarter],
        "lower_lip_bottom": red[3 * quarter],
    }
    for side, kind in (("left", EYE_L), ("right", EYE_R)):
        lid = skin.loop(kind, 0)
        step = len(lid) // 4
        names = ("outer", "upper", "inner", "lower")
        found |= {f"eye_{name}_{side}": lid[i * step] for i, name in enumerate(names)}
    return {name: int(v) for name, v in (found | _profile(skin.vertices, found, head)).items()}


def _profile(points: Float64, known: dict[str, Int64], head: Head) -> dict[str, int]:
    """Nose, chin and brows, by extremes of the skin."""
    skin = head.features
    inside = (skin.kind == MOUTH) & (skin.ring < 0)
    middle = np.flatnonzero((np.abs(points[:, 0]) < 1e-6) & (points[:, 2] > 0) & ~inside)
    y, z = points[middle, 1], points[middle, 2]
    lip, mouth = points[known["upper_lip_top"]], points[known["lower_lip_bottom"]]
    eye = points[known["eye_inner_left"]]

    tip = middle[np.argmax(np.where((y > lip[1]) & (y < eye[1]), z, -np.inf))]
    base = _deepest(middle, points, points[tip], lip)
    brow_line = points[middle[np.argmin(np.abs(y - (eye[1] + 3.0)))]]
    bridge = _deepest(middle, points, brow_line, points[tip])
    below = (y < mouth[1] - 0.5) & (y > mouth[1] - 6.0)
    chin = middle[np.argmax(np.where(below, z - y, -np.inf))]
    found = {"nose_tip": tip, "nose_base": base, "nose_bridge": bridge, "chin": chin}
    for side, kind, sign in (("left", NOSTRIL_L, 1), ("right", NOSTRIL_R, -1)):
        ring = skin.loop(kind, 2)
        # As far out as the wing goes, at the height of the nose's base.
        out = np.abs(points[ring, 0]).max()
        corner = np.array([sign * out, points[base, 1] + 0.1, points[base, 2] - 0.4])
        away = np.where(inside, np.inf, np.linalg.norm(points - corner, axis=1))
        found[f"nose_wing_{side}"] = np.argmin(away)
        brow = head.parts[f"brow_{side[0].upper()}"].vertices.mean(axis=0)
        found[f"brow_{side}"] = np.argmin(np.linalg.norm(points - brow, axis=1))
    return {name: int(v) for name, v in found.items()}


def _deepest(middle: Int64, points: Float64, above: Float64, below: Float64) -> int:
    """Midline vertex furthest behind the straight line from one point of the profile to another."""
    y, z = points[middle, 1], points[middle, 2]
    share = (y - below[1]) / (above[1] - below[1])
    line = below[2] + share * (above[2] - below[2])
    depth = np.where((share > 0) & (share < 1), line - z, -np.inf)
    return int(middle[np.argmax(depth)])


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
    from rig.face import build_head

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
