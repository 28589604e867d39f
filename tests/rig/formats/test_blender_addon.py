"""The Blender add-on: its reading without Blender, the whole of it in a headless one."""

import ast
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import soundfile

from deitalk.pipeline.exchange_files import write_exchange_files
from rig import RigCurves, default_controls, read_curves, write_curves
from rig.conversion.arkit import arkit_controls
from rig.conversion.raw import board_to_raw
from rig.conversion.shape_fit import shape_key
from rig.formats.blender import addon_text
from tests.errors import one_line

SESSION = Path(__file__).with_name("inside_blender.py")
EDITING = Path(__file__).with_name("edit_inside_blender.py")
BOARD = default_controls()


@pytest.fixture
def addon(monkeypatch, tmp_path):
    """The add-on as it is written, with a module in place of bpy, for the functions that need no Blender."""
    bpy, extras, helpers = (ModuleType(n) for n in ("bpy", "bpy_extras", "bpy_extras.io_utils"))
    bpy.types = type("Types", (), {"Operator": type("Operator", (), {})})
    make = staticmethod(lambda **_: str)
    names = ("StringProperty", "FloatProperty", "BoolProperty")
    bpy.props = type("Props", (), dict.fromkeys(names, make))
    for name in ("ImportHelper", "ExportHelper"):
        setattr(helpers, name, type(name, (), {}))
    for name, module in (("bpy", bpy), ("bpy_extras", extras), ("bpy_extras.io_utils", helpers)):
        monkeypatch.setitem(sys.modules, name, module)
    (tmp_path / "deitalk_blender.py").write_text(addon_text())
    spec = importlib.util.spec_from_file_location(
        "deitalk_blender", tmp_path / "deitalk_blender.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def take(tmp_path, rng):
    """A take folder of 40 frames at 30 fps, with files for both kinds of faces."""
    values = rng.uniform(BOARD.minimum, BOARD.maximum, (40, 185)).astype(np.float32)
    values[:, BOARD.index("CTRL_C_jaw.ty")] = 0.5 - 0.5 * np.cos(np.arange(40) / 4)
    values[:, BOARD.index("CTRL_R_mouth_cornerPull.ty")] = 0.25
    curves = RigCurves(values, BOARD.names, 30)
    folder = tmp_path / "take"
    folder.mkdir()
    write_curves(folder / "curves.json", curves)
    write_exchange_files(folder, curves, slate="hi")
    (folder / "take.json").write_text("{}")
    soundfile.write(folder / "audio.wav", np.zeros(16000), 16000)
    return folder


def test_raw_curves_of_the_file_for_unreal_are_those_of_the_rig(addon, take):
    found = addon.read(str(take / "hi.unreal.json"))
    expected = board_to_raw(read_curves(take / "curves.json"))
    assert len(found.values) == 251
    for name, values in found.values.items():
        np.testing.assert_allclose(values, expected[name], atol=2e-6, err_msg=name)
    np.testing.assert_allclose(found.times, expected.times, atol=1e-6)


def test_a_head_that_no_shape_shows_is_said(addon, tmp_path):
    curves = RigCurves(np.tile(BOARD.rest, (2, 1)), BOARD.names, 30)
    for turn, told in ((0, []), (5, ["the head does not turn"])):
        head = np.full((2, 6), turn, np.float32)
        for name in ("a.json", "a.unreal.json"):
            write_curves(tmp_path / name, replace(curves, head=head))
            assert addon.unshown(addon.read(str(tmp_path / name)), []) == told, name


@pytest.mark.parametrize("fps", [24, 30, 60])
def test_live_link_times_and_values_are_read(addon, tmp_path, fps):
    values = np.linspace(0, 1, 70 * 61).reshape(70, 61).astype(np.float32)
    curves = RigCurves(values, arkit_controls().names, fps, control_set="arkit-61")
    write_curves(tmp_path / "a.csv", curves, format="livelink")
    found = addon.read(str(tmp_path / "a.csv"))
    np.testing.assert_allclose(found.times, np.arange(70) / fps, atol=2e-5)
    np.testing.assert_allclose(found.values["JawOpen"], curves["JawOpen"], atol=1e-6)


def test_thirtieths_of_the_app_are_read_at_30(addon, tmp_path):
    rows = [f"10:00:{i // 30:02}:{i % 30:02}.000,1,0" for i in range(60)]
    (tmp_path / "a.csv").write_text("\n".join(["Timecode,BlendShapeCount,JawOpen", *rows]))
    np.testing.assert_allclose(addon.read(str(tmp_path / "a.csv")).times, np.arange(60) / 30)


@pytest.mark.parametrize(
    ("theirs", "ours"),
    [
        ("eyeBlink_L", "EyeBlinkLeft"),
        ("eyeBlinkRight", "EyeBlinkRight"),
        ("jawLeft", "JawLeft"),
        ("CTRL_expressions_mouthCornerPullL", "CTRL_expressions_mouthCornerPullL"),
        ("mouthCornerPullL", "CTRL_expressions_mouthCornerPullL"),
        ("head_lod0_mesh__mouth_corner_pull_L", "CTRL_expressions_mouthCornerPullL"),
        ("blendShape1.jawOpen", "JawOpen"),
        ("rig:bs|eyeBlink_left", "EyeBlinkLeft"),
        ("Head|ctrl_expressions_jaw_open", "CTRL_expressions_jawOpen"),
    ],
)
def test_names_of_shape_keys_are_those_of_the_curves(addon, theirs, ours):
    assert addon.shape_key(theirs) == addon.shape_key(ours)
    assert addon.shape_key(theirs) == shape_key(theirs)  # as `deitalk retarget` reads it


def test_no_two_curves_of_a_set_have_one_name():
    from rig.conversion.raw import raw_controls

    for controls in (arkit_controls(), raw_controls()):
        assert len({shape_key(name) for name in controls.names}) == len(controls)


def test_addon_needs_no_package_of_ours():
    modules = {
        name
        for node in ast.walk(ast.parse(addon_text()))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in (
            [node.module] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names]
        )
    }
    ours = {"bpy", "bpy_extras.io_utils", "numpy"}
    assert {m for m in modules if m.partition(".")[0] not in sys.stdlib_module_names} == ours


def test_files_of_a_folder_are_those_of_a_file_of_it(addon, take):
    of_folder = addon.files_of_take(f"{take}/")
    of_file = addon.files_of_take(str(take / "curves.json"))
    assert of_file[0] == str(take / "curves.json") and sorted(of_file) == sorted(of_folder)
    assert addon.sound_of(f"{take}/") == str(take / "audio.wav")
    with pytest.raises(ValueError, match="is no take folder"):
        addon.files_of_take(str(take.parent))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.json", "{}", "has no curves of deitalk"),
        ("a.json", '{"schema": "deitalk.curves/1"}', "is damaged"),
        ("a.csv", "a,b\n1,2\n", "no CSV of Live Link Face"),
        ("a.csv", "", "is damaged"),
        ("a.json", "{", "Expecting"),
    ],
)
def test_other_files_are_an_error_of_one_line(addon, tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with one_line(ValueError, match=message):
        addon.read(str(tmp_path / name))


def blenders() -> list:
    """Blender of this machine, and Python interpreters with bpy that $BPY_PYTHONS names."""
    found = [path for path in os.environ.get("BPY_PYTHONS", "").split(os.pathsep) if path]
    if blender := shutil.which("blender"):
        found.append(pytest.param(blender, marks=pytest.mark.slow))
    missing = pytest.mark.skip(reason="needs Python interpreters with bpy in BPY_PYTHONS")
    return found or [pytest.param("", marks=missing)]


def run_inside(program: str, *arguments: Path, session: Path = SESSION) -> tuple[dict, str]:
    """What the session inside Blender found, and all that was printed."""
    command = [program]
    if Path(program).name == "blender":
        command += ["--background", "--factory-startup", "--python-exit-code", "3", "--python"]
    done = subprocess.run(
        [*command, str(session), *(["--"] if len(command) > 1 else []), *map(str, arguments)],
        capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    lines = [line for line in done.stdout.splitlines() if line.startswith("OUT ")]
    assert done.returncode == 0 and lines, done.stdout[-2000:] + done.stderr[-2000:]
    return json.loads(lines[-1][4:]), done.stdout + done.stderr


@pytest.mark.parametrize("program", blenders())
def test_blender_moves_the_face(take, tmp_path, program):
    arkit = np.zeros((3, 61), np.float32)
    names = arkit_controls().names
    arkit[:, names.index("JawOpen")] = 0, 0.5, 1
    glb = tmp_path / "a.glb"
    write_curves(glb, RigCurves(arkit, names, 25, control_set="arkit-61"))
    (tmp_path / "deitalk_blender.py").write_text(addon_text())
    shutil.copytree(take, tmp_path / "take2")
    out, printed = run_inside(program, tmp_path / "deitalk_blender.py", take, glb)
    assert {tuple(out[name]) for name in ("folder", "again", "raw", "glb", "driven")} == {
        ("FINISHED",)
    }
    shapes = read_curves(next(take.glob("*_take_1_deitalk.csv")), control_set=None)
    raw = board_to_raw(read_curves(take / "curves.json"))

    def near(value):
        return pytest.approx(value, abs=1e-4)

    for found, frame in zip([*out["at_24"], out["after"]], (0, 10, 10), strict=True):
        jaw, smile = shapes["JawOpen"][frame], shapes["MouthSmileLeft"][frame]
        assert found["blendShape1.jawOpen"] == near(jaw) and found["mouthSmile_L"] == near(smile)
        assert found["unknown"] == 0 and found["moved"] == near(jaw + smile)
    assert out["rate"] == 24 and out["end"] == 250  # of the scene, which the clip does not reach
    assert out["sounds"] == ([["audio.wav", 1]] if out["has_sound"] else [])
    assert out["sounds_after"] == out["sounds"] and out["actions"] == 1
    for found, frame in zip(out["raw_values"], (0, 10), strict=True):  # 60 fps: two each
        expected = raw["CTRL_expressions_mouthCornerPullL"][frame]
        assert found["head_lod0_mesh__mouth_corner_pull_L"] == near(expected)
        assert found['nose"WrinkleL'] == near(raw["CTRL_expressions_noseWrinkleL"][frame])
    assert out["kinds"] == ["LINEAR"]
    for found, jaw in zip(out["glb_values"], (0, 1), strict=True):
        assert found == {"mouthClose": 0, "jawOpen": near(jaw), "moved": near(jaw)}
    assert out["objects"] == 3  # those of the GLB are gone
    assert out["few"] == ["FINISHED"]
    counts = out["few_keys_True"]
    assert counts["jawOpen"] < 25 and counts["mouthSmileLeft"] < 25 and counts["Mouth_Smile_R"] == 1
    assert set(out["few_keys_False"]) == {"jawOpen", "mouthSmileLeft"}
    for name, arkit_name in (("jawOpen", "JawOpen"), ("mouthSmileLeft", "MouthSmileLeft")):
        found = np.array([row[name] for row in out["few_values"]])
        assert np.abs(found - shapes[arkit_name]).max() <= 0.0101, name
    assert out["driven_values"]["jawOpen"] == near(0.25)
    assert out["board"] == ["FINISHED"] == out["batch"]
    board = read_curves(take / "curves.json")
    still = sum(bool(np.ptp(board[name]) < 1e-6) for name in board.names)
    told = f"4 channels of board from take, {185 - 4 - still} moving controls have no bone"
    assert told in printed
    for found, frame in zip(out["board_values"], (0, 7, 20), strict=True):
        names = ("CTRL_C_jaw.tx", "CTRL_C_jaw.ty", "CTRL_L_eye.tx", "CTRL_L_eye.ty")
        jaw_x, jaw_y, eye_x, eye_y = (board[name][frame] for name in names)
        assert found == near([jaw_x, jaw_y, 0, eye_x, eye_y, 0])
    assert out["strips"] == [["take", 1, 40], ["take2", 41, 80]]
    assert out["batch_values"] == near([shapes["JawOpen"][7]] * 2)
    assert "a driver moves jawOpen: no keys there" in printed
    moving = sum(bool(np.ptp(shapes[name]) > 1e-6) for name in shapes.names)
    assert f"{moving - 2} moving curves have no shape key: " in printed
    assert "none of 1 shape keys has a name" in out["errors"][0]
    assert "is no take folder" in out["errors"][1]


EDITS = {
    "board": [(name, 0.1 + 0.11 * k, 0.4 + 0.11 * k) for k, name in enumerate((
        "CTRL_C_jaw.ty", "CTRL_L_brow_raiseOut.ty", "CTRL_R_brow_down.ty", "CTRL_C_mouth.tx",
        "CTRL_L_mouth_cornerPull.ty", "CTRL_R_mouth_upperLipRaise.ty", "CTRL_L_eye_blink.ty",
        "CTRL_L_mouth_lipsTogetherU.ty", "CTRL_L_nose.ty", "CTRL_C_tongue_move.ty",
        "CTRL_R_nose.ty", "CTRL_R_eye_blink.ty", "CTRL_L_eye_squintInner.ty",
        "CTRL_R_mouth_dimple.ty", "CTRL_L_mouth_funnelU.ty", "CTRL_R_mouth_stretch.ty",
        "CTRL_L_mouth_cornerDepress.ty", "CTRL_R_mouth_lowerLipDepress.ty", "CTRL_C_jaw.tx",
        "CTRL_R_brow_raiseIn.ty",
    ))],
    "raw": [("CTRL_expressions_browRaiseOuterL", 0.2, 0.6), ("jawOpen", 1.0, 1.3),
            ("head_lod0_mesh__nose_wrinkle_L", 0.4, 0.7)],
}  # fmt: skip


@pytest.mark.parametrize("program", blenders())
@pytest.mark.parametrize(
    ("kind", "rate"), [("board", 30), ("board", 24), ("board", 60), ("raw", 25)]
)
def test_keys_edited_in_blender_come_back_as_a_layer(tmp_path, program, kind, rate):
    """Import of a take, an animator's edits at 20 places, export, diff, and the take again.

    Whatever the rate of the scene, the export has the frames of the take.
    """
    from deitalk import animate
    from deitalk.data.edited import changes_of_take

    sample = Path(__file__).parents[3] / "docs" / "samples" / "promise.flac"
    take = animate(sample, "happy").save(tmp_path / "take")
    (tmp_path / "deitalk_blender.py").write_text(addon_text())
    target, base = tmp_path / "edited.csv", read_curves(take / "curves.json")
    moves = {name: (start, end, 0.25) for name, start, end in EDITS[kind]}
    out, _ = run_inside(
        program, tmp_path / "deitalk_blender.py", take, target, rate, kind, json.dumps(moves),
        session=EDITING,
    )  # fmt: skip
    assert out["edited"] > 5 * len(moves) and "nothing that is selected" in out["refused"]
    found = changes_of_take(target, take)
    assert len(found.layer.text) <= 20_000 and found.share <= 0.01
    acted = animate(sample, "happy", edit=found.layer).curves
    changed = set(np.flatnonzero(np.abs(acted.values - base.values).max(axis=0) > 0.01))
    if kind == "raw":
        assert {"CTRL_L_brow_raiseOut.ty", "CTRL_C_jaw.ty", "CTRL_L_nose.ty"} == {
            BOARD.names[k] for k in changed
        }
        return
    values = base.values.copy()
    for name, (start, end, added) in moves.items():
        inside = (base.times >= start - 1e-3) & (base.times <= end + 1e-3)
        values[inside, BOARD.index(name)] += added
    wanted = np.clip(values, BOARD.minimum, BOARD.maximum)
    assert {BOARD.names[k] for k in changed} <= set(moves)
    assert np.abs(acted.values - wanted).max() < 0.01
