"""Shapes of avatars: names of the table, known answers, closures, the way back."""

import numpy as np
import pytest

from rig import RigCurves
from rig.conversion.arkit import arkit_controls
from rig.conversion.avatars import AVATARS, avatar_controls, poses_of
from rig.conversion.convert import convert, convert_and_note
from rig.conversion.raw import PREFIX, RAW_ID, raw_controls
from rig.conversion.shape_fit import bounded_fit, shape_key
from rig.errors import FormatError
from rig.retarget.blendshapes import match_shapes
from rig.retarget.mapping_files import read_mapping, write_mapping


def raw(*frames):
    """Raw curves of frames, each a mapping of bare names to values; the rest rests."""
    controls = raw_controls()
    values = np.tile(controls.rest, (len(frames), 1))
    for row, frame in zip(values, frames, strict=True):
        for name, value in frame.items():
            row[controls.index(PREFIX + name)] = value
    return RigCurves(values, controls.names, control_set=RAW_ID)


def shown(avatar, frame):
    found = convert(raw(frame), avatar)
    return {
        n: round(float(v), 3) for n, v in zip(found.names, found.values[0], strict=True) if v > 2e-3
    }


TOGETHER = {f"mouthLipsTogether{half}": 1.0 for half in ("UL", "UR", "DL", "DR")}


@pytest.mark.parametrize(
    ("spelling", "name"),
    [
        ("Face.M_F00_000_00_Fcl_MTH_A", "Fcl_MTH_A"),
        ("Face_Blendshape.Fcl_EYE_Close_L", "Fcl_EYE_Close_L"),
        ("Wolf3D_Head|viseme_PP", "viseme_PP"),
        ("Armature/Head/Viseme_pp", "viseme_PP"),
        ("Body.vrc.v_aa", "vrc.v_aa"),
        ("CC_Base_Body.MOUTH_SMILE_L", "Mouth_Smile_L"),
        ("Genesis9__facs_bs_MouthPurseUpperLeft", "facs_bs_MouthPurseUpperLeft"),
        ("Genesis8_1Female__facs_bs_MouthSmileLeft_div2", "mouthSmileLeft"),
        ("head__eCTRLvAA", "eCTRLvAA"),
        ("顔.まばたき", "まばたき"),
        ("blinkLeft", "Blink_L"),
    ],
)
def test_spellings_of_one_shape_have_one_pose(spelling, name):
    poses, visemes = poses_of([spelling, name])
    assert poses[0].any() and (poses[0] == poses[1]).all() and visemes[0] == visemes[1]


@pytest.mark.parametrize("avatar", AVATARS)
def test_names_of_a_set_are_one_each_and_have_a_pose(avatar):
    names = avatar_controls(avatar).names
    assert len({shape_key(name) for name in names}) == len(names)
    poses, _ = poses_of(names)
    still = {name for name, pose in zip(names, poses, strict=True) if not pose.any()}
    assert still <= {"Mouth_Close", "viseme_sil", "vrc.v_sil"}


@pytest.mark.parametrize("avatar", AVATARS)
def test_one_shape_comes_back_as_itself(avatar):
    """Weight .6 of each shape to raw curves and back: its poses are shown without a loss."""
    names = avatar_controls(avatar).names
    poses, visemes = poses_of(names)
    fine = [i for i in range(len(names)) if poses[i].any() and not visemes[i]]
    values = np.zeros((len(fine), len(names)), np.float32)
    values[np.arange(len(fine)), fine] = 0.6
    raw_of = convert(RigCurves(values, names, control_set=avatar), RAW_ID)
    moved = raw_of.values - raw_controls().rest
    np.testing.assert_allclose(moved, 0.6 * poses[fine], atol=1e-6)
    back = convert(raw_of, avatar)
    np.testing.assert_allclose(back.values @ poses, moved, atol=2e-3)


def test_known_answers():
    assert shown("cc4", {"mouthCornerPullL": 0.5, "browDownR": 0.25}) == {
        "Mouth_Smile_L": 0.5,
        "Brow_Drop_R": 0.25,
    }
    assert shown("vrm1", {"eyeBlinkL": 1.0}) == {"blinkLeft": 1.0}
    assert shown("mmd", {"mouthCornerDepressL": 0.4, "mouthCornerDepressR": 0.4}) == {
        "口角下げ": 0.4
    }
    # jaw .275 is half of the viseme's .55; the damping of visemes takes less than a tenth
    (name, weight), *others = shown("vrm0", {"jawOpen": 0.2}).items()
    assert name == "A" and all(value < weight for _, value in others)


def test_lips_meet_on_every_avatar():
    """Over an open jaw: a vowel closes, PP is full, ARKit's and Character Creator's corrective acts."""
    met = {"jawOpen": 0.5} | TOGETHER
    assert shown("vrm1", met) == {} and shown("daz9", met) == {}
    assert shown("oculus", met)["viseme_PP"] > 0.9
    assert sum(shown("oculus", met).values()) < 1.1
    assert shown("cc4", met) == {"Jaw_Open": 0.5, "Mouth_Close": 0.5}


def test_visemes_rest_where_the_set_has_the_mouth_itself():
    names = (*avatar_controls("oculus").names, "jawOpen", "mouthFunnel", "mouthSmileLeft")
    fit = match_shapes(names).weights(raw({"jawOpen": 0.5, "mouthCornerPullL": 0.3}))
    assert dict(zip(names, fit.weights[0].round(4), strict=True))["jawOpen"] == np.float32(0.5)
    assert not fit.weights[:, :15].any()


def test_character_creator_shows_all_that_arkits_shapes_move(rng):
    """Directly or by a similar shape."""
    controls = arkit_controls()
    values = rng.uniform(0, 1, (20, len(controls))).astype(np.float32)
    values[:, 52:] = 0
    _, note = convert_and_note(RigCurves(values, controls.names, control_set=controls.id), "cc4")
    assert note.startswith("cc4: ") and "no shape for" not in note


def test_what_is_not_shown_is_said():
    found, note = convert_and_note(raw({"jawOpen": 0.3, "tongueTipUp": 0.4}), "vrm1")
    assert found.control_set == "vrm1"
    # of the movement .3 and .4 the second is lost: .4 / .5 = 80 %
    assert note.startswith("vrm1: the shapes show ") and "no shape for tongueTipUp" in note
    shares = float(note.partition("show ")[2].partition("%")[0])
    assert shares <= 20


def test_a_printed_mapping_is_read_back_as_the_same_poses(tmp_path):
    names = ("Mouth_Smile_L", "viseme_PP", "jawOpen", "Key 7")
    poses = match_shapes(names)
    write_mapping(tmp_path / "m.csv", poses.mapping())
    lines = (tmp_path / "m.csv").read_text().splitlines()
    assert lines[:2] == ["shape,control,value", "Mouth_Smile_L,mouthCornerPullL,1.0"]
    assert lines[-1] == "Key 7,,"
    again = match_shapes(names, mapping=read_mapping(tmp_path / "m.csv"))
    np.testing.assert_allclose(again.poses, poses.poses, atol=1e-4)
    (tmp_path / "m.csv").write_text("shape,control,value\nKey 7,,\n")
    with pytest.raises(FormatError, match="is no mapping"):
        read_mapping(tmp_path / "m.csv")


def test_the_damped_fit_is_the_ridge_of_its_normal_equations(rng):
    """Inside the bounds: (P Pᵀ + diag(d |p|²)) w = P m."""
    poses = rng.uniform(0.2, 1, (4, 12))
    target = rng.uniform(0.2, 0.4, (4,)) @ poses
    damping = np.full(4, 0.05)
    gram = poses @ poses.T
    expected = np.linalg.solve(gram + np.diag(damping * np.diag(gram)), poses @ target)
    assert (expected > 0).all() and (expected < 1).all()
    assert bounded_fit(target[None], poses, damping)[0] == pytest.approx(expected, abs=5e-3)
