"""The Blender add-on: its reading without Blender, the whole of it in a headless one."""

import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import soundfile

import rig.formats
from rig import RigCurves, default_controls, read_curves, write_curves
from rig.conversion.arkit import arkit_controls
from rig.conversion.raw import board_to_raw
from rig.formats.exchange import write_exchange_files

ADDON = Path(rig.formats.__file__).with_name("blender_addon.py")
BOARD = default_controls()


@pytest.fixture
def addon(monkeypatch):
    """The add-on with a module in place of bpy, for the functions that need no Blender."""
    bpy, extras, helpers = (ModuleType(n) for n in ("bpy", "bpy_extras", "bpy_extras.io_utils"))
    bpy.types = type("Types", (), {"Operator": type("Operator", (), {})})
    make = staticmethod(lambda **_: str)
    names = ("StringProperty", "FloatProperty", "BoolProperty")
    bpy.props = type("Props", (), dict.fromkeys(names, make))
    helpers.ImportHelper = type("ImportHelper", (), {})
    for name, module in (("bpy", bpy), ("bpy_extras", extras), ("bpy_extras.io_utils", helpers)):
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("deitalk_blender", ADDON)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def take(tmp_path, rng):
    """A take folder of 40 frames at 30 fps, with files for both kinds of faces."""
    values = rng.uniform(BOARD.minimum, BOARD.maximum, (40, 185)).astype(np.float32)
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
    ],
)
def test_names_of_shape_keys_are_those_of_the_curves(addon, theirs, ours):
    assert addon.same_name(theirs) == addon.same_name(ours)


def test_no_two_curves_of_a_set_have_one_name(addon):
    from rig.conversion.raw import raw_controls

    for controls in (arkit_controls(), raw_controls()):
        assert len({addon.same_name(name) for name in controls.names}) == len(controls)


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
    with pytest.raises(ValueError, match=message) as error:
        addon.read(str(tmp_path / name))
    assert "\n" not in str(error.value)


INSIDE = """
import bpy, importlib.util, json, sys
import numpy
numpy.bool = bool  # the importer of Blender 3.4 needs it, numpy dropped it
addon_path, take, glb = sys.argv[sys.argv.index("--") + 1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
spec = importlib.util.spec_from_file_location("deitalk_blender", addon_path)
addon = importlib.util.module_from_spec(spec)
spec.loader.exec_module(addon)
addon.register()

def face(*names):
    for other in bpy.data.objects:
        other.select_set(False)
    data = bpy.data.meshes.new("face")
    data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    made = bpy.data.objects.new("face", data)
    bpy.context.scene.collection.objects.link(made)
    for name in ("Basis", *names):
        made.shape_key_add(name=name)
    made.select_set(True)
    bpy.context.view_layer.objects.active = made
    return made

def values(made, frame):
    bpy.context.scene.frame_set(frame)
    return {b.name: b.value for b in made.data.shape_keys.key_blocks[1:]}

scene = bpy.context.scene
scene.render.fps = 30
out = {}
arkit = face("jawOpen", "mouthSmile_L", "unknown")
out["arkit"] = list(bpy.ops.import_anim.deitalk(filepath=take + "/curves.json"))
out["arkit_values"] = [values(arkit, 1), values(arkit, 11)]
out["sounds"] = [s.sound.filepath.rsplit("/", 1)[-1] for s in scene.sequence_editor.sequences_all]
out["end"] = scene.frame_end
raw = face("head_lod0_mesh__mouth_corner_pull_L", "CTRL_expressions_jawOpen", 'jaw"Left')
scene.render.fps = 60
out["raw"] = list(bpy.ops.import_anim.deitalk(
    filepath=take + "/hi.unreal.json", start=0.0, with_sound=False))
out["raw_values"] = [values(raw, 0), values(raw, 20)]
curves = raw.data.shape_keys.animation_data.action.fcurves
out["kinds"] = sorted({p.interpolation for c in curves for p in c.keyframe_points})
shapes = face("mouthClose", "jawOpen")
scene.render.fps = 25
out["glb"] = list(bpy.ops.import_anim.deitalk(filepath=glb, start=0.0))
out["glb_values"] = [values(shapes, 0), values(shapes, 2)]
out["objects"] = len(bpy.data.objects)
face("smile")
try:
    bpy.ops.import_anim.deitalk(filepath=take + "/curves.json")
except RuntimeError as error:
    out["error"] = str(error).strip()
addon.unregister()
print("OUT", json.dumps(out))
"""


@pytest.mark.slow
def test_headless_blender_keys_shape_keys(take, tmp_path):
    if shutil.which("blender") is None:
        pytest.skip("needs blender")
    arkit = np.zeros((3, 61), np.float32)
    names = arkit_controls().names
    arkit[:, names.index("JawOpen")] = 0, 0.5, 1
    glb = tmp_path / "a.glb"
    write_curves(glb, RigCurves(arkit, names, 25, control_set="arkit-61"))
    (tmp_path / "inside.py").write_text(INSIDE)
    done = subprocess.run(
        ["blender", "--background", "--factory-startup", "--python-exit-code", "3", "--python",
         str(tmp_path / "inside.py"), "--", str(ADDON), str(take), str(glb)],
        capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    lines = [line for line in done.stdout.splitlines() if line.startswith("OUT ")]
    assert done.returncode == 0 and lines, done.stdout[-2000:] + done.stderr[-2000:]
    out = json.loads(lines[0][4:])
    assert out["arkit"] == out["raw"] == out["glb"] == ["FINISHED"]
    shapes = read_curves(next(take.glob("*_take_1_deitalk.csv")), control_set=None)
    raw = board_to_raw(read_curves(take / "curves.json"))
    for found, frame in zip(out["arkit_values"], (0, 10), strict=True):
        assert found["jawOpen"] == pytest.approx(shapes["JawOpen"][frame], abs=1e-4)
        assert found["mouthSmile_L"] == pytest.approx(shapes["MouthSmileLeft"][frame], abs=1e-4)
        assert found["unknown"] == 0
    for found, frame in zip(out["raw_values"], (0, 10), strict=True):  # 60 fps: two each
        expected = raw["CTRL_expressions_mouthCornerPullL"][frame]
        assert found["head_lod0_mesh__mouth_corner_pull_L"] == pytest.approx(expected, abs=1e-4)
        expected = raw["CTRL_expressions_jawLeft"][frame]
        assert found['jaw"Left'] == pytest.approx(expected, abs=1e-4)
    assert out["kinds"] == ["LINEAR"] and out["sounds"] == ["audio.wav"]
    assert out["end"] == 250  # the end of the scene, which the clip does not reach
    assert out["glb_values"] == [
        {"mouthClose": 0, "jawOpen": 0},
        {"mouthClose": 0, "jawOpen": pytest.approx(1)},
    ]
    assert out["objects"] == 3  # those of the GLB are gone
    assert "none of 1 shape keys has a name" in out["error"]
