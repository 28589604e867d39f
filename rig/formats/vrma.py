"""VRMA (VRMC_vrm_animation 1.0): expressions, head and gaze of a take for any VRM avatar.

A GLB without a mesh. Expressions are the x of nodes: the presets of VRM 1 (vowels, blinks) for
every avatar, and Apple's 52 names as custom ones, which avatars of "perfect sync" have. The head
turns as the head track; the gaze is the rotation of the look-at node. Axes are x
to the avatar's left, y up, z forward.
"""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from rig.controls import ControlSet
from rig.conversion.arkit import ARKIT_ID, apple_names, arkit_controls
from rig.conversion.convert import convert, convert_and_note
from rig.curves import RigCurves
from rig.errors import FormatError
from rig.face.head_pose import quaternions
from rig.formats.glb import grid_of, sampled, tracks_of
from rig.mesh.glb import GlbBuilder, Move, add_animation, read_container, write_container
from rig.retarget.bones import gaze_turn, head_track

EXTENSION = "VRMC_vrm_animation"
BONES = {"hips": 1.0, "spine": 0.1, "chest": 0.15, "neck": 0.25, "head": 0.1}
"""Bones from the hips up, and the height of each above the one before, metres."""
PRESETS = ("aa", "ih", "ou", "ee", "oh", "blink", "blinkLeft", "blinkRight")
APPLE = apple_names()


def note(path: Path, curves: RigCurves) -> str:
    """Note on the controls that the two sets of expressions do not show."""
    return "; ".join(convert_and_note(curves, to)[1] for to in (ARKIT_ID, "vrm1"))


def write(path: Path, curves: RigCurves) -> None:
    """Write board curves and their head track."""
    avatar, arkit = convert(curves, "vrm1"), convert(curves, ARKIT_ID)
    weights = {name: avatar[name] for name in PRESETS}
    weights |= dict(zip(APPLE, arkit.values[:, :52].T, strict=True))
    builder = GlbBuilder({"asset": {"version": "2.0", "generator": "deitalk"}})
    nodes: list[dict[str, Any]] = [
        {"name": bone, "translation": [0, height, 0], "children": [i + 1]}
        for i, (bone, height) in enumerate(BONES.items())
    ]
    del nodes[-1]["children"]
    first, look = len(nodes), len(nodes) + len(weights)
    nodes += [{"name": name} for name in (*weights, "lookAt")]
    moves: list[Move] = [(look, "rotation", gaze_turn(curves).as_quat())]
    for i, weight in enumerate(weights.values()):
        moves.append((first + i, "translation", weight[:, None] * [1.0, 0, 0]))
    if curves.head is not None:
        # The head alone: an avatar may have no neck, and would lose its share.
        moves.append((list(BONES).index("head"), "rotation", quaternions(curves.head)))
    add_animation(builder, moves, curves.fps)
    named = {name: {"node": first + i} for i, name in enumerate(weights)}
    builder.json |= {
        "nodes": nodes,
        "scenes": [{"nodes": [0, *range(first, len(nodes))]}],
        "scene": 0,
        "extensionsUsed": [EXTENSION],
        "extensions": {
            EXTENSION: {
                "specVersion": "1.0",
                "humanoid": {"humanBones": {bone: {"node": i} for i, bone in enumerate(BONES)}},
                "expressions": {
                    "preset": {name: named[name] for name in PRESETS},
                    "custom": {name: named[name] for name in APPLE},
                },
                "lookAt": {"node": look, "offsetFromHeadBone": [0, 0.06, 0]},
            }
        },
    }
    write_container(path, builder.json, bytes(builder.binary))


def read(path: Path, controls: ControlSet | None, fps: float | None) -> RigCurves:
    """Read a VRMA with Apple's expressions, as we write it, as ARKit curves with their head.

    Raises
    ------
    FormatError
        If it has no such animation, or its keys are damaged.
    """
    document, binary = read_container(path)
    try:
        own, moved = document["extensions"][EXTENSION], tracks_of(document, binary, 0)
        custom = own["expressions"]["custom"]
        tracks = {name: moved.get((custom[name]["node"], "translation")) for name in custom}
        if not any(tracks.get(name) for name in APPLE):
            raise FormatError(f"no {EXTENSION} with Apple's expressions")
        rate, at = grid_of(moved, fps, len(arkit_controls()))
        values = np.zeros((len(at), len(arkit_controls())), np.float32)
        for column, name in enumerate(APPLE):
            if track := tracks.get(name):
                values[:, column] = sampled(track, at)[:, 0].clip(0, 1)
        turn = Rotation.identity(len(at))
        for bone in ("neck", "head"):
            node = own["humanoid"]["humanBones"].get(bone, {}).get("node")
            if (node, "rotation") in moved:
                turn = turn * Rotation.from_quat(sampled(moved[node, "rotation"], at))
        names, head = arkit_controls().names, head_track(turn)
        return RigCurves(values, names, rate, control_set=ARKIT_ID, head=head)
    except FormatError as error:
        raise FormatError(f"{path.name}: {error}") from error
    except (LookupError, TypeError, AttributeError, ValueError, OverflowError) as error:
        raise FormatError(f"{path.name} has no {EXTENSION} with Apple's expressions") from error
