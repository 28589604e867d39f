"""The Unreal script against a strict imitation of the module `unreal`."""

import ast
import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from rig import RigCurves, default_controls, rest_curves, write_curves
from tests import fake_unreal

SCRIPT = Path(__file__).resolve().parents[3] / "rig" / "unreal" / "deitalk_unreal.py"
SKELETON = "/Game/MetaHumans/Common/Face/Face_Archetype_Skeleton"
BOARD = default_controls()


def run_inside(module, monkeypatch):
    """Import the script as Unreal would, with our stand-in as `unreal`."""
    if module is None:
        monkeypatch.setitem(sys.modules, "unreal", None)
    else:
        monkeypatch.setitem(sys.modules, "unreal", module)
    spec = importlib.util.spec_from_file_location("deitalk_unreal", SCRIPT)
    script = importlib.util.module_from_spec(spec)
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
    assert sequence.controller.n_frames == 3 and sequence.controller.rate.numerator == 30
    assert len(sequence.curves) == 251
    times, values = sequence.curves["CTRL_expressions_jawOpen"]
    assert times == pytest.approx([0, 1 / 30, 2 / 30, 3 / 30])
    assert values == pytest.approx([0, 0.25, 0.5, 0.75])
    # a missing curve would mean 0, which is wrong for these two
    assert sequence.curves["CTRL_expressions_noseWrinkleUpperL"] == ([0.0, 0.1], [1.0, 1.0])


def test_bracket_is_closed_when_a_curve_fails(take, monkeypatch):
    module = fake_unreal.make_unreal(skeletons=[SKELETON])
    script = run_inside(module, monkeypatch)

    def fail(*_):
        raise RuntimeError("no memory")

    monkeypatch.setattr(fake_unreal.AnimationLibrary, "add_float_curve_keys", fail)
    with pytest.raises(RuntimeError, match="no memory"):
        script.anim_sequence(take)
    assert module.assets["/Game/deitalk/my_take"].controller.depth == 0


@pytest.mark.parametrize("unit", ["MovieSceneTimeUnit", "SequenceTimeUnit"])
def test_board_is_keyed_by_the_plural_setters(take, monkeypatch, unit):
    rig = fake_unreal.ControlRig("Face_ControlBoard_CtrlRig", controls_of_the_board())
    other = fake_unreal.ControlRig("MetaHuman_ControlRig", {})
    sequence = fake_unreal.LevelSequence([other, rig])
    module = fake_unreal.make_unreal(level_sequence=sequence, time_unit=unit)
    assert run_inside(module, monkeypatch).control_rig(take, start_frame=100) == []
    assert len(rig.keys) == 162
    frames, values = rig.keys["CTRL_C_jaw"]
    assert frames == [100, 101, 102, 103]
    assert [v.x for v in values] == [0, 0, 0, 0]
    assert [v.y for v in values] == pytest.approx([0, 0.25, 0.5, 0.75])
    assert rig.keys["CTRL_L_brow_raiseIn"] == ([100, 101, 102, 103], [0, 0.5, 0, 0.5])
    assert rig.keys["CTRL_L_nose_wrinkleUpper"] == ([100], [1.0])


def test_keys_are_put_into_the_rate_of_the_sequence(take, monkeypatch):
    rig = fake_unreal.ControlRig("Face_ControlBoard_CtrlRig", controls_of_the_board())
    sequence = fake_unreal.LevelSequence([rig], rate=(60, 1))
    run_inside(fake_unreal.make_unreal(level_sequence=sequence), monkeypatch).control_rig(take)
    frames, values = rig.keys["CTRL_C_jaw"]
    assert frames == [0, 1, 2, 3, 4, 5, 6]
    assert [v.y for v in values] == pytest.approx([0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75])


def test_older_board_gets_its_own_names_without_newer_controls(take, monkeypatch):
    rig = fake_unreal.ControlRig("Face_ControlBoard_CtrlRig", controls_of_the_board(older=True))
    sequence = fake_unreal.LevelSequence([rig])
    module = fake_unreal.make_unreal(level_sequence=sequence)
    skipped = run_inside(module, monkeypatch).control_rig(take)
    assert "CTRL_C_tongue_thickThin" in skipped and "CTRL_C_tongue_move" not in skipped
    assert "CTRL_C_tongue" in rig.keys
    assert "CTRL_C_tongue_roll" in skipped  # the newer roll; the older one is bendTwist
    assert type(rig.keys["CTRL_C_tongue_roll"][1][0]) is fake_unreal.Vector2D
    assert any("left out" in message for message in module.messages)


def test_live_link_take_is_imported(tmp_path, monkeypatch):
    path = tmp_path / "Slate_1_anna.csv"
    write_curves(path, rest_curves(2), format="livelink")
    module = fake_unreal.make_unreal()
    script = run_inside(module, monkeypatch)
    assert script.live_link_csv(str(path)) == ["/Game/deitalk/imported"]
    module.assets["/Game/deitalk/Slate_1_anna"] = object()
    with pytest.raises(script.DeitalkError, match="exists; rename"):
        script.live_link_csv(str(path))
    del module.LiveLinkFaceImporterFactory
    del module.assets["/Game/deitalk/Slate_1_anna"]
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
    with pytest.raises(script.DeitalkError, match=r"not of schema deitalk\.unreal/1"):
        script.anim_sequence(str(tmp_path / "x.json"))
    with pytest.raises(script.DeitalkError, match="<Slate>_<Take>_<Subject>"):
        script.live_link_csv(take)
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
    with pytest.raises(script.DeitalkError, match="runs inside the Unreal editor"):
        script.main([route, take])


def test_script_rejects_wrong_lengths(take, monkeypatch):
    data = json.loads(Path(take).read_text())
    data["raw"]["CTRL_expressions_jawOpen"] = [0, 1]
    Path(take).write_text(json.dumps(data))
    script = run_inside(None, monkeypatch)
    with pytest.raises(script.DeitalkError, match="a curve has 2 values, not 4"):
        script.anim_sequence(take, dry_run=True)


def test_script_depends_on_unreal_alone_and_parses_in_its_oldest_python():
    tree = ast.parse(SCRIPT.read_text(), feature_version=(3, 9))
    modules = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            modules.add(node.module)
    assert modules <= {"__future__", "argparse", "json", "os", "sys", "typing", "unreal"}
