import copy

import numpy as np
import pytest

from rig import Control, ControlSet, default_controls
from rig.errors import ControlError

CONTROLS = default_controls()


def test_board_has_185_unique_channels_of_171_controls():
    assert CONTROLS.id == "metahuman-185@mh4"
    assert len(set(CONTROLS.names)) == len(CONTROLS) == 185
    assert len({control.ue_control for control in CONTROLS.controls}) == 171


def test_two_channels_exist_exactly_where_unreal_has_a_vector():
    by_control: dict[str, list[Control]] = {}
    for control in CONTROLS.controls:
        by_control.setdefault(control.ue_control, []).append(control)
    for channels in by_control.values():
        axes = sorted(control.axis for control in channels)
        types = {control.type for control in channels}
        assert (types, axes) in (({"Vector2D"}, ["X", "Y"]), ({"float"}, ["Y"]))
    assert sum(len(channels) == 2 for channels in by_control.values()) == 14


@pytest.mark.parametrize(
    ("name", "size"),
    [("lip", 86), ("upper_face", 18), ("lip_no_sticky", 86), ("upper_face_gaze", 18), ("all", 185)],
)
def test_named_sets_have_the_sizes_of_the_paper(name, size):
    assert len(set(CONTROLS.subset(name).tolist())) == size


def test_regions_partition_the_board():
    parts = np.concatenate([CONTROLS.subset(region) for region in CONTROLS.regions])
    assert sorted(parts.tolist()) == list(range(185))
    assert len(CONTROLS.subset("mouth")) == 94


def test_sides_partition_the_board_and_agree_with_the_names():
    sides = {
        s: {CONTROLS.names[i] for i in CONTROLS.subset(s)} for s in ("left", "right", "center")
    }
    assert sum(map(len, sides.values())) == 185
    assert all(name.startswith("CTRL_L_") for name in sides["left"])
    assert {name.replace("CTRL_L_", "CTRL_R_") for name in sides["left"]} == sides["right"]


def test_every_range_holds_its_rest_and_wrinkle_upper_rests_at_one():
    assert (CONTROLS.minimum <= CONTROLS.rest).all() and (CONTROLS.rest <= CONTROLS.maximum).all()
    resting = {n: float(r) for n, r in zip(CONTROLS.names, CONTROLS.rest, strict=True) if r}
    assert resting == pytest.approx(
        {
            "CTRL_L_nose_wrinkleUpper.ty": 1.0,
            "CTRL_R_nose_wrinkleUpper.ty": 1.0,
            "CTRL_neckCorrectivesMultiplyerU.ty": 0.8,
            "CTRL_neckCorrectivesMultiplyerM.ty": 0.5,
            "CTRL_neckCorrectivesMultiplyerD.ty": 0.2,
        }
    )


def test_mirror_is_an_involution_with_equal_signs_and_ranges():
    mirrored = CONTROLS.mirror_index
    assert (mirrored[mirrored] == np.arange(185)).all()
    assert (CONTROLS.mirror_sign[mirrored] == CONTROLS.mirror_sign).all()
    turned = CONTROLS.mirror_sign == -1
    assert (CONTROLS.minimum[turned] == -CONTROLS.maximum[turned]).all()
    assert (CONTROLS.maximum[mirrored] == CONTROLS.maximum).all()


def test_mirror_negates_sideways_values_and_keeps_the_jaw_opening():
    sign = {name: CONTROLS[name].mirror_sign for name in CONTROLS.names}
    assert sign["CTRL_C_jaw.tx"] == sign["CTRL_L_eye.tx"] == sign["CTRL_C_mouth.tx"] == -1
    assert sign["CTRL_C_jaw.ty"] == sign["CTRL_L_mouth_corner.tx"] == 1


@pytest.mark.parametrize(
    ("spelling", "name"),
    [
        ("CTRL_C_jaw.Y", "CTRL_C_jaw.ty"),
        ("CTRL_C_jaw-translateX", "CTRL_C_jaw.tx"),
        ("CTRL_L_brow_down", "CTRL_L_brow_down.ty"),
        ("CTRL_C_tongue.tx", "CTRL_C_tongue_move.tx"),
        ("CTRL_C_tongue_narrowWide-translateY", "CTRL_C_tongue_wideNarrow.ty"),
        ("CTRL_C_tongue_tip.ty", "CTRL_C_tongue_tipMove.ty"),
        ("CTRL_C_tongue_roll.tx", "CTRL_C_tongue_bendTwist.tx"),
    ],
)
def test_other_spellings_resolve(spelling, name):
    assert CONTROLS.canonical(spelling) == name
    assert CONTROLS.names[CONTROLS.index(spelling)] == name


def test_tongue_roll_depends_on_the_board_of_the_header():
    newer = CONTROLS.resolve(["CTRL_C_tongue_roll.ty", "CTRL_C_jaw.ty"])
    older = CONTROLS.resolve(["CTRL_C_tongue_roll.ty", "CTRL_C_tongue_roll.tx"])
    assert newer == ("CTRL_C_tongue_roll.ty", "CTRL_C_jaw.ty")
    assert older == ("CTRL_C_tongue_bendTwist.ty", "CTRL_C_tongue_bendTwist.tx")


def test_missing_leaves_out_controls_that_the_older_board_never_had():
    older = [c.mh3_name or c.name for c in CONTROLS.controls if c.mh3_name != "-"]
    assert len(older) == 179
    assert CONTROLS.missing(older) == ()
    newer = [c.name for c in CONTROLS.controls if c.mh3_name != "-"]
    assert len(CONTROLS.missing(newer)) == 6


def test_unknown_control_lists_near_matches():
    with pytest.raises(ControlError, match=r"'CTRL_C_jw.ty'.*did you mean CTRL_C_jaw.ty"):
        CONTROLS.index("CTRL_C_jw.ty")
    with pytest.raises(ControlError, match="see `deitalk face controls`"):
        CONTROLS.index("€")


def test_resolve_rejects_two_spellings_of_one_control():
    with pytest.raises(ControlError, match=r"'CTRL_C_jaw.ty' occurs twice"):
        CONTROLS.resolve(["CTRL_C_jaw.ty", "CTRL_C_jaw.Y"])


def test_unknown_set_lists_the_known():
    with pytest.raises(ControlError, match="'lips'; known: all, lip, upper_face"):
        CONTROLS.subset("lips")


def test_arrays_of_a_set_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        CONTROLS.rest[0] = 1
    with pytest.raises(ValueError, match="read-only"):
        CONTROLS.subset("lip")[0] = 1


def test_copies_of_what_holds_a_set_hold_the_same():
    """A network is copied at every evaluation of a training."""
    assert copy.deepcopy([CONTROLS])[0] is CONTROLS


def test_set_is_read_from_a_table(tmp_path):
    path = tmp_path / "puppet.csv"
    path.write_text(
        "name,min,max,rest,region,mirror\nsmileL,0,1,0.5,mouth,smileR\nsmileR,0,1,0.5,mouth,smileL\n"
    )
    puppet = ControlSet.from_csv(path)
    assert puppet.id == "puppet"
    assert puppet.rest.tolist() == [0.5, 0.5]
    assert puppet.mirror_index.tolist() == [1, 0]
    assert puppet.subset("mouth").tolist() == [0, 1]


def test_set_is_read_from_the_header_of_curves(tmp_path):
    path = tmp_path / "curves.csv"
    path.write_text("frame,time,jaw,lips\n0,0,0,0\n")
    puppet = ControlSet.from_csv(path, id="puppet@1")
    assert (puppet.id, puppet.names, puppet.minimum.tolist()) == (
        "puppet@1",
        ("jaw", "lips"),
        [-1, -1],
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frame,time,a,a\n", "'a' occurs twice"),
        ("name,min\na,zero\n", "control 'a', column min: 'zero' is not a number"),
        ("name,min,max\na,1,1\n", "range 1.0 to 1.0"),
        ("name,rest\na,2\n", "rest 2.0 lies outside"),
        ("name,mirror\na,b\n", "mirror 'b' is not in the set"),
        ("", "is empty"),
    ],
)
def test_invalid_tables_are_rejected_with_the_reason(tmp_path, text, message):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(ControlError, match=message):
        ControlSet.from_csv(path)


def test_absent_and_binary_tables_are_control_errors(tmp_path):
    with pytest.raises(ControlError, match="does not exist"):
        ControlSet.from_csv(tmp_path / "absent.csv")
    (tmp_path / "x.csv").write_bytes(b"\xff\xfe\x00name")
    with pytest.raises(ControlError, match="is no UTF-16 text"):
        ControlSet.from_csv(tmp_path / "x.csv")


def test_selection_keeps_ranges_and_drops_lost_mirrors():
    left = CONTROLS.select(CONTROLS.subset("left"), id="left@1")
    assert len(left) == 72 and (left.mirror_index == np.arange(72)).all()


def test_matches_the_reference_table(shared):
    import pandas as pd

    reference = pd.read_csv(shared / "rig" / "controls.csv", keep_default_na=False)
    assert reference["name"].tolist() == list(CONTROLS.names)
    assert reference["min"].to_numpy() == pytest.approx(CONTROLS.minimum)
    assert reference["max"].to_numpy() == pytest.approx(CONTROLS.maximum)
    for ours, theirs in (("lip", "is_lip"), ("upper_face", "is_upper_emotion")):
        assert np.flatnonzero(reference[theirs]).tolist() == CONTROLS.subset(ours).tolist()
