"""Curves on a user's blendshapes: names, known answers, laws; and baking a rig into shapes."""

import json

import numpy as np
import pytest

from rig import RigCurves, default_controls
from rig.errors import ControlError, FormatError, MeshError
from rig.mesh.shapes import ShapeSet
from rig.mesh.trimesh import TriMesh
from rig.retarget.blendshapes import closing_weight, match_shapes
from rig.retarget.mapping_files import read_mapping

BOARD = default_controls()
ARKIT = ("jawOpen", "mouthClose", "mouthSmileLeft", "mouthSmileRight", "eyeBlinkLeft", "mouthDimpleLeft",
         "mouthFunnel", "mouthPucker", "browInnerUp", "mouthRollUpper", "mouthRollLower")  # fmt: skip


def board(*poses):
    values = np.tile(BOARD.rest, (len(poses), 1))
    for row, pose in zip(values, poses, strict=True):
        for name, value in pose.items():
            matching = [i for i, n in enumerate(BOARD.names) if n.startswith(name)]
            assert matching, name
            row[matching] = value
    return RigCurves(values, BOARD.names)


def weights_of(names, *poses, **options):
    fit = match_shapes(names, **options).weights(board(*poses))
    return [
        {n: round(float(w), 6) for n, w in zip(names, row, strict=True) if w > 1e-6}
        for row in fit.weights
    ], fit


def test_known_answers_for_arkit():
    found, fit = weights_of(
        ARKIT,
        {},
        {"CTRL_C_jaw.ty": 0.5},
        {"CTRL_L_mouth_cornerPull": 1.0},
        {"CTRL_L_eye_blink": 0.3},
        {"CTRL_L_eye_blink": -1.0},
    )
    assert found == [{}, {"jawOpen": 0.5}, {"mouthSmileLeft": 1.0}, {"eyeBlinkLeft": 0.3}, {}]
    assert "eyeWidenL" in fit.unsaid


def test_mouth_close_is_a_share_of_the_open_jaw():
    together = {f"CTRL_{s}_mouth_lipsTogether{r}": 1.0 for s in "LR" for r in "UD"}
    half = {name: 0.5 for name in together}
    found, fit = weights_of(
        ARKIT,
        {"CTRL_C_jaw.ty": 0.6} | together,
        {"CTRL_C_jaw.ty": 0.6} | half,
        together,
    )
    assert found[0] == pytest.approx({"jawOpen": 0.6, "mouthClose": 0.6})
    assert found[1] == pytest.approx({"jawOpen": 0.6, "mouthClose": 0.3})
    assert found[2] == {}  # nothing to close
    assert fit.lost == pytest.approx(0.0, abs=1e-6)


def test_a_middle_shape_split_by_side_moves_by_side():
    # ICT-FaceKit splits browInnerUp; a set without sides joins two.
    raised = {"CTRL_L_brow_raiseIn": 1.0}
    found, _ = weights_of(("browInnerUp_L", "browInnerUp_R"), raised)
    assert set(found[0]) == {"browInnerUp_L"}
    found, _ = weights_of(
        ("smile", "mouthSmile"), {"CTRL_L_mouth_cornerPull": 0.5, "CTRL_R_mouth_cornerPull": 0.5}
    )
    assert found[0] == pytest.approx({"mouthSmile": 0.5})


def test_raw_and_board_names_are_driven_exactly():
    names = ("CTRL_expressions_mouthSharpCornerPullL", "CTRL_R_mouth_dimple")
    found, _ = weights_of(names, {"CTRL_L_mouth_sharpCornerPull": 0.7, "CTRL_R_mouth_dimple": 0.2})
    assert found[0] == pytest.approx({names[0]: 0.7, names[1]: 0.2})


def test_weights_stay_in_range_for_any_curves(rng):
    values = rng.uniform(BOARD.minimum, BOARD.maximum, size=(50, len(BOARD.names)))
    poses = match_shapes(ARKIT)
    fit = poses.weights(RigCurves(values, BOARD.names))
    assert fit.weights.min() >= 0 and fit.weights.max() <= 1
    jaw, close = fit.weights[:, 0], fit.weights[:, 1]
    assert (close <= jaw + 1e-6).all()
    assert 0 < fit.lost <= 1


def test_fit_is_the_bounded_least_squares_solution(rng):
    from scipy.optimize import lsq_linear

    from rig.conversion.shape_fit import bounded_fit

    poses = rng.normal(size=(8, 30)) * (rng.random((8, 30)) < 0.4)
    moved = rng.normal(size=(20, 30))
    fitted = bounded_fit(moved, poses)
    for row, target in zip(fitted, moved, strict=True):
        expected = lsq_linear(poses.T, target, bounds=(0, 1)).x
        np.testing.assert_allclose(row, expected, atol=2e-3)


def test_own_names_are_driven_by_a_mapping(tmp_path):
    (tmp_path / "m.csv").write_text(
        "shape,control,value\ngrin,mouthCornerPullL,1\ngrin,mouthCornerPullR,1\nopen,CTRL_C_jaw.ty,0.5\n"
    )
    mapping = read_mapping(tmp_path / "m.csv")
    found, _ = weights_of(
        ("grin", "open", "other"),
        {"CTRL_L_mouth_cornerPull": 0.4, "CTRL_R_mouth_cornerPull": 0.4, "CTRL_C_jaw.ty": 0.25},
        mapping=mapping,
    )
    assert found[0] == pytest.approx({"grin": 0.4, "open": 0.5})
    (tmp_path / "m.json").write_text(json.dumps(mapping))
    assert read_mapping(tmp_path / "m.json") == mapping


@pytest.mark.parametrize(
    "text",
    [
        "shape,control,value\ngrin,jaw,0.5\nopen,brow,1\n",
        "\ufeffshape;control;value\r\ngrin;jaw;0,5\r\n;;\r\nopen;brow;\r\n",
        "sep=;\nshape;control;value\ngrin;jaw;0,5\nopen;brow;1\n",
        '\n"Value"\t"Shape"\t"Control"\r"0,5"\tgrin\tjaw\r1\topen\tbrow\r',
        "shape,control,value\n grin , jaw ,0.5\nopen,brow\nnone,,\n",
    ],
)
def test_a_mapping_of_any_spreadsheet_is_read(tmp_path, text):
    (tmp_path / "m.csv").write_bytes(text.encode())
    assert read_mapping(tmp_path / "m.csv") == {"grin": {"jaw": 0.5}, "open": {"brow": 1.0}}


def test_match_shapes_rejects_unknown_names_and_mappings(tmp_path):
    with pytest.raises(MeshError, match="none of the shapes"):
        match_shapes(("Key 1", "Key 2"))
    with pytest.raises(MeshError, match="'grin', which the mesh does not have"):
        match_shapes(("jawOpen",), mapping={"grin": {"jawOpen": 1.0}})
    with pytest.raises(ControlError, match="'mouthBig', which is no board channel"):
        match_shapes(("jawOpen",), mapping={"jawOpen": {"mouthBig": 1.0}})
    (tmp_path / "m.csv").write_text("a,b\n1,2\n")
    with pytest.raises(FormatError, match="header shape,control,value"):
        read_mapping(tmp_path / "m.csv")


def test_closing_weight_is_measured_on_the_lips():
    """Two strips close together; the corrective at 1 lifts the lower one half as far again."""
    x = np.linspace(0, 5, 12)
    upper = np.stack([np.r_[x, x], np.r_[x * 0, x * 0 + 2.0], np.zeros(24)], axis=1)
    lower = upper * [1, -1, 1] - [0, 0.01, 0]
    faces = np.array([[i, i + 1, i + 12] for i in range(11)])
    mesh = TriMesh(np.vstack([upper, lower]), np.vstack([faces, faces + 24]))
    jaw, close = np.zeros((48, 3)), np.zeros((48, 3))
    jaw[24:, 1], close[24:, 1] = -2.0, 3.0
    shapes = ShapeSet(mesh, ("jawOpen", "mouthClose"), np.stack([jaw, close]))
    assert closing_weight(shapes, "jawOpen", "mouthClose") == pytest.approx(2 / 3)
    poses = match_shapes(shapes.names, shapes=shapes)
    assert poses.close_gain == pytest.approx(2 / 3)
