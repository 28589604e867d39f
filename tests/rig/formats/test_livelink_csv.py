from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rig import RigCurves, read_curves, rest_curves, write_curves
from rig.conversion.arkit import (
    ARKIT_ID,
    GAZE_DOWN_DEGREES,
    GAZE_SIDE_DEGREES,
    GAZE_UP_DEGREES,
    HEAD,
    arkit_controls,
)
from rig.conversion.raw import RAW_ID, board_to_raw
from rig.curves.timecode import read_timecodes
from rig.errors import FormatError
from rig.face.head_pose import quaternions
from rig.formats.livelink_csv import (
    SUBJECT_REST,
    LiveLinkTake,
    frame_ticks,
    read_take,
    take_name,
    timecode_text,
    write_take,
)
from rig.unreal.deitalk_clip import subject_of
from rig.validation.files import validate
from tests import unreal_live_link
from tests.rig.unreal.test_unreal import SUBJECTS, head_of_rotator

ALEX = "data/curves/livelink/alex_rom_3.csv"
HEADER = ",".join(["Timecode", "BlendShapeCount", *arkit_controls().names])


def codes(n_frames, fps):
    return [bytes(row).decode() for row in timecode_text(frame_ticks(n_frames, fps))]


@pytest.mark.parametrize(
    ("fps", "frame", "timecode"),
    [
        (30, 1, "00:00:00:02.000"),
        (30, 29, "00:00:00:58.000"),
        (30, 30, "00:00:01:00.000"),
        (60, 1, "00:00:00:01.000"),
        (60, 61, "00:00:01:01.000"),
        (24, 1, "00:00:00:02.500"),
        (24, 25, "00:00:01:02.500"),
        (29.97, 1, "00:00:00:02.002"),
        (29.97, 30, "00:00:01:00.060"),
        (25, 1, "00:00:00:02.400"),
        (50, 3, "00:00:00:03.600"),
    ],
)
def test_timecodes_of_hand_worked_times(fps, frame, timecode):
    rate = 30000 / 1001 if fps == 29.97 else fps
    assert codes(frame + 1, rate)[frame] == timecode


@given(st.integers(0, 24 * 3600 * 60000 - 1))
def test_every_timecode_reads_as_written(ticks):
    text = bytes(timecode_text(np.array([ticks]))[0]).decode()
    # The second one shows that sixtieths are counted.
    assert read_timecodes([text, "23:59:59:59.000"], "x").ticks[0] == ticks


def test_real_take_is_written_back_to_the_same_bytes(shared, tmp_path):
    write_take(tmp_path / "back.csv", read_take(shared / ALEX))
    theirs = (shared / ALEX).read_text().split("\n")
    ours = (tmp_path / "back.csv").read_text().split("\n")
    assert ours == [line.rstrip("\r") for line in theirs]


def test_real_take_is_put_on_an_even_grid(shared):
    take = read_take(shared / ALEX)
    assert take.fps == 30
    curves = take.to_curves()
    seconds = (take.ticks - take.ticks[0]) / 60000
    assert curves.duration == pytest.approx(seconds[-1], abs=1 / 30 + 1e-6)
    jaw = take.names.index("JawOpen")
    assert curves["JawOpen"] == pytest.approx(
        np.interp(curves.times, seconds, take.values[:, jaw]), abs=1e-6
    )
    # four frames were dropped by the phone: the grid has them, the file does not
    assert len(take.ticks) == 4030 and len(curves) == 4032


def test_real_take_drives_the_board(shared, tmp_path):
    board = read_curves(shared / ALEX)
    assert board.control_set == "metahuman-185@mh4"
    take = read_take(shared / ALEX).to_curves()
    assert board["CTRL_C_jaw.ty"] == pytest.approx(take["JawOpen"].clip(0, 1), abs=1e-6)
    write_curves(tmp_path / "a_1_b.csv", board, format="livelink")
    again = read_curves(tmp_path / "a_1_b.csv", control_set=None)
    assert again["JawOpen"] == pytest.approx(take["JawOpen"].clip(0, 1), abs=1e-6)
    assert again["MouthPucker"] == pytest.approx(take["MouthPucker"].clip(0, 1), abs=1e-3)


def test_file_has_the_form_of_the_app(tmp_path):
    values = np.zeros((2, 61), np.float32)
    values[1, 17] = 0.25
    curves = RigCurves(values, arkit_controls().names, control_set=ARKIT_ID)
    write_curves(tmp_path / "a.livelink.csv", curves)
    lines = (tmp_path / "a.livelink.csv").read_text().split("\n")
    assert lines[0] == HEADER.replace("BlendShapeCount", "BlendshapeCount")
    assert lines[1] == "00:00:00:00.000,61" + ",0.0000000000" * 61
    assert lines[2].split(",")[:2] == ["00:00:00:02.000", "61"]
    assert lines[2].split(",")[19] == "0.2500000000"
    # held until FF exceeds 30, else Unreal reads 00:02 as a fifteenth of a second
    assert lines[-2].split(",")[0] == "00:00:00:32.000" and lines[-1] == "" and len(lines) == 19
    assert {line.split(",", 1)[1] for line in lines[3:-1]} == {lines[2].split(",", 1)[1]}


def test_raw_curves_survive_as_live_link_columns(tmp_path):
    curves = rest_curves(4)
    write_curves(tmp_path / "a.livelink-raw.csv", curves)
    back = read_curves(tmp_path / "a.livelink-raw.csv", control_set=None)
    assert back.control_set == RAW_ID
    assert back.values[:4] == pytest.approx(board_to_raw(curves).values)


def test_takes_that_cross_midnight_keep_rising(tmp_path):
    rows = [f"{code},61" + ",0" * 61 for code in ("23:59:59:58.000", "00:00:00:00.000")]
    (tmp_path / "a.csv").write_text("\n".join([HEADER, *rows]))
    assert np.diff(read_take(tmp_path / "a.csv").ticks).tolist() == [2000]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("00:00:00:120.000,61" + ",0" * 61, "FF at 119"),
        ("00:00:00,61" + ",0" * 61, "must be HH:MM:SS:FF.mmm"),
        ("24:00:00:00.000,61" + ",0" * 61, "has time code"),
        ("00:00:00:00.000,61" + ",0" * 60, "'RightEyeRoll' is empty"),
        ("00:00:00:00.000,61" + ",0" * 60 + ",", "'RightEyeRoll' is empty"),
        ("00:00:00:00.000,61" + ",0" * 62, "more cells"),
        ("00:00:00:00.000,61" + ",nan" + ",0" * 60, "'EyeBlinkLeft' is empty or NaN"),
        (("00:00:00:00.000,61" + ",0" * 61 + "\n") * 2, "not after the one before"),
    ],
)
def test_read_curves_rejects_broken_takes(tmp_path, row, message):
    (tmp_path / "a.csv").write_text(HEADER + "\n" + row + "\n")
    with pytest.raises(FormatError, match=message):
        read_curves(tmp_path / "a.csv")


@pytest.mark.parametrize(("name", "subject"), SUBJECTS)
def test_subject_is_what_the_importer_takes_from_the_name(tmp_path, name, subject):
    assert subject_of(name) == subject
    if name != "a_b_c_1.csv":  # nothing is left of it there
        assert unreal_live_link.subject(name.removesuffix(".csv")) == subject


@pytest.mark.parametrize(
    ("slate", "subject"), [("My_Slate", "my_phone"), ("speech", "7"), ("2", "anna")]
)
def test_names_of_takes_give_their_subject_in_unreal(slate, subject):
    name = take_name(slate, 3, subject)
    assert name == f"{slate}_take_3_{subject}.csv"
    assert unreal_live_link.subject(name.removesuffix(".csv")) == subject


@pytest.mark.parametrize("n_frames", [1, 2, 16, 17, 31, 32, 100])
@pytest.mark.parametrize("fps", [2, 24, 30000 / 1001, 60, 10000 / 167])
def test_files_of_any_length_play_at_the_right_speed_in_unreal(tmp_path, fps, n_frames):
    values = np.zeros((n_frames, 61), np.float32)
    values[:, 17] = np.linspace(0.1, 0.5, n_frames)
    curves = RigCurves(values, arkit_controls().names, fps, control_set=ARKIT_ID)
    report = write_curves(tmp_path / "a_take_1_me.csv", curves, format="livelink")
    there = unreal_live_link.import_csv(tmp_path / "a_take_1_me.csv")
    assert there.times[:n_frames] == pytest.approx(np.arange(n_frames) / fps, abs=2e-5)
    assert there.columns["JawOpen"][:n_frames] == pytest.approx(values[:, 17])
    n_held = len(there.times) - n_frames
    assert set(there.columns["JawOpen"][n_frames:]) <= {there.columns["JawOpen"][n_frames - 1]}
    assert ("last frame is held" in report.note) == (n_held > 0)
    assert n_held == 0 or (n_frames - 1) / fps <= 0.5 or fps == 2
    if fps == 2:
        return
    back = read_curves(tmp_path / "a_take_1_me.csv", control_set=None)
    assert back["JawOpen"][:n_frames] == pytest.approx(values[:, 17], abs=1e-3)


def test_take_of_the_app_that_counts_frames_to_29_is_read_at_30(tmp_path):
    rows = [f"10:00:{i // 30:02}:{i % 30:02}.652,61" + f",{i / 251:.10f}" * 61 for i in range(251)]
    (tmp_path / "a.csv").write_text("\n".join([HEADER, *rows]))
    curves = read_curves(tmp_path / "a.csv", control_set=None)
    there = unreal_live_link.import_csv(tmp_path / "a.csv")
    assert there.rate == 30 and curves.fps == 30 and len(curves) == 251
    assert curves["JawOpen"][90] == pytest.approx(90 / 251, abs=1 / 251)
    take = read_take(tmp_path / "a.csv")
    assert (take.ticks - take.ticks[0]) / 60000 == pytest.approx(
        np.array(there.times) - there.times[0], abs=1e-5
    )


def test_take_rejects_hours_without_frames(tmp_path):
    """Three frames an hour apart are no take; a gap of 19 minutes is."""
    codes = ["00:00:00:00.000", "00:00:00:02.000", "00:19:00:00.000"]
    rows = [f"{code},61," + ",".join(["0"] * 61) for code in codes]
    header = "Timecode,BlendShapeCount," + ",".join(arkit_controls().names)
    path = tmp_path / "a_1_b.csv"
    path.write_text("\n".join([header, *rows]))
    assert len(read_take(path).to_curves(30)) == 19 * 60 * 30 + 1
    path.write_text("\n".join([header, *rows]).replace("00:19", "03:19"))
    with pytest.raises(FormatError, match="3 frames last 358201; at most 36030"):
        read_take(path).to_curves(30)


@pytest.mark.parametrize("stem", ["anna", "scene_take_2_anna"])
def test_name_with_the_apps_ending_keeps_the_subject_and_another_suffix_is_noted(tmp_path, stem):
    """Unreal leaves ``_cal`` out of the subject, and keeps what stands before ``.csv``."""
    report = write_curves(tmp_path / f"{stem}_cal.csv", rest_curves(40))
    assert report.format == "livelink" and "subject" not in report.note
    assert unreal_live_link.import_csv(report.path).subject == "anna"
    report = write_curves(tmp_path / f"{stem}.livelink.csv", rest_curves(40))
    there = unreal_live_link.import_csv(report.path).subject
    assert there == "anna.livelink"
    assert f"subject {there!r}" in report.note and f"{stem}_cal.csv for 'anna'" in report.note
    assert report.note.split("; ")[-1] in [f.text for f in validate(report.path).findings]


def test_raw_columns_are_those_of_a_metahuman_subject_in_its_order(tmp_path):
    """LiveLinkFaceSource.cpp: raw controls, switch, roll, pitch, yaw, X, Y, Z, version, override."""
    track = np.zeros((40, 6), np.float32)  # yaw pitch roll left up forward
    track[:10, 0], track[10:20, 1], track[20:30, 2] = 10, -5, 2
    track[30:] = [10, -5, 2, 0.1, 0.2, 0.3]
    curves = replace(rest_curves(40), head=track)
    write_curves(tmp_path / "a_cal.csv", curves, format="livelink-raw")
    there = unreal_live_link.import_csv(tmp_path / "a_cal.csv")
    names = list(there.columns)
    assert len(names) == 260 and all(name.startswith("CTRL_expressions_") for name in names[:251])
    assert names[251:] == [
        "HeadControlSwitch", "HeadRoll", "HeadPitch", "HeadYaw", "HeadTranslationX",
        "HeadTranslationY", "HeadTranslationZ", "MHFDSVersion", "DisableFaceOverride",
    ]  # fmt: skip
    # Bone: x up, y forward, z right. A turn to the right is minus roll, a nod down yaw, a tilt pitch.
    rows = [[there.columns[name][i] for name in names[252:255]] for i in (0, 10, 20)]
    np.testing.assert_allclose(rows, [[-10, 0, 0], [0, 0, 5], [0, 2, 0]], atol=1e-6)
    turned = Rotation.from_quat(quaternions(track[-1:])).as_matrix()[0]
    np.testing.assert_allclose(
        head_of_rotator(*(there.columns[name][-1] for name in names[252:255])), turned, atol=1e-6
    )
    last = [there.columns[name][-1] for name in ("HeadControlSwitch", *names[255:])]
    assert last == pytest.approx([1, -0.3, 0.1, 0.2, 1, 1])
    back = read_curves(tmp_path / "a_cal.csv", control_set=None)
    np.testing.assert_allclose(back.head, track, atol=1e-6)
    write_curves(tmp_path / "b.livelink-raw.csv", rest_curves(40))
    assert unreal_live_link.import_csv(tmp_path / "b.livelink-raw.csv").columns["HeadYaw"][0] == 0
    assert read_curves(tmp_path / "b.livelink-raw.csv", control_set=None).head is None


@pytest.mark.parametrize(
    "seconds, column", [((17.5, 20), "yaw"), ((0, 4.3), "pitch")]
)  # a shake, and nods
def test_eyes_of_a_real_take_turn_against_the_head(shared, tmp_path, seconds, column):
    """The vestibulo-ocular reflex: gaze against the turn of the head, about as fast."""
    table = pd.read_csv(shared / "data/curves/metahuman/arkittest_mha.csv")
    table["HeadControlSwitch"] = 1.0
    raw = [name for name in table.columns if name.startswith("CTRL_")]
    rest = [name for name in SUBJECT_REST if name in table.columns]
    ticks = frame_ticks(len(table), 60000 / 1001)
    write_take(
        tmp_path / "a_cal.csv",
        LiveLinkTake(ticks, table[[*raw, *rest]].to_numpy(), (*raw, *rest)),
    )
    curves = read_curves(tmp_path / "a_cal.csv", control_set=None).slice_seconds(*seconds)
    look = {
        way: curves[f"CTRL_expressions_eyeLook{way}L"] + curves[f"CTRL_expressions_eyeLook{way}R"]
        for way in ("Right", "Left", "Up", "Down")
    }
    gaze = {
        "yaw": GAZE_SIDE_DEGREES * (look["Right"] - look["Left"]) / 2,
        "pitch": (GAZE_UP_DEGREES * look["Up"] - GAZE_DOWN_DEGREES * look["Down"]) / 2,
    }[column]
    turn = curves.head[:, ("yaw", "pitch").index(column)]
    fast = turn[6:] - turn[:-6], gaze[6:] - gaze[:-6]  # a tenth of a second
    assert np.corrcoef(*fast)[0, 1] < -0.8 and -1.5 < np.polyfit(*fast, 1)[0] < -0.8


def test_eyes_of_real_takes_turn_as_we_write_them(shared):
    """Positive yaw is to the character's right, positive pitch down; no take has a head's turn."""
    paths = sorted((shared / "data/curves/livelink").glob("*.csv"))
    assert len(paths) == 7
    for path in paths:
        table = pd.read_csv(path).dropna()
        table.columns = [name[0].upper() + name[1:] for name in table.columns]
        for side, (right, left) in {"Left": ("In", "Out"), "Right": ("Out", "In")}.items():
            look = {way: table[f"EyeLook{way}{side}"] for way in (right, left, "Down", "Up")}
            yaw = np.degrees(np.polyfit(look[right] - look[left], table[f"{side}EyeYaw"], 1)[0])
            assert yaw == pytest.approx(GAZE_SIDE_DEGREES, rel=0.2)
            down = look["Down"] - look["Up"]
            assert np.corrcoef(down, table[f"{side}EyePitch"])[0, 1] > 0.98
        assert not table[list(HEAD)].to_numpy().any()
