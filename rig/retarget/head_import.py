"""A user's head as a head of ours: `deitalk face import`.

Names of shapes are those of `rig.retarget.blendshapes`, ARKit's above all. Each half of a control
becomes a shape, the pose of the head's own shapes at its end, so that page, video and exports
play the head as an embedded one. The head is laid over the embedded one by the places that the
same shapes move, and its light is baked.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Bool, Float32, Float64, Int64
from rig.controls import default_controls
from rig.conversion.avatars import bare_names
from rig.conversion.shape_fit import shape_key
from rig.curves import RigCurves
from rig.errors import MeshError, listed
from rig.face import build_head
from rig.face.head import CORRECTIVES
from rig.face.head_file import GRID, Arrays, write_head
from rig.limits import HEAD_MOVES, HEAD_VERTICES
from rig.mesh.deformation import similarity
from rig.mesh.glb_reader import GlbParts, consistent, read_parts, walk
from rig.mesh.shapes import ShapeSet
from rig.mesh.trimesh import TriMesh, triangle_areas
from rig.retarget.bake import bake, face_correctives, moves_of
from rig.retarget.blendshapes import match_shapes
from rig.retarget.bones import bone_named, bones_of
from rig.retarget.head_glb import SHAPES, arkit_pose
from rig.retarget.head_surface import surface_of

ANCHORS = (
    "eyeBlinkLeft", "eyeBlinkRight", "eyeSquintLeft", "eyeSquintRight", "browOuterUpLeft",
    "browOuterUpRight", "noseSneerLeft", "noseSneerRight", "mouthSmileLeft", "mouthSmileRight",
    "mouthPucker", "mouthFunnel",
)  # fmt: skip
"""Shapes whose places lay a head over the embedded one."""
REACH_CM = 40.0
"""Distance from the middle between the eyes, along each axis, to which a head is kept."""
UNLIKE_CM = 1.5
"""Root mean square by which places of shapes are off, from which on it is said."""
STILL_CM = 0.002
JAW_DEGREES = 20.0
"""Turn of a jaw bone for the widest open jaw; our choice: teeth part by 3 cm."""
EYES = r"(?:.*[_ :.|-])?eyes?(?:ball)?s?(?:[_.]?(?:mesh|geo|grp|\d+))*"
"""Names of meshes of both eyes; those of one are in `rig.retarget.bones.BONES`."""


@dataclass(frozen=True)
class ImportedHead:
    """Result of an import.

    Attributes
    ----------
    path : Path
        The head file.
    shapes : int
        Shapes of the file that move it.
    vertices : int
    notes : tuple of str
        What was guessed or left out, one line each.
    """

    path: Path
    shapes: int
    vertices: int
    notes: tuple[str, ...]


def import_head(source: Path | str, out: Path | str) -> ImportedHead:
    """Read a GLB with shapes of known names and write it as a head file.

    Parameters
    ----------
    source : Path or str
        ``.glb`` with morph targets; several meshes are joined.
    out : Path or str
        ``.npz``, replaced.

    Raises
    ------
    FormatError, MeshError
        With one line on what to correct.
    """
    source = Path(source)
    with consistent(source):
        read = read_parts(source)
        known = match_shapes(read.shapes.names)
        notes = _names(read.shapes.names, known.understood)
        try:
            arrays = _arrays(read, notes)
        except MeshError as error:
            raise MeshError(f"{source.name} {error}") from None
    write_head(Path(out), arrays)
    return ImportedHead(
        Path(out), len(known.understood), len(arrays["points"]), tuple(notes)
    )  # fmt: skip


def _names(names: Sequence[str], known: Sequence[str]) -> list[str]:
    keys, notes = {shape_key(name) for name in names}, []
    missing = [name for name in SHAPES if keys.isdisjoint({(key := shape_key(name)), f"{key}_l"})]
    if missing:
        notes.append(f"{len(missing)} of ARKit's 52 shapes are missing: {listed(missing, 6)}")
    unknown = [name for name in names if name not in known]
    if unknown:
        notes.append(f"{len(unknown)} shapes of unknown name stay at 0: {listed(unknown, 4)}")
    return notes


def _arrays(read: GlbParts, notes: list[str]) -> Arrays:
    """Arrays of a head file; what is guessed or left out is added to the notes."""
    shapes, to_cm = _placed(read.shapes, notes)
    shapes = _with_jaw(read, shapes, to_cm, notes)
    eyes = _eyes(read, shapes, notes)
    faces, kept = _kept(shapes, notes)
    still = np.abs(shapes.deltas).max((0, 2), initial=0) < STILL_CM
    part = np.select([eyes[0], eyes[1], still], [1, 2, 3], 0)[kept]
    order = kept[np.argsort(part, kind="stable")]
    place = np.full(len(still), -1, np.int64)
    place[order] = np.arange(len(order))
    faces = place[faces]
    faces = faces[np.argsort(faces.max(1) >= len(order) - (part == 3).sum(), kind="stable")]
    points, deltas = shapes.neutral.vertices[order], shapes.deltas[:, order]
    centers = [_sphere(points[part_of]) for part_of in (e[order] for e in eyes)]
    ends = np.searchsorted(np.sort(part), [0, 1, 2, 3], side="right")
    jaw = int(match_shapes(shapes.names).poses[:, bare_names().index("jawOpen")].argmax())
    surface, more = surface_of(read, points, faces, order, deltas, jaw)
    notes += more
    return {
        "points": np.round(points * GRID).astype(np.int16), "faces": faces.astype(np.uint16),
        "eyes": np.array(centers, np.float32), "stops": ends[[0, 0, 1, 2, 3]].astype(np.int64),
        **surface, **_motion(ShapeSet(TriMesh(points, faces), shapes.names, deltas)),
    }  # fmt: skip


def _hangs_on(read: GlbParts, bone: str) -> Float64:
    """Share (V,) of a bone's motion that each vertex takes."""
    node, found = bones_of(read.document).get(bone), []
    for piece in read.pieces:
        names = read.names(piece) + read.ancestors(piece)
        share = np.full(len(piece.vertices), float(bone in map(bone_named, names)))
        skin = read.document["nodes"][piece.node].get("skin")
        joints, weights = (read.column(piece, f"{name}_0") for name in ("JOINTS", "WEIGHTS"))
        if skin is not None and joints is not None and weights is not None:
            is_bone = np.array([j == node for j in read.document["skins"][skin]["joints"]])
            share = (weights * is_bone[joints.astype(np.int64)]).sum(1)
        found.append(share)
    return np.concatenate(found)


def _placed(shapes: ShapeSet, notes: list[str]) -> tuple[ShapeSet, Any]:
    """The shapes laid over the embedded head, in cm, and what does it."""
    keys, own, ours = [shape_key(name) for name in shapes.names], [], []
    for name, place in _anchors().items():
        if name in keys and (delta := shapes.deltas[keys.index(name)]).any():
            own.append(_middle(shapes.neutral.vertices, delta))
            ours.append(place)
    spread = np.linalg.svd(np.subtract(own, np.mean(own, 0)))[1] if len(own) > 2 else [0, 0]
    if spread[1] < 0.1 * spread[0] or not spread[0]:
        raise MeshError(
            f"cannot be laid over a face: it needs three or more of {', '.join(ANCHORS[::2])} …"
        )
    scale, rotation, shift = similarity(own, ours)

    def to_cm(places: Any) -> Float64:
        return np.asarray(scale * places @ rotation.T + shift)

    off = float(np.sqrt(((to_cm(np.array(own)) - ours) ** 2).sum(1).mean()))
    if off > UNLIKE_CM:
        notes.append(f"unlike a person's head (shapes are {off:.1f} cm off); views may miss it")
    moved = (scale * shapes.deltas @ rotation.T).astype(np.float32)
    return ShapeSet(TriMesh(to_cm(shapes.neutral.vertices), shapes.neutral.faces),
                    shapes.names, moved), to_cm  # fmt: skip


@cache
def _anchors() -> dict[str, Float64]:
    """Places that `ANCHORS` move on the embedded head, by `shape_key`."""
    head = build_head(0)
    moved = {name: arkit_pose(head, {name: 1.0}) - head.neutral for name in ANCHORS}
    return {shape_key(name): _middle(head.neutral, delta) for name, delta in moved.items()}


def _middle(points: Float64, delta: NDArray[Any]) -> Float64:
    """Mean of the points by the square of how far they move."""
    weight = (np.asarray(delta, np.float64) ** 2).sum(1)
    return np.asarray(weight @ points / weight.sum())


def _with_jaw(read: GlbParts, shapes: ShapeSet, to_cm: Any, notes: list[str]) -> ShapeSet:
    """The shapes, and a jaw that a bone opens if no shape does."""
    if match_shapes(shapes.names).poses[:, bare_names().index("jawOpen")].any():
        return shapes
    share = _hangs_on(read, "jaw")
    place = dict(walk(read.document)).get(bones_of(read.document).get("jaw", -1))
    if not share.any() or place is None:
        notes.append("no shape jawOpen and no bone of a jaw: it stays shut")
        return shapes
    center = to_cm(place[:3, 3])
    turned = []
    for degrees in (JAW_DEGREES, JAW_DEGREES / 2):
        cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        _, y, z = (shapes.neutral.vertices - center).T
        move = np.stack([0 * y, y * cosine - z * sine - y, y * sine + z * cosine - z], -1)
        turned.append(share[:, None] * move)
    turned[1] -= turned[0] / 2
    notes.append(f"a bone opens the jaw, by {JAW_DEGREES:g} degrees")
    deltas = np.concatenate([shapes.deltas, np.array(turned, np.float32)])
    return ShapeSet(shapes.neutral, (*shapes.names, "jawOpen", "jawOpen_half"), deltas)


def _eyes(read: GlbParts, shapes: ShapeSet, notes: list[str]) -> list[Bool]:
    """Vertices (V,) of both eyes that turn, left first; none where shapes turn them."""
    looks = [k for k, name in enumerate(shapes.names) if "eyelook" in shape_key(name)]
    moved = np.abs(shapes.deltas[looks]).max((0, 2), initial=0) > STILL_CM
    is_left = shapes.neutral.vertices[:, 0] > 0
    both = read.each([any(re.fullmatch(EYES, name.lower()) for name in read.names(piece))
                      for piece in read.pieces])  # fmt: skip
    found = []
    for bone, side in (("leftEye", is_left), ("rightEye", ~is_left)):
        alone = (_hangs_on(read, bone) > 0.5) & ~moved
        found.append(alone if alone.any() else both & side & ~moved)
    if found[0].any() and found[1].any():
        return found
    if not looks:
        notes.append("no shapes eyeLook… and no meshes or bones of eyes: the gaze is not shown")
    return [np.zeros(len(moved), bool)] * 2


def _sphere(points: Float64) -> Float64:
    """Centre and radius (4,) of the sphere nearest to points; something of an eye without any."""
    if len(points) < 4:
        return np.array([0.0, 0.0, 6.0, 1.5])
    matrix = np.column_stack([2 * points, np.ones(len(points))])
    solved = np.linalg.lstsq(matrix, (points**2).sum(1), rcond=None)[0]
    return np.append(solved[:3], np.sqrt(max(solved[3] + (solved[:3] ** 2).sum(), 1e-6)))


def _kept(shapes: ShapeSet, notes: list[str]) -> tuple[Int64, Int64]:
    """Faces within reach of the head, and their vertices."""
    faces = shapes.neutral.faces
    near = (np.abs(shapes.neutral.vertices) < REACH_CM)[faces].all(axis=(1, 2))
    near_and_whole = near & (triangle_areas(shapes.neutral) > 0)
    kept = np.unique(faces[near_and_whole])
    if not near.all():
        notes.append(f"what lies more than {REACH_CM:g} cm from the eyes is left out")
    if not 0 < len(kept) <= HEAD_VERTICES:
        raise MeshError(
            f"has a head of {len(kept)} vertices; 1 to {HEAD_VERTICES} are shown: decimate it"
        )
    return faces[near_and_whole], kept


def _motion(shapes: ShapeSet) -> Arrays:
    """A shape of each half of a control, and the correctives of an embedded head."""
    poses, controls = match_shapes(shapes.names, shapes=shapes), default_controls()
    flat = shapes.deltas.reshape(len(shapes.names), -1)

    def pose(values: Float64) -> Float32:
        weights = poses.weights(
            RigCurves(values.astype(np.float32), controls.names), linear=True
        ).weights
        rest = shapes.neutral.vertices.astype(np.float32)
        return rest + (weights @ flat).reshape(len(values), -1, 3)

    wanted = [pair for pair in face_correctives() if pair[0] in CORRECTIVES]
    evaluate = moves_of(pose, shapes.neutral.vertices)
    baked = bake(shapes.neutral, evaluate, controls, correctives=wanted).shapes
    largest = max((np.abs(delta).max() for _, delta in baked.moved), default=0.0)
    step = max(float(largest) / 32700, STILL_CM / 4)
    counts, columns, values = [], [np.zeros(0, np.int64)], [np.zeros((0, 3), np.int16)]
    for moving, delta in baked.moved:
        kept = np.abs(delta).max(1) > STILL_CM
        kept[0] |= not kept.any()
        counts.append(np.count_nonzero(kept))
        columns.append(np.diff(moving[kept], prepend=0))
        values.append(np.round(delta[kept] / step).astype(np.int16))
    if sum(counts) > HEAD_MOVES:
        raise MeshError(
            f"has {sum(counts)} displacements in all shapes; at most {HEAD_MOVES} are shown: "
            "decimate it"
        )
    return {
        "names": np.array(baked.names, str), "count": np.array(counts, np.int32),
        "columns": np.concatenate(columns).astype(np.uint16),
        "values": np.concatenate(values).T, "step": np.array(step, np.float32),
    }  # fmt: skip
