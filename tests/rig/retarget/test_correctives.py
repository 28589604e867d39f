"""Our own heads, exported and driven again: their correctives are known by name."""

import numpy as np
import pytest

from rig import write_curves
from rig.face import build_head
from rig.mesh.glb import read_container
from rig.mesh.trimesh import TriMesh
from rig.retarget.blendshapes import match_shapes
from rig.retarget.correctives import half_weight
from rig.retarget.head_glb import CORRECTIVES, arkit_pose, corrective_weights, write_head
from rig.retarget.retarget_files import read_shapes, retarget_curves
from tests.rig.retarget.test_blendshapes import board
from tests.rig.retarget.test_retarget_files import glb_weights

TOGETHER = {f"CTRL_{s}_mouth_lipsTogether{r}": 0.7 for s in "LR" for r in "UD"}
TAKE = board(
    {},
    {"CTRL_C_jaw.ty": 0.5},
    {"CTRL_C_jaw.ty": 0.3, **TOGETHER},
    {"CTRL_L_eye_blink": 0.25, "CTRL_R_eye_blink": 1.0},
    {"CTRL_C_jaw.tx": -0.4, "CTRL_L_mouth_cornerPull": 0.8},
)


def animated_weights(path):
    return read_container(path)[0]["meshes"][0]["extras"]["targetNames"], glb_weights(path)


def test_halves_are_on_in_the_middle():
    weights = [np.array([0.0, 0.25, 0.5, 1.0]), np.array([1.0, 1.0, 0.75, 0.5])]
    assert half_weight(weights[:1]).tolist() == [0, 0.5, 1, 0]
    assert half_weight(weights).tolist() == [0, 0.5, 1, 1]


@pytest.fixture(scope="module")
def head(tmp_path_factory):
    path = tmp_path_factory.mktemp("head") / "head.glb"
    head = build_head(0)
    write_head(path, head)
    return head, path


def test_exported_head_is_retargeted_with_its_correctives(head, tmp_path):
    _, path = head
    report = retarget_curves(TAKE, path, tmp_path / "out.glb")
    assert not any("unknown name" in note for note in report.notes)
    names, weights = animated_weights(tmp_path / "out.glb")
    assert set(CORRECTIVES) <= set(names)
    for row in weights:
        shown = dict(zip(names, row.tolist(), strict=True))
        for half, weight in corrective_weights(shown).items():
            assert shown[half] == pytest.approx(weight, abs=1e-6), half
    assert weights[1][names.index("jawOpen_half")] == pytest.approx(1.0, abs=1e-6)


def test_correctives_bring_an_exported_head_nearer_to_the_head_itself(head, tmp_path):
    source, path = head
    shapes = read_shapes(path)
    fit = match_shapes(shapes.names, shapes=shapes).weights(TAKE)
    shown = shapes.evaluate(fit.weights[1:2])[0]
    without = fit.weights[1:2].copy()
    without[:, [shapes.names.index(name) for name in CORRECTIVES]] = 0
    truth = 0.01 * arkit_pose(source, {"jawOpen": 0.5})
    used = read_shapes(path).neutral
    assert isinstance(used, TriMesh) and used.vertices.shape == truth.shape
    error = np.linalg.norm(shown - truth, axis=1).max()
    bare = np.linalg.norm(shapes.evaluate(without)[0] - truth, axis=1).max()
    assert error < 5e-5 < bare  # metres


def test_converted_take_is_retargeted_to_the_same_weights(tmp_path):
    write_curves(tmp_path / "face.glb", TAKE)
    report = retarget_curves(TAKE, tmp_path / "face.glb", tmp_path / "again.glb")
    assert not report.notes and report.lost == pytest.approx(0, abs=1e-5)
    names, written = animated_weights(tmp_path / "face.glb")
    assert {"jaw_half", "seal_L", "seal_R", "CTRL_C_jaw.tx_negative"} <= set(names)
    again, driven = animated_weights(tmp_path / "again.glb")
    assert again == names
    np.testing.assert_allclose(driven, written, atol=1e-6)
    assert driven.max(axis=0)[[names.index(n) for n in ("jaw_half", "seal_L")]].min() > 0.2


def test_board_names_of_other_rigs_are_fitted():
    poses = match_shapes(["CTRL_C_jaw.ty", "CTRL_L_eye_blink.ty"])
    assert not poses.drivers
    assert poses.weights(TAKE).weights[1].tolist() == pytest.approx([0.5, 0], abs=1e-6)


def test_mapping_takes_precedence_over_known_names():
    names = ["CTRL_C_jaw.ty", "jaw_half"]
    poses = match_shapes(names, mapping={"jaw_half": {"CTRL_L_eye_blink": 1.0}})
    assert set(poses.drivers) == set()
