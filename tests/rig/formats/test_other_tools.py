import json

import numpy as np
import pandas as pd
import pytest

from rig import RigCurves, default_controls, read_curves, rest_curves, write_curves
from rig.conversion.arkit import ARKIT_ID
from rig.conversion.convert import convert
from rig.conversion.raw import RAW_ID, board_to_raw
from rig.errors import FormatError
from rig.formats.emoface_txt import columns
from rig.validation.files import validate

BOARD = default_controls()
NVIDIA = [
    "EyeBlinkLeft", "EyeLookDownLeft", "EyeLookInLeft", "EyeLookOutLeft", "EyeLookUpLeft",
    "EyeSquintLeft", "EyeWideLeft", "EyeBlinkRight", "EyeLookDownRight", "EyeLookInRight",
    "EyeLookOutRight", "EyeLookUpRight", "EyeSquintRight", "EyeWideRight", "JawForward", "JawLeft",
    "JawRight", "JawOpen", "MouthClose", "MouthFunnel", "MouthPucker", "MouthLeft", "MouthRight",
    "MouthSmileLeft", "MouthSmileRight", "MouthFrownLeft", "MouthFrownRight", "MouthDimpleLeft",
    "MouthDimpleRight", "MouthStretchLeft", "MouthStretchRight", "MouthRollLower", "MouthRollUpper",
    "MouthShrugLower", "MouthShrugUpper", "MouthPressLeft", "MouthPressRight", "MouthLowerDownLeft",
    "MouthLowerDownRight", "MouthUpperUpLeft", "MouthUpperUpRight", "BrowDownLeft", "BrowDownRight",
    "BrowInnerUp", "BrowOuterUpLeft", "BrowOuterUpRight", "CheekPuff", "CheekSquintLeft",
    "CheekSquintRight", "NoseSneerLeft", "NoseSneerRight", "TongueOut",
]  # fmt: skip
"""Poses of Audio2Face-3D in the order of its answers, as its clients print them."""


@pytest.fixture
def curves(rng):
    values = rng.uniform(BOARD.minimum, BOARD.maximum, (5, 185)).astype(np.float32)
    return RigCurves(values, BOARD.names, 25)


def test_raw_csv_is_recognised_by_its_names(tmp_path, curves):
    write_curves(tmp_path / "c.raw.csv", curves)
    raw = read_curves(tmp_path / "c.raw.csv", control_set=None)
    assert raw.control_set == RAW_ID and raw.fps == 25
    assert raw.values == pytest.approx(board_to_raw(curves).values, abs=6e-7)
    (tmp_path / "c.raw.csv").rename(tmp_path / "other.csv")
    assert read_curves(tmp_path / "other.csv").control_set == BOARD.id


def test_audio2face_frames_are_a_pandas_table(tmp_path, curves):
    report = write_curves(tmp_path / "animation_frames.csv", curves)
    assert report.format == "a2f" and "lossy" in report.note
    table = pd.read_csv(tmp_path / "animation_frames.csv", index_col=0)
    assert table.index.tolist() == [0, 1, 2, 3, 4]
    assert table["timeCode"].tolist() == pytest.approx(np.arange(5) / 25)
    names = [name.removeprefix("blendShapes.") for name in table.columns[1:]]
    assert names == NVIDIA and all("blendShapes." in name for name in table.columns[1:])
    assert table["blendShapes.JawLeft"].tolist() == pytest.approx(
        convert(curves, ARKIT_ID)["JawLeft"], abs=6e-7
    )
    back = read_curves(tmp_path / "animation_frames.csv", control_set=None)
    assert back.values[:, :52] == pytest.approx(convert(curves, ARKIT_ID).values[:, :52], abs=6e-7)


def test_audio2face_tongue_shapes_and_camel_case_are_read(tmp_path):
    text = ",timeCode,blendShapes.jawOpen,blendShapes.TongueUp\n0,0.0,0.25,1\n1,0.5,0.5,1\n"
    (tmp_path / "frames.csv").write_text(text)
    back = read_curves(tmp_path / "frames.csv", control_set=None)
    assert back["JawOpen"].tolist() == [0.25, 0.5] and back.fps == 2


def test_emoface_columns_are_the_published_ones():
    names = columns()
    spelling = {c.name: c.emoface_name for c in BOARD.controls}
    assert len(names) == len(set(names)) == 174
    assert [spelling[n] for n in names[:5]] == [
        "CTRL_C_eye-translateX",
        "CTRL_C_eye-translateY",
        "CTRL_C_eye_parallelLook-translateY",
        "CTRL_C_jaw-translateX",
        "CTRL_C_jaw-translateY",
    ]
    # the published list has tongue_tip where the alphabet has tongue_roll
    assert [spelling[n].removeprefix("CTRL_C_tongue") for n in names[20:29]] == [
        "-translateX",
        "-translateY",
        "_inOut-translateY",
        "_narrowWide-translateY",
        "_press-translateY",
        "_roll-translateX",
        "_roll-translateY",
        "_tip-translateX",
        "_tip-translateY",
    ]
    assert spelling[names[29]] == "CTRL_L_brow_down-translateY"
    assert spelling[names[46]] == "CTRL_L_jaw_ChinRaiseD-translateY"
    assert spelling[names[-1]] == "CTRL_neck_throatUpDown-translateY"


def test_emoface_text_survives_writing_and_reading(tmp_path, curves):
    write_curves(tmp_path / "c.txt", curves)
    lines = (tmp_path / "c.txt").read_text().splitlines()
    assert [len(line.split(",")) for line in lines] == [174] * 5
    back = read_curves(tmp_path / "c.txt", fps=25)
    kept = [BOARD.index(name) for name in columns()]
    lost = sorted(set(range(185)) - set(kept))
    assert back.values[:, kept] == pytest.approx(curves.values[:, kept], abs=6e-7)
    assert (back.values[:, lost] == BOARD.rest[lost]).all()


def test_unreal_json_has_keys_for_both_routes(tmp_path):
    values = rest_curves(3, fps=29.97).values.copy()
    values[:, BOARD.index("CTRL_C_jaw.ty")] = [0, 0.5, 1]
    write_curves(tmp_path / "c.unreal.json", RigCurves(values, BOARD.names, 29.97))
    data = json.loads((tmp_path / "c.unreal.json").read_text())
    assert data["schema"] == "deitalk.unreal/2"
    assert data["frame_rate"] == [30000, 1001] and data["n_frames"] == 3
    assert len(data["raw"]) == 251 and len(data["board"]) == 162
    assert data["raw"]["CTRL_expressions_jawOpen"] == {
        "of": ["CTRL_C_jaw.y"],
        "knots": [[0, 0], [1, 1]],
    }
    assert data["board"]["CTRL_C_jaw"] == {"x": 0, "y": [0, 0.5, 1]}
    assert data["board"]["CTRL_L_brow_down"] == {"value": 0}
    assert "CTRL_neckCorrectivesMultiplyerU" not in data["board"]
    (tmp_path / "c.unreal.jsonx").write_text("{}")
    with pytest.raises(FormatError, match="no format has the suffix"):
        read_curves(tmp_path / "c.unreal.jsonx")


@pytest.mark.parametrize("suffix", [".csv", ".json", ".unreal.json", ".raw.csv"])
@pytest.mark.parametrize("digits", [2, 4])
def test_fewer_digits_are_read_again_within_half_of_the_last(tmp_path, rng, suffix, digits):
    curves = RigCurves(rng.uniform(0, 1, (300, len(BOARD))).astype(np.float32), BOARD.names, 30)
    write_curves(tmp_path / f"a{suffix}", curves)
    write_curves(tmp_path / f"b{suffix}", curves, digits=digits)
    whole, compact = (read_curves(tmp_path / f"{n}{suffix}", control_set=None) for n in "ab")
    assert np.abs(whole.values - compact.values).max() <= 0.5 * 10.0**-digits + 1e-6
    sizes = [(tmp_path / f"{name}{suffix}").stat().st_size for name in "ab"]
    assert sizes[1] < sizes[0] * (digits + 4) / 9
    assert validate(tmp_path / f"b{suffix}").ok


def test_rhubarb_files_name_the_sound_by_its_whole_path(tmp_path, curves):
    """Rhubarb writes the absolute path of its input to ``soundFile``."""
    sound = tmp_path / "Tom & <Anna>.wav"
    write_curves(tmp_path / "c.rhubarb.json", curves, sound=sound)
    data = json.loads((tmp_path / "c.rhubarb.json").read_text())
    assert data["metadata"]["soundFile"] == str(sound)
    write_curves(tmp_path / "none.rhubarb.json", curves)
    assert json.loads((tmp_path / "none.rhubarb.json").read_text())["metadata"]["soundFile"] == ""


@pytest.mark.parametrize(("fps", "seconds"), [(None, 8.72), (60, 8.71), (None, 8.73), (None, None)])
def test_rhubarb_files_end_with_the_sound(tmp_path, fps, seconds):
    """8.71 and 8.72 s are 262 frames, of 8.73 s; lips that shut in the last one only are a cue."""
    values = rest_curves(262).values.copy()
    values[:-1, BOARD.index("CTRL_C_jaw.ty")] = 0.55
    for name in BOARD.names:
        values[-1, BOARD.index(name)] = (
            1.0 if "lipsTogether" in name else BOARD.rest[BOARD.index(name)]
        )
    curves = RigCurves(values, BOARD.names, fps=30.0)
    for name in ("c.rhubarb.json", "c.tsv"):
        write_curves(tmp_path / name, curves, fps=fps, seconds=seconds)
    end = seconds or 8.73
    data = json.loads((tmp_path / "c.rhubarb.json").read_text())
    assert data["metadata"]["duration"] == end == data["mouthCues"][-1]["end"]
    assert all(0 <= cue["start"] < cue["end"] for cue in data["mouthCues"])
    assert (tmp_path / "c.tsv").read_text().splitlines()[-1] == f"{end:.2f}\tX"
