"""Bones of a skinned avatar follow the take: forward kinematics by hand, in every facing and rest pose."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rig import RigCurves, default_controls
from rig.errors import FormatError
from rig.mesh.glb import GlbBuilder, read_container, write_container, write_glb
from rig.mesh.glb_reader import read_accessor
from rig.mesh.shapes import ShapeSet
from rig.mesh.trimesh import TriMesh
from rig.retarget.bones import NECK_SHARE
from rig.retarget.retarget_files import CUBIC, retarget_curves

BOARD = default_controls()
NAMES = {
    "plain": ("Neck", "Head", "LeftEye", "RightEye"),
    "cc": ("CC_Base_NeckTwist01", "CC_Base_Head", "CC_Base_L_Eye", "CC_Base_R_Eye"),
    "mixamo": ("mixamorig:Neck", "mixamorig:Head", "mixamorig:LeftEye", "mixamorig:RightEye"),
    "vroid": ("J_Bip_C_Neck", "J_Bip_C_Head", "J_Adj_L_FaceEye", "J_Adj_R_FaceEye"),
}
REST = Rotation.from_euler(
    "xyz", [[10, 20, 30], [-80, 5, 0], [0, 40, -15], [0, -40, 15]], degrees=True
)


def avatar(path, names, *, shapes=("jawOpen",), vrm0=False, matrix=False, skinned=False):
    """A triangle with shapes, and a chain hips, neck, head, eyes whose rest pose is turned."""
    mesh = TriMesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    write_glb(path, ShapeSet(mesh, shapes, np.ones((len(shapes), 3, 3), np.float32)))
    document, binary = read_container(path)
    nodes = document["nodes"]
    nodes.append({"name": "Hips", "rotation": [0, 0.6, 0, 0.8], "children": [2]})
    for i, (name, rest) in enumerate(zip(names, REST, strict=True)):
        turned = {"rotation": rest.as_quat().tolist()}
        if matrix:
            local = np.eye(4)
            local[:3, :3], local[:3, 3] = 2 * rest.as_matrix(), [0, 1, 0]
            turned = {"matrix": local.T.ravel().tolist()}
        children = {0: [3], 1: [4, 5]}.get(i, [])
        nodes.append({"name": name, **turned, **({"children": children} if children else {})})
    document["scenes"][0]["nodes"].append(1)
    document["skins"] = [{"joints": [1, 2, 3, 4, 5]}]
    if skinned:  # the triangle hangs on the head
        builder = GlbBuilder(document, bytearray(binary))
        places = builder.view(np.tile(np.array([2, 0, 0, 0], np.uint8), (3, 1)))
        kind = {"componentType": 5121, "count": 3, "type": "VEC4"}
        document["meshes"][0]["primitives"][0]["attributes"] |= {
            "JOINTS_0": builder.accessor(bufferView=places, **kind),
            "WEIGHTS_0": builder.dense(np.eye(4)[[0, 0, 0]], "VEC4"),
        }
        document["nodes"][0]["skin"], binary = 0, bytes(builder.binary)
    if vrm0:
        bones = zip(("neck", "head", "leftEye", "rightEye"), (2, 3, 4, 5), strict=True)
        human = [{"bone": bone, "node": node} for bone, node in bones]
        document["extensions"] = {"VRM": {"humanoid": {"humanBones": human}}}
    write_container(path, document, binary)


def take(frames=5):
    values = np.tile(BOARD.rest, (frames, 1))
    values[:, BOARD.index("CTRL_C_eye.tx")] = np.linspace(0, 0.5, frames)  # to its left
    head = np.zeros((frames, 6), np.float32)
    head[:, :3] = np.linspace(0, 1, frames)[:, None] * [30, 20, -10]
    return RigCurves(values, BOARD.names, head=head)


def worlds(path):
    """World rotations over time of the chain [neck, head, left eye, right eye]."""
    document, binary = read_container(path)
    animation = document["animations"][0]
    local = {}
    for node in range(1, 6):
        local[node] = Rotation.from_quat(document["nodes"][node].get("rotation", [0, 0, 0, 1]))
    for channel in animation["channels"]:
        if channel["target"]["path"] == "rotation":
            output = animation["samplers"][channel["sampler"]]["output"]
            local[channel["target"]["node"]] = Rotation.from_quat(
                read_accessor(document, binary, output)
            )
    neck = local[1] * local[2]
    head = neck * local[3]
    return [neck, head, head * local[4], head * local[5]]


def expected(curves, facing):
    """Turns in the world: yaw right about -y, pitch up about -x, roll right about z, in its axes."""
    turn = Rotation.from_euler("YXZ", curves.head[:, :3] * [-1, -1, 1], degrees=True)
    gaze = Rotation.from_euler("Y", 40 * curves["CTRL_C_eye.tx"][:, None], degrees=True)
    share = Rotation.from_rotvec(NECK_SHARE * turn.as_rotvec())
    around = [facing * r * facing.inv() for r in (share, turn, turn * gaze)]
    return [around[0], around[1], around[2], around[2]]


@pytest.mark.parametrize("kind", [*NAMES, "vrm0", "matrix"])
def test_head_neck_and_eyes_turn_in_the_world_as_the_take(tmp_path, kind):
    names = NAMES.get(kind, NAMES["plain"])
    if kind == "vrm0":
        names = ("a", "b", "c", "d")
    avatar(tmp_path / "a.glb", names, vrm0=kind == "vrm0", matrix=kind == "matrix")
    curves = take()
    report = retarget_curves(curves, tmp_path / "a.glb", tmp_path / "out.glb")
    assert report.bones == 4
    facing = Rotation.from_euler("y", 180 if kind == "vrm0" else 0, degrees=True)
    hips = Rotation.from_quat([0, 0.6, 0, 0.8])
    rest = [hips * REST[0], hips * REST[0] * REST[1]]
    rest += [rest[1] * REST[2], rest[1] * REST[3]]
    for found, turn, at_rest in zip(
        worlds(tmp_path / "out.glb"), expected(curves, facing), rest, strict=True
    ):
        assert (found * (turn * at_rest).inv()).magnitude().max() < 1e-6


def test_eyes_stay_where_shapes_show_the_gaze_and_what_cannot_be_shown_is_said(tmp_path):
    shapes = ("jawOpen", "eyeLookOutLeft", "eyeLookInRight")
    avatar(tmp_path / "a.glb", NAMES["plain"], shapes=shapes)
    report = retarget_curves(take(), tmp_path / "a.glb", tmp_path / "out.glb")
    assert report.bones == 2
    avatar(tmp_path / "b.glb", ("a", "b", "c", "d"))
    report = retarget_curves(take(), tmp_path / "b.glb", tmp_path / "out2.glb")
    assert report.bones == 0
    assert "the file has no bone of a head: its turn is not shown" in report.notes


def test_few_cubic_keys_stay_near_the_weights(tmp_path):
    """Khronos' formula of CUBICSPLINE (appendix C) on what is stored."""
    avatar(tmp_path / "a.glb", NAMES["plain"])
    curves = take(60)
    curves.values.setflags(write=True)
    curves.values[:, BOARD.index("CTRL_C_jaw.ty")] = 0.5 - 0.5 * np.cos(np.arange(60) / 6)
    report = retarget_curves(curves, tmp_path / "a.glb", tmp_path / "out.glb", keys=0.01)
    assert CUBIC in report.notes
    with pytest.raises(FormatError, match=r"keys=0.01 does not apply to .*; it does to .glb and"):
        retarget_curves(curves, tmp_path / "a.glb", tmp_path / "out.npz", keys=0.01)
    document, binary = read_container(tmp_path / "out.glb")
    animation = document["animations"][0]
    sampler = animation["samplers"][animation["channels"][0]["sampler"]]
    assert sampler["interpolation"] == "CUBICSPLINE"
    times = read_accessor(document, binary, sampler["input"])
    arrive, values, leave = read_accessor(document, binary, sampler["output"]).reshape(-1, 3).T
    assert len(times) <= 0.15 * 60
    for i, at in enumerate(curves.times):
        k = min(np.searchsorted(times, at, side="right") - 1, len(times) - 2)
        span = times[k + 1] - times[k]
        t = (at - times[k]) / span
        shown = (
            (2 * t**3 - 3 * t**2 + 1) * values[k]
            + span * (t**3 - 2 * t**2 + t) * leave[k]
            + (-2 * t**3 + 3 * t**2) * values[k + 1]
            + span * (t**3 - t**2) * arrive[k + 1]
        )
        assert abs(shown - curves["CTRL_C_jaw.ty"][i]) <= 0.0101
