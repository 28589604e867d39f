"""The export script against the strict imitation of `unreal`: what is written can be imported."""

import importlib.util
import json
import sys
from dataclasses import replace

import numpy as np
import pytest
import soundfile

from deitalk.data.captures.imported import import_captures
from deitalk.data.clips import read_clips, read_known
from rig import read_curves, write_curves
from rig.conversion.raw import board_to_raw
from rig.errors import FormatError
from rig.formats.unreal_json import read_present
from tests import fake_unreal
from tests.rig.unreal.test_unreal import BOARD, SCRIPT, controls_of_the_board, run_inside, speech
from tests.takes import bursts

SKELETON = "/Game/MetaHumans/Common/Face/Face_Archetype_Skeleton"
EXPORT = SCRIPT.with_name("deitalk_export.py")
SOUND = fake_unreal.SoundWave("anna_1", r"C:\audio\anna 1.wav")


def scripts(module, monkeypatch):
    """The importer and the export script as inside Unreal."""
    importer = run_inside(module, monkeypatch)
    monkeypatch.setitem(sys.modules, "deitalk_unreal", importer)
    spec = importlib.util.spec_from_file_location("deitalk_export", EXPORT)
    export = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(export)
    return importer, export


def test_head_track_comes_back_from_an_anim_sequence(tmp_path, monkeypatch, rng):
    curves = replace(speech(40), head=rng.uniform(-20, 20, (40, 6)).astype(np.float32))
    write_curves(tmp_path / "take.unreal.json", curves)
    module = fake_unreal.make_unreal(skeletons=[SKELETON])
    importer, export = scripts(module, monkeypatch)
    sequence = importer.anim_sequence(str(tmp_path / "take.unreal.json"))
    export.anim_sequence("/Game/deitalk/take", str(tmp_path / "out"))
    found, _ = read_present(tmp_path / "out" / "take.unreal.json")
    np.testing.assert_allclose(found.head, curves.head, atol=2e-6)
    assert set(found.names) == set(board_to_raw(curves).names)  # no constant is a raw curve
    sequence.curves["HeadControlSwitch"] = ([0.0], [0.0])
    export.anim_sequence("/Game/deitalk/take", str(tmp_path / "off"))
    assert read_present(tmp_path / "off" / "take.unreal.json")[0].head is None


@pytest.mark.parametrize("fps", [30.0, 60.0, 24000 / 1001])
def test_raw_curves_come_back_from_an_anim_sequence(tmp_path, monkeypatch, fps):
    curves = speech(40, fps)
    write_curves(tmp_path / "take.unreal.json", curves)
    module = fake_unreal.make_unreal(skeletons=[SKELETON])
    importer, export = scripts(module, monkeypatch)
    importer.anim_sequence(str(tmp_path / "take.unreal.json"))
    path = export.anim_sequence("/Game/deitalk/take", str(tmp_path / "out"), audio="a.wav")
    found, audio = read_present(tmp_path / "out" / "take.unreal.json")
    assert path.endswith("take.unreal.json") and audio == "a.wav"
    assert (len(found), found.fps) == (40, pytest.approx(fps)) and len(found.names) == 251
    np.testing.assert_allclose(found.values, board_to_raw(curves).values, atol=2e-6)


def test_thinned_and_differently_spelt_curves_are_put_on_every_frame(tmp_path, monkeypatch):
    module = fake_unreal.make_unreal()
    _, export = scripts(module, monkeypatch)
    sequence = fake_unreal.AnimSequence()
    sequence.controller.frame_rate, sequence.controller.n_frames = fake_unreal.FrameRate(30, 1), 9
    every = [i / 30 for i in range(10)]
    sequence.curves = {
        "ctrl_expressions_jawopen": ([0.0, 3 / 30, 9 / 30], [0.0, 0.6, 0.0]),
        "CTRL_expressions_eyeBlinkL": (every, [i / 9 for i in range(10)]),
        "HeadYaw": (every, every),
    }
    module.assets["/Game/c/AS_1"] = sequence
    export.anim_sequence("/Game/c/AS_1", str(tmp_path))
    found, _ = read_present(tmp_path / "AS_1.unreal.json")
    assert set(found.names) == {"CTRL_expressions_jawOpen", "CTRL_expressions_eyeBlinkL"}
    expected = np.interp(np.arange(10), [0, 3, 9], [0, 0.6, 0])
    np.testing.assert_allclose(found["CTRL_expressions_jawOpen"], expected, atol=1e-6)


@pytest.mark.parametrize("older", [False, True])
def test_board_comes_back_from_the_start_of_the_sound(tmp_path, monkeypatch, older):
    rig = fake_unreal.ControlRig("Face_ControlBoard_CtrlRig", controls_of_the_board(older))
    rig.controls["CTRL_faceGUI"] = object  # a transform
    audio = [fake_unreal.MovieSceneAudioTrack([fake_unreal.MovieSceneAudioSection(SOUND, 5)])]
    opened = fake_unreal.LevelSequence([rig], audio=audio, playback=(0, 45))
    module = fake_unreal.make_unreal(level_sequence=opened)
    importer, export = scripts(module, monkeypatch)
    curves = speech(40)
    write_curves(tmp_path / "take.unreal.json", curves)
    importer.control_rig(str(tmp_path / "take.unreal.json"), start_frame=5)
    export.level_sequence(str(tmp_path / "out"))
    found, sound = read_present(tmp_path / "out" / "LS_take.unreal.json")
    assert sound == "anna 1.wav" and (len(found), found.fps) == (40, 30)
    for name in ("CTRL_C_jaw.ty", "CTRL_L_brow_raiseIn.ty"):
        np.testing.assert_allclose(found[name], curves[name], atol=1e-5)
    whole = read_curves(tmp_path / "out" / "LS_take.unreal.json")
    assert whole.names == BOARD.names
    missing = set(BOARD.names) - set(found.names)
    assert ("CTRL_C_tongue_thickThin.ty" in missing) == older


def test_sequence_without_sound_starts_with_playback(tmp_path, monkeypatch):
    rig = fake_unreal.ControlRig("Face_ControlBoard_CtrlRig", controls_of_the_board())
    opened = fake_unreal.LevelSequence([rig], playback=(3, 10))
    _, export = scripts(fake_unreal.make_unreal(level_sequence=opened), monkeypatch)
    export.level_sequence(str(tmp_path))
    found, sound = read_present(tmp_path / "LS_take.unreal.json")
    assert (len(found), sound) == (7, "")


def test_folder_of_performances_becomes_a_dataset(tmp_path, monkeypatch):
    module = fake_unreal.make_unreal(skeletons=[SKELETON])
    importer, export = scripts(module, monkeypatch)
    for name in ("happy_1", "sad_1"):
        write_curves(tmp_path / f"{name}.unreal.json", speech(180))
        importer.anim_sequence(str(tmp_path / f"{name}.unreal.json"))
    written = export.anim_folder("/Game/deitalk", str(tmp_path / "out"))
    assert len(written) == 2
    for name in ("happy_1", "sad_1"):
        soundfile.write(tmp_path / "out" / f"{name}.wav", bursts(6), 16000)
    result = import_captures([tmp_path / "out"], tmp_path / "data", actor="anna")
    assert {(t.kind, t.emotion) for t in result.takes} == {("unreal", "happy"), ("unreal", "sad")}
    assert read_known(read_clips(tmp_path / "data")[0].known, BOARD).sum() == 174


def test_faults_are_one_line(tmp_path, monkeypatch):
    module = fake_unreal.make_unreal()
    importer, export = scripts(module, monkeypatch)
    with pytest.raises(importer.DeitalkError, match="no asset at /Game/x"):
        export.anim_sequence("/Game/x", str(tmp_path))
    module.assets["/Game/x"] = fake_unreal.AnimSequence()
    with pytest.raises(importer.DeitalkError, match="no CTRL_expressions curves"):
        export.anim_sequence("/Game/x", str(tmp_path))
    with pytest.raises(importer.DeitalkError, match="no AnimSequence with face curves"):
        export.anim_folder("/Game", str(tmp_path))
    _, outside = scripts(None, monkeypatch)
    with pytest.raises(RuntimeError, match="inside the Unreal editor"):
        outside.anim_folder("/Game", str(tmp_path))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"schema": "x"}, "is not of schema"),
        ({"raw": {}, "board": {}}, "holds no curves"),
        ({"n_frames": 0}, "n_frames is 0"),
        ({"frame_rate": [30]}, "frame_rate is"),
        ({"board": {}, "raw": {"CTRL_expressions_jawOpen": [0, 1]}}, "has 2 values, not 4"),
        ({"board": {}, "raw": {"CTRL_expressions_jawOpen": "x"}}, "no list of numbers"),
        ({"board": {"CTRL_x": {"value": 0}}}, "no control of the face board"),
        ({"board": {"CTRL_C_jaw": {"x": 0}}}, "has no channel 'y'"),
    ],
)
def test_faults_of_the_file_are_one_line(tmp_path, change, expected):
    path = tmp_path / "a.unreal.json"
    write_curves(path, speech(4))
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(FormatError, match=expected):
        read_present(path)
