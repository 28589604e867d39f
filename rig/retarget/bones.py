"""Head, neck and eyes of a skinned avatar: bones of a GLB that follow a take's head and gaze.

Bones are those of the file's VRM humanoid, else joints found by name. The head track turns the
head about the avatar's own axes; the neck takes `NECK_SHARE` of it. Eyes turn by the raw look
curves, unless shapes of the file show the gaze. A VRM 0 faces -z, every other avatar +z.
"""

import re
from collections.abc import Mapping
from functools import reduce
from operator import mul
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from rig.arrays import Float32, Float64
from rig.conversion.arkit import gaze_degrees
from rig.conversion.convert import convert
from rig.conversion.raw import RAW_ID
from rig.curves import RigCurves
from rig.face.head_pose import JOINT, quaternions
from rig.mesh.glb import read_container
from rig.mesh.glb_reader import world_rotations

NECK_SHARE = 0.4
"""Share of the head's turn that the neck takes; our choice: the upper joints turn the most."""
BONES = {
    "head": r"head|頭",
    "neck": r"neck(?:1|01|twist01)?|首",
    "leftEye": r"(?:left|l)_?eye(?:ball)?|eye(?:ball)?_?(?:left|l)|l_?faceeye|左目",
    "jaw": r"jaw(?:bone|root|master|_?joint)?|mandible|顎",
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
    found, facing = bones_of(document), _facing(document)
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
    found, rest, facing = bones_of(document), world_rotations(document), _facing(document)
    parts = []
    for node in (found.get("neck"), found.get("head")):
        if node in turns and node in rest:
            parent, local = rest[node]
            axes = parent.inv() * facing
            parts.append(axes.inv() * turns[node] * local.inv() * axes)
    return reduce(mul, parts) if parts else None


def head_track(turn: Rotation, place: Float64 | None = None) -> Float32 | None:
    """Head track of turns and of places as of `rig.face.head_pose.matrices`, cm; None if still."""
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
    right, up = np.mean([gaze_degrees(raw, side) for side in sides], axis=0)
    return Rotation.from_quat(quaternions(np.column_stack([right, up, np.zeros(len(raw))])))


def bones_of(document: dict[str, Any]) -> dict[str, int]:
    """Nodes of head, neck, jaw and eyes: a VRM's, or the joints of these names."""
    given = document.get("extensions", {})
    bones = given.get("VRMC_vrm", {}).get("humanoid", {}).get("humanBones", {})
    named = {bone: data["node"] for bone, data in bones.items() if bone in BONES}
    for data in given.get("VRM", {}).get("humanoid", {}).get("humanBones", []):
        if data.get("bone") in BONES:
            named[data["bone"]] = data["node"]
    joints = [joint for skin in document.get("skins", []) for joint in skin["joints"]]
    for joint in [] if named else joints:
        bone = bone_named(str(document["nodes"][joint].get("name", "")))
        if bone is not None:
            named.setdefault(bone, joint)
    return named


def bone_named(name: str) -> str | None:
    """Return the bone of `BONES` that a node's name means, or none."""
    bare = re.sub(_PREFIXES, "", name.lower())
    return next((bone for bone, pattern in BONES.items() if re.fullmatch(pattern, bare)), None)
