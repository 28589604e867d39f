"""The head's morph export: ARKit's names, what each moves, correctives, the file."""

import numpy as np
import pytest

from deitalk.research.poses import pose_values
from rig.face import build_head
from rig.mesh.glb_reader import read_glb
from rig.retarget.head_glb import (
    CORRECTIVES,
    SHAPES,
    arkit_morphs,
    arkit_pose,
    corrective_weights,
    write_head,
)
from rig.retarget.morph_head import morph_head, shown_controls


@pytest.fixture(scope="module")
def head():
    return build_head(0)


@pytest.fixture(scope="module")
def morphs(head):
    return arkit_morphs(head)


@pytest.fixture(scope="module")
def file(head, tmp_path_factory):
    path = tmp_path_factory.mktemp("glb") / "head.glb"
    write_head(path, head)
    return path


def linear(head, morphs, pose: dict[str, float]) -> np.ndarray:
    """Vertices in a viewer for weights of a tracker."""
    weights = {**pose, **corrective_weights(pose)}
    moved = [w * morphs.deltas[morphs.names.index(n)].astype(float) for n, w in weights.items()]
    return head.mesh.vertices + sum(moved)


def farthest_mm(a: np.ndarray, b: np.ndarray) -> float:
    return 10 * float(np.linalg.norm(a - b, axis=-1).max())


def test_all_52_of_apple_are_there_and_move(morphs):
    assert len(SHAPES) == 52 and len(set(SHAPES)) == 52
    assert {"eyeBlinkLeft", "jawOpen", "mouthClose", "cheekPuff", "tongueOut"} <= set(SHAPES)
    assert morphs.names == (*SHAPES, *CORRECTIVES)
    assert (np.linalg.norm(morphs.deltas, axis=-1).max(1)[:52] > 0.1).all()  # 1 mm


def test_shapes_are_the_boards_poses(head, morphs):
    expected = head.pose(pose_values({"CTRL_C_jaw.ty": 1.0}))
    assert farthest_mm(linear(head, morphs, {"jawOpen": 1.0}), expected) < 0.01
    expected = head.pose(pose_values({"CTRL_L_mouth_cornerPull.ty": 1.0}))
    assert farthest_mm(linear(head, morphs, {"mouthSmileLeft": 1.0}), expected) < 0.01


def test_left_shapes_move_the_characters_left(head, morphs):
    for stem in ("eyeBlink", "mouthSmile", "browDown", "noseSneer"):
        delta = np.linalg.norm(morphs.deltas[morphs.names.index(f"{stem}Left")], axis=-1)
        assert head.mesh.vertices[delta > 0.5 * delta.max(), 0].min() > 0


def test_mouth_close_shuts_an_open_jaw(head, morphs):
    for amount in (0.5, 1.0):
        pose = {"jawOpen": amount, "mouthClose": amount}
        assert head.lip_gaps(linear(head, morphs, pose)[None]).max() < 0.03  # 0.3 mm
        assert head.lip_gaps(linear(head, morphs, {"jawOpen": amount})[None]).max() > 0.5


def test_tongue_comes_out_between_the_teeth(head, morphs):
    tongue = head.slices["tongue"]
    out = linear(head, morphs, {"jawOpen": 0.4, "tongueOut": 1.0})
    lips = head.lip_rims[0]
    assert out[tongue, 2].max() > out[head.slices["skin"]][lips, 2].max() - 0.2


@pytest.mark.parametrize("pose", CORRECTIVES.values())
def test_correctives_make_their_pose_exact(head, morphs, pose):
    assert farthest_mm(linear(head, morphs, pose), arkit_pose(head, pose)) < 0.01
    without = head.mesh.vertices + sum(
        w * morphs.deltas[morphs.names.index(n)].astype(float) for n, w in pose.items()
    )
    assert farthest_mm(without, arkit_pose(head, pose)) > 0.5  # they are needed


def test_file_reads_back_in_metres_with_its_names(head, morphs, file):
    shapes = read_glb(file)
    assert tuple(shapes.names) == morphs.names
    assert np.abs(shapes.neutral.vertices * 100 - head.mesh.vertices).max() < 1e-4
    assert np.abs(shapes.deltas * 100 - morphs.deltas).max() < 2e-3  # stillness cut at 0.01 mm


def test_targets_are_sparse_for_an_independent_reader(morphs, file):
    import pygltflib

    document = pygltflib.GLTF2().load(str(file))
    (mesh,) = document.meshes
    assert mesh.extras["targetNames"] == list(morphs.names)
    assert set(mesh.extras["correctives"]) == set(CORRECTIVES)
    for target in mesh.primitives[0].targets:
        accessor = document.accessors[target["POSITION"]]
        assert accessor.sparse is not None and accessor.sparse.count < accessor.count
    assert file.stat().st_size < 12e6


def test_controls_that_are_shown_are_those_of_the_baked_shapes():
    rig = morph_head(0)
    baked = {half.control for d in rig.drivers for group in d.groups for half in group}
    assert shown_controls() == baked
