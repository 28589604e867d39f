"""The Unreal script against a strict imitation of the module `unreal`."""

import ast
import importlib.util
import itertools
import json
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rig import RigCurves, default_controls, read_curves, rest_curves, write_curves
from rig.conversion.raw import board_to_raw
from rig.face.head_pose import quaternions
from rig.validation.files import validate
from tests import fake_unreal
from tests.splines import hermite

SCRIPT = Path(__file__).resolve().parents[3] / "rig" / "unreal" / "deitalk_unreal.py"
SKELETON = "/Game/MetaHumans/Common/Face/Face_Archetype_Skeleton"
BOARD = default_controls()
SUBJECTS = [
    ("Speech_1_anna.csv", "Speech_1_anna"),
    ("My_Scene_1_anna.csv", "anna"),
    ("MySlate_164_iPhone_cal.csv", "MySlate_164_iPhone"),
    ("My_Slate_2_my_phone_raw.csv", "my_phone"),
    ("a_b_c_d.csv", "a_b_c_d"),
    ("1_2_3_4.csv", "3_4"),
    ("a_b_c_1.csv", "a_b_c_1"),
    ("speech_take_1_deitalk.csv", "deitalk"),
    ("curves.csv", "curves"),
]
"""Names of files and the Live Link subject that Unreal's importer makes of them."""


def run_inside(module, monkeypatch):
    """Import the script as Unreal would, with our stand-in as `unreal`."""
    if module is None:
        monkeypatch.setitem(sys.modules, "unreal", None)
    else:
        monkeypatch.setitem(sys.modules, "unreal", module)
    monkeypatch.syspath_prepend(str(SCRIPT.parent))
    spec = importlib.util.spec_from_file_location("deitalk_unreal", SCRIPT)
    script = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "deitalk_unreal", script)
    monkeypatch.delitem(sys.modules, "deitalk_head", raising=False)
    spec.loader.exec_module(script)
    return script


def controls_of_the_board(older=False):
    kinds = {"float": float, "Vector2D": fake_unreal.Vector2D}
    names = {c.ue_control: kinds[c.type] for c in BOARD.controls if c.role != "multiplier"}
    if older:
        for new, old in (
            ("CTRL_C_tongue_move", "CTRL_C_tongue"),
            ("CTRL_C_tongue_wideNarrow", "CTRL_C_tongue_narrowWide"),
            ("CTRL_C_tongue_tipMove", "CTRL_C_tongue_tip"),
        ):
            names[old] = names.pop(new)
        names["CTRL_C_tongue_roll"] = names.pop("CTRL_C_tongue_bendTwist")
        for name in ("CTRL_C_tongue_thickThin", "CTRL_L_mouth_thicknessInwardU"):
            del names[name]
    return names


def speech(n_frames=4, fps=30.0):
    values = np.tile(BOARD.rest, (n_frames, 1))
    values[:, BOARD.index("CTRL_C_jaw.ty")] = np.arange(n_frames) / n_frames
    values[:, BOARD.index("CTRL_L_brow_raiseIn.ty")] = 0.5 * (np.arange(n_frames) % 2)
    return RigCurves(values, BOARD.names, fps)


@pytest.fixture
def take(tmp_path):
    write_curves(tmp_path / "my take.unreal.json", speech())
    return str(tmp_path / "my take.unreal.json")


def test_anim_sequence_gets_every_raw_curve_in_one_bracket(take, monkeypatch):
    module = fake_unreal.make_unreal(skeletons=[SKELETON])
    sequence = run_inside(module, monkeypatch).anim_sequence(take)
    assert module.assets["/Game/deitalk/my_take"] is sequence and module.saved == [sequence]
    assert sequence.controller.n_brackets == 1 and sequence.controller.depth == 0
    assert sequence.controller.n_frames == 3 and sequence.controller.frame_rate.numerator == 30
    raw = [name for name in sequence.curves if name.startswith("CTRL_expressions_")]
    others = {name: values[1] for name, values in sequence.curves.items() if name not in raw}
    assert len(raw) == 251
    assert others == {"MHFDSVersion": [1.0, 1.0], "DisableFaceOverride": [1.0, 1.0]}
    times, values = sequence.curves["CTRL_expressions_jawOpen"]
    assert times == pytest.approx([0, 1 / 30, 2 / 30, 3 / 30])
    assert values == pytest.approx([0, 0.25, 0.5, 0.75])
    # a missing curve would mean 0, which is wrong for these two
    assert sequence.curves["CTRL_expressions_noseWrinkleUpperL"] == ([0.0, 0.1], [1.0, 1.0])


def test_script_has_the_raw_curves_of_the_board(tmp_path, monkeypatch, rng):
    board = default_controls()
    values = rng.uniform(board.minimum, board.maximum, (20, len(board))).astype(np.float32)
    curves = RigCurves(values, board.names, 30.0)
    path = tmp_path / "a.unreal.json"
    write_curves(path, curves)
    module = fake_unreal.make_unreal(skeletons=[SKELETON])
    found = run_inside(module, monkeypatch).anim_sequence(str(path)).curves
    expected = board_to_raw(curves)
    for name in expected.names:
        np.testing.assert_allclose(found[name][1], expected[name], atol=3e-6)  # knots up to 5 steep


def test_numbers_of_the_first_schema_are_read(tmp_path, monkeypatch):
    path = tmp_path / "old.unreal.json"
    data = {"schema": "deitalk.unreal/1", "frame_rate": [30, 1], "n_frames": 3, "board": {}}
    path.write_text(json.dumps(data | {"raw": {"CTRL_expressions_jawOpen": [0, 0.5, 1]}}))
    module = fake_unreal.make_unreal(skeletons=[SKELETON])
    found = run_inside(module, monkeypatch).anim_sequence(str(path)).curves
    assert found["CTRL_expressions_jawOpen"][1] == [0, 0.5, 1]
    jaw = read_curves(path)["CTRL_C_jaw.ty"]
    np.testing.assert_allclose(jaw, [0, 0.5, 1])


@pytest.mark.parametrize(
    "curve",
    [{"of": ["CTRL_C_jaw.z"], "knots": [[0, 0]]}, {"of": [], "knots": []}, {"of": ["a"]}, {}],
)
def test_script_rejects_damaged_raw_curves(tmp_path, monkeypatch, curve):
    path = tmp_path / "a.unreal.json"
    write_curves(path, speech(3))
    data = json.loads(path.read_text())
    data["raw"]["CTRL_expressions_jawOpen"] = curve
    path.write_text(json.dumps(data))
    script = run_inside(fake_unreal.make_unreal(skeletons=[SKELETON]), monkeypatch)
    with pytest.raises(script.DeitalkError, match="raw or board is damaged"):
        script.anim_sequence(str(path))
    assert not validate(path).ok


def head_of_rotator(roll, pitch, yaw):
    """Turn of a MetaHuman's head by a rotator in its bone's axes [shape=(3, 3)]: left, up, forward.

    By the rows of Unreal's FRotationMatrix; the bone lies as MetaHumanHeadTransform.cpp states it,
    by the quaternion (0, .7071, 0, -.7071), on a face that looks along y with its left along x.
    """
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(a), np.cos(a)) for a in np.radians([roll, pitch, yaw]))
    turn = np.array(
        [
            [cp * cy, cp * sy, sp],
            [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, -sr * cp],
            [-(cr * sp * cy + sr * sy), cy * sr - cr * sp * sy, cr * cp],
        ]
    ).T
    bone = Rotation.from_quat([0, 0.5**0.5, 0, -(0.5**0.5)]).as_matrix()
    return (bone @ turn @ bone.T)[np.ix_([0, 2, 1], [0, 2, 1])]


def test_head_track_becomes_curves_in_the_axes_of_the_bone(tmp_path, monkeypatch):
    path = tmp_path / "nod.unreal.json"
    track = np.zeros((5, 6), np.float32)
    track[1:] = [
        [10, 0, 0, 0, 0, 0], [0, -5, 0, 0, 0, 0], [0, 0, 2, 0, 0, 0], [30, -25, 20, 0.1, 0.2, 0.3],
    ]  # fmt: skip
    write_curves(path, replace(speech(5), head=track))
    np.testing.assert_allclose(read_curves(path).head, track, atol=1e-6)
    module = fake_unreal.make_unreal(skeletons=[SKELETON])
    curves = run_inside(module, monkeypatch).anim_sequence(str(path)).curves
    found = {name: values for name, (_, values) in curves.items() if name.startswith("Head")}
    turns = np.array([found[name] for name in ("HeadRoll", "HeadPitch", "HeadYaw")]).T
    # to the right is minus roll, down is yaw, to the right shoulder is pitch
    np.testing.assert_allclose(turns[1:4], [[-10, 0, 0], [0, 0, 5], [0, 2, 0]], atol=1e-6)
    for turn, expected in zip(turns, Rotation.from_quat(quaternions(track)), strict=True):
        np.testing.assert_allclose(head_of_rotator(*turn), expected.as_matrix(), atol=1e-6)
    shifts = [found[f"HeadTranslation{axis}"][-1] for axis in "XYZ"]
    assert shifts == pytest.approx([-0.3, 0.1, 0.2]) and set(found["HeadControlSwitch"]) == {1}


def test_bracket_is_closed_when_a_curve_fails(take, monkeypatch):
    module = fake_unreal.make_unreal(skeletons=[SKELETON])
    script = run_inside(module, monkeypatch)

    closed = []
    close = fake_unreal.Controller.close_bracket

    def fail(*_):
        raise RuntimeError("no memory")

    def note(controller, *arguments):
        close(controller, *arguments)
        closed.append(controller.depth)

    monkeypatch.setattr(fake_unreal.Controller, "close_bracket", note)

    monkeypatch.setattr(fake_unreal.AnimationLibrary, "add_float_curve_keys", fail)
    with pytest.raises(RuntimeError, match="no memory"):
        script.anim_sequence(take)
    assert closed == [0]  # the bracket is closed, then the half-filled asset is removed
    assert "/Game/deitalk/my_take" not in module.assets


@pytest.mark.parametrize(
    "rate", [(24, 1), (25, 1), (24000, 1001), (15, 1), (50, 1), (60000, 1001), (120, 1)]
)
def test_rates_that_are_no_multiple_of_the_new_assets_30_are_set(tmp_path, monkeypatch, rate):
    write_curves(tmp_path / "a.unreal.json", speech(13, rate[0] / rate[1]))
    module = fake_unreal.make_unreal(skeletons=[SKELETON])
    sequence = run_inside(module, monkeypatch).anim_sequence(str(tmp_path / "a.unreal.json"))
    controller = sequence.controller
    assert (controller.frame_rate.numerator, controller.frame_rate.denominator) == rate
    assert controller.n_frames == 12 and controller.errors == []
    times, values = sequence.curves["CTRL_expressions_jawOpen"]
    assert times == pytest.approx([i * rate[1] / rate[0] for i in range(13)])
    assert values == pytest.approx([i / 13 for i in range(13)], abs=1e-6)


def test_odd_rate_of_a_phone_is_put_on_the_nearest_standard_rate_in_true_time(
    tmp_path, monkeypatch
):
    write_curves(tmp_path / "a.unreal.json", speech(600, 10000 / 167))
    module = fake_unreal.make_unreal(skeletons=[SKELETON])
    sequence = run_inside(module, monkeypatch).anim_sequence(str(tmp_path / "a.unreal.json"))
    rate = sequence.controller.frame_rate
    assert (rate.numerator, rate.denominator) == (60000, 1001)
    times, values = sequence.curves["CTRL_expressions_jawOpen"]
    # the ramp rises by 1/600 each 167/10000 s
    assert values == pytest.approx(np.array(times) * 10000 / 167 / 600, abs=1e-5)
    assert times[-1] == pytest.approx(599 * 0.0167, abs=1001 / 60000)


@pytest.mark.parametrize(
    "wanted", ["24", "24000/1001", "25", "30000/1001", "60", "10000/167", "23/7"]
)
@pytest.mark.parametrize("current", ["30", "24", "60000/1001"])
def test_every_step_of_the_rate_is_a_multiple_or_a_factor(monkeypatch, current, wanted):
    script = run_inside(None, monkeypatch)
    steps = [Fraction(current), *script.rate_steps(Fraction(current), Fraction(wanted))]
    assert steps[-1] == Fraction(wanted)
    for before, after in itertools.pairwise(steps):
        assert 1 in ((after / before).denominator, (before / after).denominator)


def test_rate_that_unreal_keeps_is_an_error(take, monkeypatch):
    module = fake_unreal.make_unreal(skeletons=[SKELETON])
    script = run_inside(module, monkeypatch)
    monkeypatch.setattr(script, "rate_steps", lambda current, wanted: [Fraction(24)])
    with pytest.raises(script.DeitalkError, match="keeps 30 fps and refuses 24"):
        write_curves(take, speech(4, 24.0))
        script.anim_sequence(take)


@pytest.mark.parametrize("unit", ["MovieSceneTimeUnit", "SequenceTimeUnit"])
def test_board_is_keyed_on_the_channels_of_its_section(take, monkeypatch, unit):
    rig = fake_unreal.ControlRig("Face_ControlBoard_CtrlRig", controls_of_the_board())
    other = fake_unreal.ControlRig("MetaHuman_ControlRig", {})
    sequence = fake_unreal.LevelSequence([other, rig])
    module = fake_unreal.make_unreal(level_sequence=sequence, time_unit=unit)
    assert run_inside(module, monkeypatch).control_rig(take, start_frame=100) == []
    assert sum(bool(rig.keys(channel)[0]) for channel in rig.section.channels) == 148 + 2 * 14
    assert rig.keys("CTRL_C_jaw.X") == ([100], [0])
    frames, values = rig.keys("CTRL_C_jaw.Y")
    assert frames == [100, 101, 102, 103] and values == pytest.approx([0, 0.25, 0.5, 0.75])
    assert rig.keys("CTRL_L_brow_raiseIn") == ([100, 101, 102, 103], [0, 0.5, 0, 0.5])
    assert rig.keys("CTRL_L_nose_wrinkleUpper") == ([100], [1.0])
    n_keys = sum(len(rig.keys(channel)[0]) for channel in rig.section.channels)
    assert any(f"wrote {n_keys} keys of 162 controls" in text for text in module.messages)


def nod(tmp_path):
    track = np.zeros((3, 6), np.float32)
    track[:, 1] = [0, -6, -12]
    write_curves(tmp_path / "nod.unreal.json", replace(speech(3), head=track))
    return str(tmp_path / "nod.unreal.json")


def test_head_is_keyed_on_the_control_of_a_body_rig(tmp_path, monkeypatch):
    body = fake_unreal.ControlRig("MetaHuman_ControlRig", {"head_ctrl": fake_unreal.EulerTransform})
    module = fake_unreal.make_unreal(level_sequence=fake_unreal.LevelSequence([body]))
    run_inside(module, monkeypatch)
    head = importlib.import_module("deitalk_head")
    head.head_control(nod(tmp_path), start_frame=10, axes="x,y,-z")
    assert body.keys("head_ctrl.Rotation.Z") == ([10, 11, 12], pytest.approx([0, -6, -12]))
    for axis in "XY":
        assert set(body.keys(f"head_ctrl.Rotation.{axis}")[1]) == {0}
    assert body.keys("head_ctrl.Location.X") == ([], [])
    with pytest.raises(head.importer.DeitalkError, match="no channel skull"):
        head.head_control(nod(tmp_path), control="skull")


def test_head_control_rejects_axes_and_takes_without_a_head(take, tmp_path, monkeypatch, capsys):
    run_inside(None, monkeypatch)
    head = importlib.import_module("deitalk_head")
    assert head.head_control(nod(tmp_path), dry_run=True) == []
    assert "head_ctrl rotation z: HeadYaw, 3 keys, 0 to 12" in capsys.readouterr().out
    with pytest.raises(head.importer.DeitalkError, match="no head track"):
        head.head_control(take, dry_run=True)
    for axes in ("x,y", "x,x,y", "x,y,w"):
        with pytest.raises(head.importer.DeitalkError, match="three of x, y and z"):
            head.head_control(nod(tmp_path), axes=axes, dry_run=True)


def test_keys_are_left_out_only_where_the_straight_line_holds(monkeypatch):
    script = run_inside(None, monkeypatch)
    values = [0.0, 0.0, 0.0, 0.5, 0.5, 0.25, 0.0, 0.0, 0.0]
    frames = script.key_frames(values)
    assert frames == [0, 2, 3, 4, 5, 6, 8]
    assert np.interp(range(9), frames, [values[i] for i in frames]) == pytest.approx(values)
    assert script.key_frames([1.0]) == [0] and script.key_frames([1.0, 1.0]) == [0, 1]


def hills(rng, n_frames=300):
    """A curve as speech moves one: hills of a fifth of a second, from 0 to a held 1."""
    rows = np.convolve(rng.uniform(0, 1, n_frames + 6), [0.1, 0.25, 0.3, 0.25, 0.1], "same")[3:-3]
    return np.minimum((rows - rows.min()) / (np.quantile(rows, 0.97) - rows.min()), 1).tolist()


@pytest.mark.parametrize("tolerance", [0.002, 0.01, 0.1])
def test_curves_between_few_keys_stay_within_the_tolerance(monkeypatch, rng, tolerance):
    script = run_inside(None, monkeypatch)
    curve = hills(rng)
    frames, arrive, leave = zip(*script.curve_keys(curve, tolerance), strict=True)
    found = hermite(frames, [curve[i] for i in frames], arrive, leave, range(300))
    assert np.abs(found - curve).max() <= tolerance + 1e-9
    assert list(frames) == sorted(set(frames)) and frames[0] == 0 and frames[-1] == 299
    top = [i for i, value in enumerate(curve) if value == 1]
    assert len(top) > 3 and (found[top] == 1).all()  # what is held at the top is exact


def test_a_cubic_is_two_keys_and_its_own_slopes(monkeypatch):
    """x(1 - x)(2 - x) on 0 to 1 has the slopes 2 and -1."""
    script = run_inside(None, monkeypatch)
    x = np.arange(21) / 20
    keys = script.curve_keys((x * (1 - x) * (2 - x)).tolist(), 1e-3)
    top = int(np.argmax(x * (1 - x) * (2 - x)))
    assert [key[0] for key in keys] == [0, top, 20]
    assert keys[0][2] * 20 == pytest.approx(2, abs=0.01)
    assert keys[-1][1] * 20 == pytest.approx(-1, abs=0.01)
    assert script.curve_keys([0.5, 0.505, 0.5], 0.01) == [[0, 0, 0]]
    assert script.curve_keys([1.0], 0.01) == [[0, 0, 0]]


def test_board_is_keyed_with_few_cubic_keys_on_wish(tmp_path, monkeypatch, rng):
    """As its channels evaluate them, slopes per tick; controls that are still get one key, or none."""
    values = np.tile(BOARD.rest, (300, 1))
    values[:, BOARD.index("CTRL_C_jaw.ty")] = hills(rng)
    write_curves(tmp_path / "a.unreal.json", RigCurves(values.astype(np.float32), BOARD.names, 30))
    for still, others in ((True, 1), (False, 0)):
        rig = fake_unreal.ControlRig("Face_ControlBoard_CtrlRig", controls_of_the_board())
        module = fake_unreal.make_unreal(level_sequence=fake_unreal.LevelSequence([rig], (60, 1)))
        given = {"tolerance": 0.01, "still": still}
        run_inside(module, monkeypatch).control_rig(str(tmp_path / "a.unreal.json"), **given)
        channel = rig.section.channels["CTRL_C_jaw.Y"]
        rows = [(400 * k.frame, k.value, k.arrive, k.leave) for k in channel.keys]
        found = hermite(*zip(*rows, strict=True), 400 * np.arange(0, 600, 2))
        assert np.abs(found - values[:, BOARD.index("CTRL_C_jaw.ty")]).max() <= 0.0101
        assert len(rows) < 150
        assert len(rig.section.channels["CTRL_L_brow_raiseIn"].keys) == others


def test_sequence_that_is_not_open_is_opened_first(take, monkeypatch):
    rig = fake_unreal.ControlRig("Face_ControlBoard_CtrlRig", controls_of_the_board())
    sequence = fake_unreal.LevelSequence([rig])
    module = fake_unreal.make_unreal()
    module.assets["/Game/LS_talk"] = sequence
    script = run_inside(module, monkeypatch)
    script.control_rig(take, "/Game/LS_talk")
    assert module.opened is sequence and rig.keys("CTRL_C_jaw.Y")[0] == [0, 1, 2, 3]
    module.assets["/Game/Mesh"] = object()
    with pytest.raises(script.DeitalkError, match="give its asset path"):
        script.control_rig(take, "/Game/Mesh")


def test_second_run_replaces_the_keys_of_the_clip_and_keeps_others(take, monkeypatch):
    rig = fake_unreal.ControlRig("Face_ControlBoard_CtrlRig", controls_of_the_board())
    sequence = fake_unreal.LevelSequence([rig])
    script = run_inside(fake_unreal.make_unreal(level_sequence=sequence), monkeypatch)
    script.control_rig(take, start_frame=10)
    script.control_rig(take, start_frame=12)
    frames, values = rig.keys("CTRL_C_jaw.Y")
    assert frames == [10, 11, 12, 13, 14, 15]
    assert values == pytest.approx([0, 0.25, 0, 0.25, 0.5, 0.75])


def test_keys_that_are_not_kept_are_an_error(take, monkeypatch):
    rig = fake_unreal.ControlRig("Face_ControlBoard_CtrlRig", controls_of_the_board())
    sequence = fake_unreal.LevelSequence([rig])
    script = run_inside(fake_unreal.make_unreal(level_sequence=sequence), monkeypatch)
    monkeypatch.setattr(fake_unreal.Channel, "add_key", lambda *_: None)
    with pytest.raises(script.DeitalkError, match="does not hold the key just written"):
        script.control_rig(take)
    rig.section.channels.clear()
    with pytest.raises(script.DeitalkError, match="has none of the channels"):
        script.control_rig(take)
    assert fake_unreal.ScopedEditorTransaction.n_open == 0


def test_keys_are_put_into_the_rate_of_the_sequence(take, monkeypatch):
    rig = fake_unreal.ControlRig("Face_ControlBoard_CtrlRig", controls_of_the_board())
    sequence = fake_unreal.LevelSequence([rig], rate=(60, 1))
    run_inside(fake_unreal.make_unreal(level_sequence=sequence), monkeypatch).control_rig(take)
    frames, values = rig.keys("CTRL_C_jaw.Y")
    assert frames == [0, 1, 2, 3, 4, 5, 6]
    assert values == pytest.approx([0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75])


def test_older_board_gets_its_own_names_without_newer_controls(take, monkeypatch):
    rig = fake_unreal.ControlRig("Face_ControlBoard_CtrlRig", controls_of_the_board(older=True))
    sequence = fake_unreal.LevelSequence([rig])
    module = fake_unreal.make_unreal(level_sequence=sequence)
    skipped = run_inside(module, monkeypatch).control_rig(take)
    assert "CTRL_C_tongue_thickThin" in skipped and "CTRL_C_tongue_move" not in skipped
    assert rig.keys("CTRL_C_tongue.X")[0] == [0]
    assert "CTRL_C_tongue_roll" in skipped  # the newer roll; the older one is bendTwist
    assert rig.keys("CTRL_C_tongue_roll.Y")[0] == [0]
    assert any("left out" in message for message in module.messages)


def test_live_link_take_is_imported(tmp_path, monkeypatch):
    path = tmp_path / "Slate_take_1_anna.csv"
    write_curves(path, rest_curves(2), format="livelink")
    module = fake_unreal.make_unreal()
    script = run_inside(module, monkeypatch)
    assert script.live_link_csv(str(path)) == ["/Game/deitalk/imported"]
    assert module.imported[0].subject == "anna"
    assert any("Live Link subject 'anna'" in text for text in module.messages)
    text = path.read_text()
    path.write_text(text.replace(",", ", "))
    with pytest.raises(script.DeitalkError, match=r"Unreal refuses .*; run: deitalk validate"):
        script.live_link_csv(str(path))
    path.write_text(text)
    module.assets["/Game/deitalk/Slate_take_1_anna"] = object()
    with pytest.raises(script.DeitalkError, match="exists; rename"):
        script.live_link_csv(str(path))
    del module.LiveLinkFaceImporterFactory
    del module.assets["/Game/deitalk/Slate_take_1_anna"]
    with pytest.raises(script.DeitalkError, match="enable the plugin"):
        script.live_link_csv(str(path))


def test_script_rejects_what_the_user_can_correct(take, tmp_path, monkeypatch):
    script = run_inside(fake_unreal.make_unreal(), monkeypatch)
    with pytest.raises(script.DeitalkError, match="no skeleton at"):
        script.anim_sequence(take)
    with pytest.raises(script.DeitalkError, match="open a Level Sequence"):
        script.control_rig(take)
    with pytest.raises(script.DeitalkError, match="cannot read"):
        script.anim_sequence(str(tmp_path / "absent.json"))
    (tmp_path / "x.json").write_text("{}")
    with pytest.raises(script.DeitalkError, match=r"not of schema deitalk\.unreal/2"):
        script.anim_sequence(str(tmp_path / "x.json"))
    empty = fake_unreal.LevelSequence([fake_unreal.ControlRig("Body", {})])
    script = run_inside(fake_unreal.make_unreal(level_sequence=empty), monkeypatch)
    with pytest.raises(script.DeitalkError, match="it has: Body"):
        script.control_rig(take)


def test_existing_asset_is_not_overwritten(take, monkeypatch):
    module = fake_unreal.make_unreal(skeletons=[SKELETON, "/Game/deitalk/my_take"])
    script = run_inside(module, monkeypatch)
    with pytest.raises(script.DeitalkError, match="exists; give another name"):
        script.anim_sequence(take)


@pytest.mark.parametrize("route", ["anim", "rig"])
def test_dry_run_works_outside_unreal_and_prints_its_steps(take, monkeypatch, capsys, route):
    script = run_inside(None, monkeypatch)
    script.main([route, take, "--dry-run"])
    out = capsys.readouterr().out
    assert ("CTRL_expressions_jawOpen: 4 keys, 0 to 0.75" in out) == (route == "anim")
    assert ("CTRL_C_jaw (Vector2D): x constant 0, y 4 keys, 0 to 0.75" in out) == (route == "rig")
    with pytest.raises(SystemExit, match="runs inside the Unreal editor"):
        script.main([route, take])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["anim", "absent.json"], "cannot read absent.json"),
        (["anim"], "required: path"),
        (["walk", "x"], "invalid choice"),
        (["rig", "TAKE", "--start-frame", "x"], "invalid int value"),
        (["rig", "TAKE"], "open a Level Sequence"),
        (["livelink", "absent.csv"], "absent.csv does not exist"),
    ],
)
def test_mistake_on_the_command_line_is_one_line_of_the_log(take, monkeypatch, arguments, message):
    module = fake_unreal.make_unreal()
    script = run_inside(module, monkeypatch)
    script.main([take if argument == "TAKE" else argument for argument in arguments])
    assert message in module.messages[-1] and "\n" not in module.messages[-1]
    assert module.messages[-1].startswith("deitalk: ")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"raw": {"CTRL_expressions_jawOpen": [0, 1]}}, "a curve has 2 values, not 4"),
        ({"raw": {"CTRL_expressions_jawOpen": [0, 1, 2, None]}}, "raw or board is damaged"),
        ({"raw": {"CTRL_expressions_jawOpen": float("nan")}}, "a curve has NaN"),
        ({"raw": []}, "raw or board is damaged"),
        ({"head": {"yaw": 1}}, "raw or board is damaged"),
        ({"head": {n: [0, 1] for n in ("yaw", "pitch", "roll", "x", "y", "z")}}, "has 2 values"),
        ({"board": {"CTRL_C_jaw": 1}}, "raw or board is damaged"),
        ({"frame_rate": [30]}, "must be two whole numbers"),
        ({"frame_rate": [0, 1]}, "must be two whole numbers"),
        ({"n_frames": "4"}, "must be 1 or more"),
    ],
)
def test_script_rejects_damaged_files(take, tmp_path, monkeypatch, change, message):
    bad = tmp_path / "bad.unreal.json"
    bad.write_text(json.dumps(json.loads(Path(take).read_text()) | change))
    script = run_inside(None, monkeypatch)
    with pytest.raises(script.DeitalkError, match=message):
        script.anim_sequence(str(bad), dry_run=True)


def test_script_depends_on_unreal_alone_and_parses_in_its_oldest_python():
    modules = set()
    files = [path for path in SCRIPT.parent.glob("*.py") if path.name != "__init__.py"]
    trees = [ast.parse(path.read_text(), feature_version=(3, 9)) for path in files]
    for node in (node for tree in trees for node in ast.walk(tree)):
        if isinstance(node, ast.Import):
            modules |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            modules.add(node.module.split(".")[0])
    ours = {path.stem for path in files}
    assert modules <= set(sys.stdlib_module_names) | {"unreal"} | ours
