"""Curves to a user's blendshapes and bones: by name, then bounded least squares.

Every shape is taken as a pose of the 251 raw MetaHuman curves. Names of `rig.conversion.avatars`,
ARKit, Live Link Face, ICT-FaceKit, MetaHuman's raw curves and its board are known in the spellings
of exporters; other names come with a mapping file.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, reduce
from operator import mul
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from rig.arrays import AnyFloat, Float32, Float64
from rig.controls import DEFAULT_ID, ControlSet, default_controls
from rig.conversion.arkit import (
    GAZE_DOWN_DEGREES,
    GAZE_SIDE_DEGREES,
    GAZE_UP_DEGREES,
    PREFIX,
    RAW_ID,
    arkit_controls,
    raw_controls,
)
from rig.conversion.avatars import ShapeFit, ShapePoses, poses_of
from rig.conversion.convert import convert
from rig.curves import RigCurves
from rig.errors import ControlError, MeshError
from rig.face.accents import JOINT, quaternions
from rig.mesh.glb import read_container
from rig.mesh.glb_reader import world_rotations
from rig.mesh.shapes import ShapeSet
from rig.retarget.bake import Driver, control_halves, face_correctives


@dataclass(frozen=True, eq=False)
class FacePoses(ShapePoses):
    """Shapes of a mesh, some of them correctives of our own exports.

    Parameters
    ----------
    drivers : mapping of int to Driver
        Shapes of our own export, which are driven and not fitted.
    """

    drivers: Mapping[int, Driver] = field(default_factory=dict)

    @property
    def understood(self) -> tuple[str, ...]:
        """Names with a known meaning."""
        driven = {self.names[i] for i in (*self.drivers, *arkit_halves(self.names))}
        known = driven.union(super().understood)
        return tuple(name for name in self.names if name in known)

    def mapping(self) -> dict[str, dict[str, float]]:
        """Return the raw curves of each shape by name, but for those that are driven."""
        driven = {self.names[i] for i in (*self.drivers, *arkit_halves(self.names))}
        return {name: pose for name, pose in super().mapping().items() if name not in driven}

    def weights(self, curves: RigCurves) -> ShapeFit:
        """Weights of every frame of board, raw, ARKit or avatar curves."""
        given = driver_weights(self.drivers, curves) if self.drivers else None
        fit = self.fit(convert(curves, RAW_ID), given)
        weights = fit.weights.copy()
        for half, driving in arkit_halves(self.names).items():
            weights[:, half] = half_weight([weights[:, k] for k in driving])
        return replace(fit, weights=weights)


def match_shapes(
    names: Sequence[str],
    *,
    mapping: Mapping[str, Mapping[str, float]] | None = None,
    shapes: ShapeSet | None = None,
) -> FacePoses:
    """Interpret the names of a blendshape set.

    Parameters
    ----------
    names : sequence of str
        Shape names as exported; prefixes up to the last ``.``, ``:`` or ``|`` do not count,
        ``_L``, ``Left`` and ``left`` are the same.
    mapping : mapping of str to mapping of str to float, optional
        Own shapes: the controls (board, raw or ARKit names) each stands for, and their values.
        Comes before the known names.
    shapes : ShapeSet, optional
        The geometry, from which the weight of `mouthClose` that just closes the lips is measured.

    Raises
    ------
    MeshError
        If no name is known, or the mapping names a shape that the set has not.
    ControlError
        If the mapping names an unknown control.
    """
    own = dict(mapping or {})
    missing = [name for name in own if name not in names]
    if missing:
        raise MeshError(f"the mapping names shape {missing[0]!r}, which the mesh does not have")
    drivers = own_drivers(["" if name in own else name for name in names])
    poses, visemes = poses_of(names)
    for i, name in enumerate(names):
        if name in own:
            poses[i], visemes[i] = _own_pose(own[name]), False
    for i, pose in enumerate(driver_poses(drivers, len(names))):
        poses[i] = pose if i in drivers else poses[i]
    found = FacePoses(tuple(names), poses, visemes, drivers=drivers)
    if not found.understood:
        raise MeshError(
            f"none of the shapes ({', '.join(names[:6])} ...) has a known name; "
            "give a mapping file with rows shape,control,value"
        )
    if shapes is None or found.closing is None:
        return found
    close, jaw = (names[i] for i in found.closing)
    return replace(found, close_gain=closing_weight(shapes, jaw, close))


def closing_weight(shapes: ShapeSet, jaw_open: str, mouth_close: str) -> float:
    """Weight of the closing corrective at which the lips meet as in the neutral face.

    Pairs across the slit are vertices close together that the jaw parts and the corrective
    brings together; the weight is the median over the pairs. (ICT's corrective at 1 overlaps
    the lips by 5 mm.) 1 if there are no such pairs.
    """
    jaw, close = shapes.delta(jaw_open), shapes.delta(mouth_close)
    rest, size = shapes.neutral.vertices, shapes.neutral.size
    motion = np.linalg.norm(jaw, axis=1)
    moved = np.flatnonzero(motion > 0.5 * motion.max())
    still = np.flatnonzero(motion < 0.3 * motion.max())
    if motion.max() == 0 or len(moved) == 0 or len(still) == 0:
        return 1.0
    found = KDTree(rest[still]).query(rest[moved])
    distance, nearest = np.asarray(found[0]), np.asarray(found[1], dtype=np.int64)
    near = distance < 0.02 * size
    low, high = moved[near], still[nearest[near]]
    torn, closed = jaw[low] - jaw[high], close[low] - close[high]
    strength = np.einsum("pc,pc->p", torn, torn)
    back = -np.einsum("pc,pc->p", closed, torn)
    useful = back > 0.3 * strength
    if useful.sum() < 4:
        return 1.0
    return float(np.clip(np.median(strength[useful] / back[useful]), 0.0, 1.0))


def _own_pose(controls: Mapping[str, float]) -> Float64:
    """Raw change for controls given by board, raw or ARKit names."""
    change = np.zeros(len(raw_controls()))
    for name, value in controls.items():
        owner = _owner(name)
        values = owner.rest.copy()[None]
        values[0, owner.index(name)] += value
        raw = convert(RigCurves(values, owner.names, control_set=owner.id), RAW_ID)
        change += raw.reorder(raw_controls()).values[0] - raw_controls().rest
    return change


def _owner(name: str) -> ControlSet:
    for controls in (default_controls(), raw_controls(), arkit_controls()):
        try:
            controls.index(name)
        except ControlError:
            continue
        return controls
    raise ControlError(
        f"the mapping names control {name!r}, which is no board channel, raw curve or ARKit shape"
    )


# Correctives of our own exports, recognised by name and driven as the exporters drive them.
#
# ``deitalk face export`` writes ARKit's shapes and halves of some (`ARKIT_HALVES`).
# ``deitalk convert`` to a GLB writes a shape for each half of a board control, named after it, and
# the correctives of `rig.retarget.bake.face_correctives`; each has a `Driver`.


ARKIT_HALVES: Mapping[str, tuple[str, ...]] = {
    "jawOpen_half": ("jawOpen",),
    "eyeBlinkLeft_half": ("eyeBlinkLeft",),
    "eyeBlinkRight_half": ("eyeBlinkRight",),
    "mouthClose_half": ("jawOpen", "mouthClose"),
}
"""Shapes whose least weight drives each half."""


def half_weight(weights: Sequence[AnyFloat]) -> Float64:
    """Weight of a half [shape=(T,), range 0 to 1]: 1 where the least weight is 0.5, 0 at 0 and 1.

    Parameters
    ----------
    weights : sequence of array [shape=(T,), range 0 to 1]
        Of the shapes that drive it.
    """
    least = np.min([np.asarray(weight, np.float64) for weight in weights], axis=0)
    return np.asarray(np.maximum(1 - np.abs(2 * least - 1), 0.0))


def arkit_halves(names: Sequence[str]) -> dict[int, tuple[int, ...]]:
    """Columns of the halves among shape names, and the columns that drive each."""
    place = {name: k for k, name in enumerate(names)}
    return {
        place[half]: tuple(place[name] for name in drivers)
        for half, drivers in ARKIT_HALVES.items()
        if half in place and all(name in place for name in drivers)
    }


def own_drivers(names: Sequence[str]) -> dict[int, Driver]:
    """Drivers by column, if the names are of our own export of the board's shapes; else none.

    The board's names alone are ambiguous: other rigs use them too, and get fitted weights.
    """
    drivers, telling = _drivers()
    if not telling & set(names):
        return {}
    return {k: drivers[name] for k, name in enumerate(names) if name in drivers}


def driver_poses(drivers: Mapping[int, Driver], n_shapes: int) -> Float64:
    """Change of the raw curves at weight 1 [shape=(K, 251)]; zero for correctives."""
    board, rest = default_controls(), raw_controls().rest
    poses = np.zeros((n_shapes, len(raw_controls())))
    halves = {k: d for k, d in drivers.items() if len(d.groups) == 1 and d.peak is None}
    if halves:
        values = np.stack([driver.pose(board) for driver in halves.values()])
        curves = RigCurves(values, board.names, control_set=board.id)
        raw = convert(curves, RAW_ID).reorder(raw_controls())
        poses[list(halves)] = raw.values.astype(np.float64) - rest
    return poses


def driver_weights(drivers: Mapping[int, Driver], curves: RigCurves) -> dict[int, Float64]:
    """Weights by column [each shape=(T,), range 0 to 1] of board, raw or ARKit curves."""
    board = default_controls()
    values = convert(curves, DEFAULT_ID).reorder(board).values
    return {k: driver.weight(values, board) for k, driver in drivers.items()}


@cache
def _drivers() -> tuple[dict[str, Driver], frozenset[str]]:
    """Drivers of all names of our exporter, and the names that only it uses."""
    halves, correctives = dict(control_halves(default_controls())), dict(face_correctives())
    telling = {name for name in halves if name.endswith("_negative")} | set(correctives)
    return halves | correctives, frozenset(telling)


# Head, neck and eyes of a skinned avatar: bones of a GLB that follow a take's head and gaze.
#
# Bones are those of the file's VRM humanoid, else joints found by name. The head track turns the
# head about the avatar's own axes; the neck takes `NECK_SHARE` of it. Eyes turn by the raw look
# curves, unless shapes of the file show the gaze. A VRM 0 faces -z, every other avatar +z.


NECK_SHARE = 0.4
"""Share of the head's turn that the neck takes; our choice: the upper joints turn the most."""
BONES = {
    "head": r"head|頭",
    "neck": r"neck(?:1|01|twist01)?|首",
    "leftEye": r"(?:left|l)_?eye(?:ball)?|eye(?:ball)?_?(?:left|l)|l_?faceeye|左目",
    "rightEye": r"(?:right|r)_?eye(?:ball)?|eye(?:ball)?_?(?:right|r)|r_?faceeye|右目",
}
"""Names of joints, without case and prefixes such as ``mixamorig:`` and ``CC_Base_``."""
_PREFIXES = r"^.*[:|]|^(?:cc_base_|mixamorig|j_bip_c_|j_adj_|bip\d*_|def-|facial_)+"


def turns_of(path: Path | str, curves: RigCurves, *, has_gaze: bool) -> dict[int, Float64]:
    """Rotations of the bones of a GLB over time.

    Parameters
    ----------
    path : Path or str
        The GLB.
    curves : RigCurves
        Board, raw, ARKit or avatar curves, with a head track for the head.
    has_gaze : bool
        Whether shapes of the file show the gaze, so that its eyes stay.

    Returns
    -------
    turns : dict of int to array [shape=(T, 4)]
        Quaternions x, y, z, w of nodes; empty if there is no such bone or nothing moves.
    """
    document, _ = read_container(path)
    found, facing = _bones(document), _facing(document)
    wanted: dict[str, Rotation] = {}
    if curves.head is not None:
        head = Rotation.from_quat(quaternions(curves.head))
        share = NECK_SHARE if "neck" in found and "head" in found else 0.0
        wanted = {"head": _part(head, 1 - share), "neck": _part(head, share)}
    if not has_gaze:
        wanted |= {f"{side}Eye": gaze_turn(curves, side[0].upper()) for side in ("left", "right")}
    rest = world_rotations(document)
    turns = {}
    for bone, turn in wanted.items():
        if found.get(bone) in rest and np.abs(turn.magnitude()).max() > 0:
            parent, local = rest[found[bone]]
            axes = parent.inv() * facing
            # Quaternions of one hemisphere, so that players turn the short way.
            rows = (axes * turn * axes.inv() * local).as_quat()
            sign = np.where((rows[1:] * rows[:-1]).sum(axis=1) < 0, -1.0, 1.0)
            turns[found[bone]] = np.concatenate([rows[:1], rows[1:] * np.cumprod(sign)[:, None]])
    return turns


def turn_of_bones(document: dict[str, Any], turns: Mapping[int, Rotation]) -> Rotation | None:
    """Rotations of the head by those of its bone and the neck's, by node; None without them."""
    found, rest, facing = _bones(document), world_rotations(document), _facing(document)
    parts = []
    for node in (found.get("neck"), found.get("head")):
        if node in turns and node in rest:
            parent, local = rest[node]
            axes = parent.inv() * facing
            parts.append(axes.inv() * turns[node] * local.inv() * axes)
    return reduce(mul, parts) if parts else None


def head_track(turn: Rotation, place: Float64 | None = None) -> Float32 | None:
    """Head track of turns and of places as of `rig.face.accents.matrices`, cm; None if still."""
    yaw, pitch, roll = (turn.as_euler("YXZ", degrees=True) * [-1, -1, 1]).T
    shift = np.zeros((len(yaw), 3)) if place is None else place - JOINT + turn.apply(JOINT)
    track = np.column_stack([yaw, pitch, roll, shift]).astype(np.float32)
    return track if np.abs(track).max() > 1e-4 else None


def _facing(document: dict[str, Any]) -> Rotation:
    is_older = "VRM" in document.get("extensions", {})
    return Rotation.from_euler("y", 180.0 * is_older, degrees=True)


def _part(turn: Rotation, share: float) -> Rotation:
    return Rotation.from_rotvec(share * turn.as_rotvec())


def gaze_turn(curves: RigCurves, sides: str = "LR") -> Rotation:
    """Rotation of an eye against the head by its raw look curves; the mean of both by default."""
    raw = convert(curves, RAW_ID)
    look = {
        way: np.mean([raw[f"{PREFIX}eyeLook{way}{side}"] for side in sides], axis=0)
        for way in ("Up", "Down", "Left", "Right")
    }
    track = np.zeros((len(raw), 6))
    track[:, 0] = GAZE_SIDE_DEGREES * (look["Right"] - look["Left"])
    track[:, 1] = GAZE_UP_DEGREES * look["Up"] - GAZE_DOWN_DEGREES * look["Down"]
    return Rotation.from_quat(quaternions(track))


def _bones(document: dict[str, Any]) -> dict[str, int]:
    """Nodes of head, neck and eyes."""
    given = document.get("extensions", {})
    bones = given.get("VRMC_vrm", {}).get("humanoid", {}).get("humanBones", {})
    named = {bone: data["node"] for bone, data in bones.items() if bone in BONES}
    for data in given.get("VRM", {}).get("humanoid", {}).get("humanBones", []):
        if data.get("bone") in BONES:
            named[data["bone"]] = data["node"]
    joints = [joint for skin in document.get("skins", []) for joint in skin["joints"]]
    for joint in [] if named else joints:
        name = re.sub(_PREFIXES, "", str(document["nodes"][joint].get("name", "")).lower())
        for bone, pattern in BONES.items():
            if re.fullmatch(pattern, name):
                named.setdefault(bone, joint)
    return named
