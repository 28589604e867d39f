"""The table of expressions: hand-worked poses, and the laws at any intensity."""

import numpy as np
import pytest

from deitalk.emotions import LABELS
from deitalk.postprocess.expressions import expression_table
from deitalk.postprocess.factors import expression_scale
from rig import default_controls
from tests.deitalk.postprocess.stages import Stages

CONTROLS = default_controls()
RULES = Stages(CONTROLS)
TABLE = expression_table(CONTROLS.names)
SMILE, LIP, LID = (
    CONTROLS.index(f"CTRL_L_{stem}.ty")
    for stem in ("mouth_cornerPull", "mouth_upperLipRaise", "eye_blink")
)
ROUNDED = [i for i, name in enumerate(CONTROLS.names) if "mouth_purse" in name]


def weights_of(emotion, n_frames=1):
    return np.eye(len(LABELS), dtype=np.float32)[[LABELS.index(emotion)] * n_frames]


def expressed(neutral, emotional, emotion, applied, predicted=0.5):
    """One frame after the blend and the table."""
    applied, predicted = (np.array([value], np.float32) for value in (applied, predicted))
    scale = expression_scale(applied, predicted)
    curves = RULES.blend(neutral, emotional.copy(), scale)
    RULES.express(curves, neutral, weights_of(emotion), scale, predicted)
    return curves


def test_pose_and_gain_are_those_of_the_table():
    """At intensity .6, angry lids: .6 of the pose; a network's smile of .2 at .5: .24 times."""
    rest = CONTROLS.rest[None].astype(np.float32)
    place = list(TABLE.places)
    pose = TABLE.poses[LABELS.index("angry"), place.index(LID)]
    assert pose < 0  # lids off the pupil
    angry = expressed(rest, rest, "angry", 0.6)
    np.testing.assert_allclose(angry[0, LID], 0.6 * pose, rtol=1e-5)
    smiling = rest.copy()
    smiling[0, SMILE] += 0.2
    gain = TABLE.gains[LABELS.index("happy"), place.index(SMILE)]
    assert gain > 1
    happy = expressed(rest, smiling, "happy", 0.6)
    np.testing.assert_allclose(happy[0, SMILE], 0.24 * gain, rtol=1e-5)


@pytest.mark.parametrize(
    ("mood", "control", "pose"),
    [("fear", "mouth_stretch", 0.9), ("contempt", "mouth_dimple", 0.95)],
)
def test_corners_of_a_mood_stay_through_a_closure(mood, control, pose):
    neutral = np.tile(CONTROLS.rest, (2, 1)).astype(np.float32)
    neutral[1, RULES.seals] = 1
    shown = expressed(neutral, neutral.copy(), mood, 1.0)[:, CONTROLS.index(f"CTRL_L_{control}.ty")]
    np.testing.assert_allclose(shown, pose, atol=1e-6)


def test_the_lip_of_disgust_yields_to_a_closure_in_three_frames():
    neutral = np.tile(CONTROLS.rest, (9, 1)).astype(np.float32)
    neutral[4, RULES.seals] = 1
    ones = np.ones(9, np.float32)
    curves = neutral.copy()
    RULES.express(curves, neutral, weights_of("disgust", 9), ones, ones)
    raised = 0.75 * np.array([1, 1, 2 / 3, 1 / 3, 0, 1 / 3, 2 / 3, 1, 1])
    np.testing.assert_allclose(curves[:, LIP], raised, atol=1e-6)


def test_contempt_is_of_one_side():
    """AU12 and AU14 of the left corner; a smile of the network is not of it."""
    rest = CONTROLS.rest[None].astype(np.float32)
    smiling = rest.copy()
    right = CONTROLS.index("CTRL_R_mouth_cornerPull.ty")
    smiling[0, [SMILE, right]] += 0.2
    shown = expressed(rest, smiling, "contempt", 1.0)
    assert shown[0, SMILE] > 0.3
    assert shown[0, right] == pytest.approx(rest[0, right])


def test_calm_lowers_the_lids_of_the_neutral_reading():
    rest = CONTROLS.rest[None].astype(np.float32)
    assert 0.1 < expressed(rest, rest, "calm", 1.0)[0, LID] < 0.4


def test_a_smile_yields_to_rounding():
    """Fully pursed lips keep three quarters of it, so that a smile does not go and come with every
    vowel (former laws kept a fifth, then two thirds); the eyes keep all."""
    neutral = CONTROLS.rest[None].astype(np.float32)
    rounded = neutral.copy()
    rounded[:, ROUNDED] = 0.8
    pose = np.zeros_like(neutral)
    pose[:, [SMILE, CONTROLS.index("CTRL_L_eye_cheekRaise.ty")]] = 0.3
    spread, pursed = (expressed(n, n + pose, "happy", 0.5) - n for n in (neutral, rounded))
    moved = [SMILE, LIP]
    np.testing.assert_allclose(pursed[0, moved], 0.75 * spread[0, moved], rtol=1e-4)
    cheek = CONTROLS.index("CTRL_L_eye_cheekRaise.ty")
    np.testing.assert_allclose(pursed[0, cheek], spread[0, cheek], rtol=1e-5)


def test_a_rig_without_the_controls_has_no_table():
    assert not len(expression_table(("smile", "jaw")).places)
