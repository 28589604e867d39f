"""`deitalk retarget` from curves to files, and our head against the ICT face."""

import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from deitalk.cli.retarget import retarget
from deitalk.research.meshes.frames import read_ply_sequence
from rig import RigCurves, default_controls, write_curves
from rig.errors import ExistsError, FormatError, MeshError
from rig.mesh.glb import read_container, write_container, write_glb
from rig.mesh.glb_reader import read_accessor
from rig.mesh.ply import write_ply
from rig.mesh.shapes import ShapeSet
from rig.mesh.trimesh import TriMesh
from rig.retarget.blendshapes import closing_weight
from rig.retarget.landmarks import check_landmarks
from rig.retarget.retarget_files import read_shapes, retarget_curves
from tests.meshes import write_obj, write_obj_folder, write_shapes_npz

MESH = TriMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]])
GRID = TriMesh(
    [[x, y, 0.01 * x * y] for x in range(12) for y in range(12)],
    [[12 * i + j, 12 * i + j + 12, 12 * i + j + 1] for i in range(11) for j in range(11)],
)
CONTROLS = default_controls()

ICT_LANDMARKS = {
    "eye_outer_right": 1507, "eye_inner_right": 1528, "eye_upper_right": 1537,
    "eye_lower_right": 1518, "eye_outer_left": 3721, "eye_inner_left": 3742,
    "eye_upper_left": 3751, "eye_lower_left": 3732, "brow_right": 1914, "brow_left": 4114,
    "nose_bridge": 978, "nose_tip": 4857, "nose_base": 1147, "nose_wing_right": 1140,
    "nose_wing_left": 3360, "mouth_corner_right": 5708, "mouth_corner_left": 6213,
    "upper_lip_top": 0, "lower_lip_bottom": 5518, "upper_rim": 5533, "lower_rim": 5517,
    "upper_rim_right": 5711, "upper_rim_left": 6216, "lower_rim_right": 5966,
    "lower_rim_left": 6470, "chin": 966,
}  # fmt: skip
"""Vertices of the ICT-FaceKit face, after the Multi-PIE points in its documentation."""


def ict(shared):
    file = np.load(shared / "data" / "meshes" / "ict_face.npz")
    return TriMesh(file["neutral"], file["triangles"]), ICT_LANDMARKS


def ict_shapes(shared):
    file = np.load(shared / "data" / "meshes" / "ict_face.npz")
    return tuple(str(n) for n in file["expression_names"]), file["expression_deltas"]


@pytest.fixture
def shapes():
    deltas = np.zeros((2, 4, 3))
    deltas[0, 0, 1], deltas[1, 3, 0] = -1.0, 0.5
    return ShapeSet(MESH, ("jawOpen", "mouthSmile_L"), deltas)


@pytest.fixture
def curves():
    values = np.tile(CONTROLS.rest, (3, 1))
    values[:, CONTROLS.index("CTRL_C_jaw.ty")] = [0, 0.5, 1]
    values[:, CONTROLS.index("CTRL_L_mouth_cornerPull.ty")] = [1, 0, 0]
    return RigCurves(values, CONTROLS.names)


def glb_weights(path):
    document, binary = read_container(path)
    sampler = document["animations"][0]["samplers"][0]
    count = len(document["meshes"][0]["weights"])
    return read_accessor(document, binary, sampler["output"]).reshape(-1, count)


EXPECTED = [[0, 1], [0.5, 0], [1, 0]]


@pytest.mark.parametrize("kind", ["glb", "folder", "npz"])
def test_own_shapes_are_driven_in_every_file_format(tmp_path, shapes, curves, kind):
    mesh = tmp_path / {"glb": "face.glb", "folder": "face", "npz": "face.npz"}[kind]
    {"glb": write_glb, "folder": write_obj_folder, "npz": write_shapes_npz}[kind](mesh, shapes)
    report = retarget_curves(curves, mesh, tmp_path / "out.glb")
    assert (report.way, report.shapes, report.frames, report.lost) == ("blendshapes", 2, 3, 0.0)
    np.testing.assert_allclose(glb_weights(tmp_path / "out.glb"), EXPECTED, atol=1e-6)


def test_what_only_a_neutral_mesh_uses_is_named(tmp_path, shapes, curves):
    write_glb(tmp_path / "face.glb", shapes)
    report = retarget_curves(
        curves, tmp_path / "face.glb", tmp_path / "out.glb", landmarks="l.json", method="gradients"
    )
    assert "landmarks, method not used: the shapes of the mesh are driven" in report.notes


def test_vertices_are_written_as_npz_or_ply(tmp_path, shapes, curves):
    write_glb(tmp_path / "face.glb", shapes)
    retarget_curves(curves, tmp_path / "face.glb", tmp_path / "out.npz")
    with np.load(tmp_path / "out.npz") as file:
        vertices = file["vertices"]
    retarget_curves(curves, tmp_path / "face.glb", tmp_path / "frames")
    _, frames = read_ply_sequence(tmp_path / "frames")
    np.testing.assert_allclose(frames, vertices, atol=1e-6)
    np.testing.assert_allclose(vertices[1, 0], [0, -0.5, 0], atol=1e-6)
    np.testing.assert_allclose(vertices[0, 3], [1.5, 1, 0], atol=1e-6)


def test_compressed_glb_is_driven_by_name(tmp_path, shapes, curves):
    write_glb(tmp_path / "a.glb", shapes)
    document, binary = read_container(tmp_path / "a.glb")
    document["extensionsRequired"] = ["EXT_meshopt_compression"]
    write_container(tmp_path / "a.glb", document, binary)
    retarget_curves(curves, tmp_path / "a.glb", tmp_path / "out.glb")
    np.testing.assert_allclose(glb_weights(tmp_path / "out.glb"), EXPECTED, atol=1e-6)
    with pytest.raises(FormatError, match="meshopt compression"):
        retarget_curves(curves, tmp_path / "a.glb", tmp_path / "out.npz")


@pytest.mark.parametrize("suffix", [".glb", ".npz"])
def test_curves_of_a_rig_of_the_user_drive_the_shapes_of_their_names(tmp_path, suffix):
    """In any case of letters; other shapes stay, and a control without a shape is named."""
    square = TriMesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    deltas = np.zeros((3, 3, 3), np.float32)
    deltas[0, :, 1], deltas[1, :, 2], deltas[2, :, 0] = 1, 2, 5
    mesh = ShapeSet(square, ("Jaw_Open", "other", "wide"), deltas)
    write_glb(tmp_path / "face.glb", mesh)
    values = np.array([[0.5, 0.1, 0.3], [1, 0.2, 0]], np.float32)
    own = RigCurves(values, ("wide", "jaw_open", "blink"), fps=30, control_set="mine@1")
    report = retarget_curves(own, tmp_path / "face.glb", tmp_path / f"out{suffix}")
    assert (report.shapes, report.way, report.lost) == (2, "blendshapes", None)
    assert report.notes == ("no shape for 1 controls that move (blink)",)
    expected = [[0.1, 0, 0.5], [0.2, 0, 1]]
    if suffix == ".glb":
        np.testing.assert_allclose(glb_weights(tmp_path / "out.glb"), expected)
    else:
        moved = np.load(tmp_path / "out.npz")["vertices"] - square.vertices
        np.testing.assert_allclose(moved[:, 0], [[2.5, 0.1, 0], [5, 0.2, 0]], atol=1e-6)
    if suffix == ".glb":
        long = RigCurves(np.repeat(values, 20, axis=0), own.names, fps=30, control_set="mine@1")
        retarget_curves(long, tmp_path / "face.glb", tmp_path / "few.glb", keys=0.01)
        document, _ = read_container(tmp_path / "few.glb")
        keys = document["animations"][0]["samplers"][0]["input"]
        assert document["accessors"][keys]["count"] < 10
    named = RigCurves(values, ("a", "b", "c"), fps=30, control_set="mine@1")
    with pytest.raises(FormatError, match=r"none of its 3 shapes has the name of a control of"):
        retarget_curves(named, tmp_path / "face.glb", tmp_path / f"no{suffix}")


def test_unknown_shapes_and_missing_curves_are_reported(tmp_path, curves):
    shapes = ShapeSet(MESH, ("jawOpen", "Key 7"), np.ones((2, 4, 3)))
    write_glb(tmp_path / "a.glb", shapes)
    report = retarget_curves(curves, tmp_path / "a.glb", tmp_path / "out.glb")
    assert report.lost > 0.5
    assert "Key 7" in report.notes[0] and "mouthCornerPullL" in report.notes[1]


@pytest.mark.parametrize("mesh", [MESH, GRID])
def test_retarget_rejects_meshes_that_are_no_face(tmp_path, curves, mesh):
    write_obj(tmp_path / "a.obj", mesh)
    with pytest.raises(MeshError, match="give `landmarks`"):
        retarget_curves(curves, tmp_path / "a.obj", tmp_path / "out.glb")


@pytest.mark.parametrize("name", ["a.obj", "a.ply", "a.glb"])
def test_meshes_without_shapes_are_read_as_empty_sets(tmp_path, shapes, name):
    if name == "a.glb":
        write_glb(tmp_path / name, ShapeSet(MESH, (), np.zeros((0, 4, 3))))
    else:
        (write_obj if name == "a.obj" else write_ply)(tmp_path / name, MESH)
    read = read_shapes(tmp_path / name)
    assert read.names == ()
    np.testing.assert_array_equal(read.neutral.faces, MESH.faces)


def run(*arguments):
    app = typer.Typer()
    app.command()(retarget)
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_command_reads_a_take_folder(tmp_path, shapes, curves):
    (tmp_path / "take").mkdir()
    write_curves(tmp_path / "take" / "curves.csv", curves)
    write_glb(tmp_path / "face.glb", shapes)
    result = run(tmp_path / "take", "--mesh", tmp_path / "face.glb", "-o", tmp_path / "out.glb")
    assert result.exit_code == 0, result.output
    assert "3 frames, 2 own shapes" in result.stderr.replace("\n", " ")
    np.testing.assert_allclose(glb_weights(tmp_path / "out.glb"), EXPECTED, atol=1e-4)
    again = run(tmp_path / "take", "--mesh", tmp_path / "face.glb", "-o", tmp_path / "out.glb")
    assert isinstance(again.exception, ExistsError)
    options = ("--mesh", tmp_path / "face.glb", "-o", tmp_path / "out.glb", "--force", "--json")
    summary = json.loads(run(tmp_path / "take", *options).stdout)
    assert summary["way"] == "blendshapes" and summary["frames"] == 3


def test_command_rejects_invalid_arguments(tmp_path, shapes):
    write_glb(tmp_path / "face.glb", shapes)
    common = ("--mesh", tmp_path / "face.glb", "-o", tmp_path / "out.glb")
    missing = run(tmp_path / "none.csv", *common)
    assert "does not exist" in str(missing.exception)
    (tmp_path / "empty").mkdir()
    assert "has no curves" in str(run(tmp_path / "empty", *common).exception)
    odd = run(tmp_path / "none.csv", *common, "--method", "magic")
    assert "'magic' is unknown" in str(odd.exception)


@pytest.mark.slow
def test_our_head_on_the_ict_face(shared, tmp_path, curves):
    """A neutral ICT face with landmarks: right motion, and lips that seal where ours do."""
    from rig.retarget.head_source import source_head
    from rig.retarget.methods import shapes_for

    mesh, landmarks = ict(shared)
    rig, made = shapes_for(mesh, landmarks)
    assert made.warnings == () and made.registration.residual < 0.002
    source = source_head()
    together = {f"CTRL_{s}_mouth_lipsTogether{r}.ty": 1.0 for s in "LR" for r in "UD"}
    poses = [
        {},
        {"CTRL_C_jaw.ty": 0.5},
        {"CTRL_C_jaw.ty": 0.3} | together,
        {"CTRL_C_jaw.ty": 1} | together,
    ]
    values = np.tile(CONTROLS.rest, (len(poses), 1))
    for row, pose in zip(values, poses, strict=True):
        for name, value in pose.items():
            row[CONTROLS.index(name)] = value
    ours = source.rig.shapes.evaluate(source.rig.weights_of(values))
    theirs = rig.shapes.evaluate(rig.weights_of(values))
    width = made.target_pairs.width
    opening = made.target_pairs.gaps(theirs[1]).max() / width
    ours_opening = made.source_pairs.gaps(ours[1]).max() / made.source_pairs.width
    assert opening == pytest.approx(ours_opening, rel=0.25) and opening > 0.2
    gaps = np.median(np.abs(made.target_pairs.gaps(theirs)), axis=1) / width
    assert gaps[2] < gaps[0] + 0.01 and gaps[3] < gaps[0] + 0.01  # 0.5 mm of a 5 cm mouth
    # Our eye opens 11 mm and theirs 9: the blink closes theirs and does not run past.
    blink = rig.shapes.delta("CTRL_L_eye_blink.ty")
    upper, lower = landmarks["eye_upper_left"], landmarks["eye_lower_left"]
    opening = mesh.vertices[upper] - mesh.vertices[lower]
    left = (opening + blink[upper] - blink[lower]) @ opening / (opening @ opening)
    assert abs(left) < 0.1
    write_obj(tmp_path / "ict.obj", mesh)
    (tmp_path / "marks.json").write_text(json.dumps(landmarks))
    report = retarget_curves(
        curves, tmp_path / "ict.obj", tmp_path / "out.glb", landmarks=tmp_path / "marks.json"
    )
    assert report.way == "neutral" and report.shapes > 150
    assert glb_weights(tmp_path / "out.glb").max() == pytest.approx(1.0)


@pytest.mark.slow
def test_landmarks_of_the_ict_face_are_found(shared):
    """In metres and with z up, as Blender may write it; within 4 mm on average, 1 cm at worst."""
    from rig.retarget.found_landmarks import guess_landmarks
    from rig.retarget.head_source import source_head

    mesh, landmarks = ict(shared)
    source = source_head()
    axes = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    turned = TriMesh(0.01 * mesh.vertices @ axes.T, mesh.faces)
    guess = guess_landmarks(turned, source.mesh, source.landmarks)
    check_landmarks(guess, len(mesh.vertices))
    assert len(guess) >= 20
    apart = [
        np.linalg.norm(mesh.vertices[v] - mesh.vertices[landmarks[name]])
        for name, v in guess.items()
    ]
    assert np.mean(apart) < 0.4 and np.max(apart) < 1.0
    assert closing_weight(
        ShapeSet(mesh, *ict_shapes(shared)), "jawOpen", "mouthClose"
    ) == pytest.approx(0.81, abs=0.03)


@pytest.mark.slow
def test_ict_shapes_on_our_head(shared):
    """The reverse: every ICT shape moves our head where it moves the ICT face."""
    from rig.retarget.head_source import source_head
    from rig.retarget.methods import carry_shapes

    mesh, landmarks = ict(shared)
    theirs = ShapeSet(mesh, *ict_shapes(shared), landmarks)
    head = source_head()
    carried = carry_shapes(theirs, head.mesh, head.landmarks)
    for name, mark, axis, sign in (
        ("jawOpen", "chin", 1, -1),
        ("mouthSmile_L", "mouth_corner_left", 1, 1),
        ("mouthFrown_R", "mouth_corner_right", 1, -1),
        ("browInnerUp_L", "brow_left", 1, 1),
        ("eyeBlink_L", "eye_upper_left", 1, -1),
        ("jawLeft", "chin", 0, 1),
    ):
        before = theirs.delta(name)[landmarks[mark]]
        after = carried.shapes.delta(name)[head.landmarks[mark]]
        assert after[axis] * sign > 0.05, name
        assert np.linalg.norm(after - before) < 0.5 * np.linalg.norm(before) + 0.1, name
