"""Rules on the curves, on random readings."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deitalk.config.rules import Expressions, RulesConfig, ScaleOpening
from deitalk.emotions import LABELS
from deitalk.postprocess.curve_stages import TIP_DOWN
from deitalk.postprocess.expressions import expression_table
from deitalk.postprocess.factors import (
    expression_scale,
    held_intensity,
    mean_around,
    opening_factor,
)
from rig import default_controls
from tests.deitalk.postprocess.stages import Stages

CONTROLS = default_controls()
RULES = Stages(CONTROLS)
OPENS = ScaleOpening()
T = 12


def readings(seed=0, closed=0.0):
    rng = np.random.default_rng(seed)
    neutral, emotional = rng.uniform(0, 1, (2, T, len(CONTROLS.names))).astype(np.float32)
    neutral[:, RULES.seals] = closed
    return neutral, emotional


def blend(neutral, emotional, applied, predicted):
    return RULES.blend(neutral, emotional, expression_scale(applied, predicted))


def constant(value):
    return np.full(T, value, np.float32)


def test_blend_at_the_predicted_intensity_is_the_emotional_reading():
    neutral, emotional = readings()
    blended = blend(neutral, emotional, constant(0.6), constant(0.6))
    np.testing.assert_allclose(blended, emotional, atol=1e-6)


def test_blend_at_twice_the_intensity_goes_twice_as_far():
    neutral, emotional = readings()
    blended = blend(neutral, emotional, constant(1.0), constant(0.5))
    brow = CONTROLS.index("CTRL_L_brow_raiseIn.ty")
    expected = neutral[:, brow] + 2 * (emotional[:, brow] - neutral[:, brow])
    np.testing.assert_allclose(blended[:, brow], expected, atol=1e-6)


@settings(deadline=None)
@given(st.integers(0, 20), st.floats(0, 1), st.floats(0, 1))
def test_more_intensity_never_moves_a_control_back(seed, closed, predicted):
    neutral, emotional = readings(seed, closed)
    levels = [0.0, 0.1, 0.5, 1.0, 2.0, 4.0]
    away = [
        np.abs(blend(neutral, emotional, constant(x), constant(predicted)) - neutral)
        for x in levels
    ]
    assert all((b >= a - 1e-6).all() for a, b in pairwise(away))
    brow = CONTROLS.index("CTRL_L_brow_raiseIn.ty")
    assert (away[-1][:, brow] > away[1][:, brow]).all()


def test_blend_with_a_predicted_intensity_of_0_is_finite():
    neutral, emotional = readings()
    blended = blend(neutral, emotional, constant(0.2), constant(0))
    np.testing.assert_allclose(blended, emotional, atol=1e-6)  # as if it were 0.2 strong


@given(st.integers(0, 20), st.floats(0, 1), st.floats(0, 4))
def test_contacts_are_never_lowered(seed, closed, applied):
    neutral, emotional = readings(seed, closed)
    blended = blend(neutral, emotional, constant(applied), constant(0.3))
    assert (blended[:, RULES.seals] >= neutral[:, RULES.seals]).all()


@pytest.mark.parametrize("which", ["together", "bite"])
def test_blend_does_not_part_closed_lips(which):
    neutral, emotional = readings()
    neutral[:, getattr(RULES, which)] = 0.8
    blended = blend(neutral, emotional, constant(4), constant(0.2))
    assert np.array_equal(blended[:, RULES.opening], neutral[:, RULES.opening])
    smile = CONTROLS.index("CTRL_L_mouth_cornerPull.ty")
    assert not np.allclose(blended[:, smile], neutral[:, smile])


def test_blend_opens_open_lips_fully_and_half_closed_lips_half():
    jaw = CONTROLS.index("CTRL_C_jaw.ty")
    moved = {}
    for closed in (0.0, 0.25, 0.5, 0.75):
        neutral, emotional = readings(closed=closed)
        blended = blend(neutral, emotional, constant(1), constant(1))
        moved[closed] = (blended[:, jaw] - neutral[:, jaw]) / (emotional - neutral)[:, jaw]
    for closed, share in {0.0: 1, 0.25: 1, 0.5: 0.5, 0.75: 0}.items():
        np.testing.assert_allclose(moved[closed], share, atol=1e-4)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_in_silence_the_mouth_is_at_rest_and_a_share_of_the_expression_stays(share):
    """A former law brought the whole face to rest, the neutral reading's too."""
    neutral, curves = readings()
    before = neutral + share * (curves - neutral)
    RULES.rest_in_silence(curves, neutral, constant(0), constant(share))
    for face, expected in ((curves, before), (neutral, readings()[0])):
        at_rest = RULES.follows_mouth
        rest = np.broadcast_to(CONTROLS.rest, curves.shape)
        assert np.array_equal(face[:, at_rest], rest[:, at_rest])
        np.testing.assert_allclose(face[:, ~at_rest], expected[:, ~at_rest], atol=1e-6)
    assert not RULES.follows_mouth[CONTROLS.index("CTRL_L_mouth_cornerPull.ty")]
    assert not RULES.follows_mouth[CONTROLS.index("CTRL_L_brow_down.ty")]


def test_dead_zone_removes_small_openings_only():
    curves = np.tile(CONTROLS.rest, (4, 1))
    jaw, roll = CONTROLS.index("CTRL_C_jaw.ty"), CONTROLS.index("CTRL_L_mouth_lipsRollU.ty")
    brow = CONTROLS.index("CTRL_L_brow_down.ty")
    curves[:, jaw] = [0.005, -0.009, 0.5, 1.0]
    curves[:, roll] = [-0.005, -0.5, 0.0, 0.2]
    curves[:, brow] = 0.004
    RULES.apply_dead_zone(curves)
    np.testing.assert_allclose(curves[:, jaw], [0, 0, 0.49, 0.99], atol=1e-6)
    np.testing.assert_allclose(curves[:, roll], [0, -0.49, 0, 0.19], atol=1e-6)
    assert (curves[:, brow] == np.float32(0.004)).all()


def test_neutral_lips_cover_the_teeth():
    """Upper lips .05, .2, .5 by .1: .05 - .05 (1 - .05 / .4), .1, .4; lower lips of .25 over a jaw
    of .1 keep .16 and .4 of the rest; both readings change by as much."""
    neutral = np.tile(CONTROLS.rest, (3, 1))
    upper, lower = (
        CONTROLS.index(f"CTRL_L_mouth_{name}.ty") for name in ("upperLipRaise", "lowerLipDepress")
    )
    neutral[:, upper], neutral[:, lower] = [0.05, 0.2, 0.5], 0.25
    neutral[:, CONTROLS.index("CTRL_C_jaw.ty")] = [0.1, 0.3, 0.1]
    acted = neutral + 0.3
    before, shown = neutral.copy(), acted.copy()
    RULES.rest_lips(shown, neutral)
    np.testing.assert_allclose(neutral[:, upper], [0.00625, 0.1, 0.4], atol=1e-6)
    np.testing.assert_allclose(neutral[:, lower], [0.16 + 0.4 * 0.09, 0.25, 0.196], atol=1e-6)
    np.testing.assert_allclose(shown - acted, neutral - before, atol=1e-6)


def decided(curve: list[float]) -> np.ndarray:
    values = np.tile(CONTROLS.rest, (len(curve), 1)).astype(np.float32)
    place, jaw = (CONTROLS.index(n) for n in ("CTRL_L_mouth_lipsTogetherU.ty", "CTRL_C_jaw.ty"))
    values[:, place], values[:, jaw] = curve, 0.7
    RULES.sharpen_contacts(values)
    np.testing.assert_allclose(values[:, jaw], 0.7)
    return values[:, place]


@pytest.mark.parametrize(
    ("height", "expected"),
    # odds of 0.5 and 0.2 against those of 0.25 are 3 and 3/4; to the fourth 81 and 81/256
    [(0, 0), (0.2, 81 / 337), (0.25, 0.5), (0.5, 81 / 82), (1, 1)],
)
def test_uncertain_contact_is_sharpened(height, expected):
    np.testing.assert_allclose(decided([height] * 3), expected, atol=1e-3)


def test_lips_part_between_two_contacts():
    """Means of two frames beside the peak of 0.9, whose shoulder is at 0.74, are far below it; the
    network's own values stay."""
    _, first, *between, second, _ = decided([0.9, 0.9, 0.2, 0.1, 0.9, 0.9])
    assert first > 0.99 and second > 0.99
    np.testing.assert_allclose(between, [0.2, 0.10], atol=1e-3)


@pytest.mark.parametrize(
    ("height", "share"),
    # means of two frames are 0.8 and 1 of the height, shoulders at 0.72 and 0.96; odds of 0.8
    # against theirs are 14/9 and 1/6, to the fourth 5.855 and 0.00077, which is less than the
    # 0.6 * 0.35 of the network; a peak of 0.35 becomes (0.35/0.65 * 75/25)^4 = 6.809 to 1, 0.8719
    [(0.95, 0.8541), (0.35, 0.21 * 0.8719)],
)
def test_uncertain_contact_is_brief(height, share):
    before, peak, same, after = decided([0.6 * height, height, height, 0.6 * height])
    assert peak == same > 0.8
    assert before == after == pytest.approx(share, rel=0.01)


def test_a_contact_that_is_found_is_held_for_two_frames():
    """Neighbours of a frame of 0.9 have 0.4 and 0.2: means of 0.65 and 0.55, of which the first is
    the peak; odds of 0.846 against its shoulder, 0.84, to the fourth 1.2. A frame alone is half."""
    before, peak, after = decided([0.4, 0.9, 0.2])
    assert before == peak > 0.99
    assert after == pytest.approx(1.2 / 2.2, abs=0.02)
    assert decided([0, 0.5, 0])[1] == pytest.approx(0.5, abs=1e-3)


def test_lips_start_closing_early_and_keep_their_contact():
    controls = default_controls()
    values = np.tile(controls.rest, (9, 1)).astype(np.float32)
    place = controls.index("CTRL_R_mouth_lipsTogetherD.ty")
    values[4, place] = 1
    Stages(controls).limit_contact_speed(values)
    expected = [0, 0, 0, 0.5, 1, 0.5, 0, 0, 0]
    np.testing.assert_allclose(values[:, place], expected, atol=1e-6)


TONGUE, TIP = RULES.tongue[0], RULES.tongue_tip[0]


def tongue_of(values):
    """Curves of a tongue with a raised tip, before and after the rule."""
    curves = np.tile(CONTROLS.rest, (len(values), 1)).astype(np.float32)
    curves[:, TONGUE], curves[:, TIP] = values, 0.5
    return curves, curves.copy()


def test_the_tongue_is_no_flash_and_comes_out_and_goes_back_gradually():
    """A frame alone is none; two are led in and out by steps of .15; one drawn in stays so."""
    _, alone = tongue_of([0, 0.3, 0, -0.4, 0, 0.2])
    RULES.tongue_out(alone)
    np.testing.assert_allclose(alone[:, TONGUE], [0, 0.3, 0, 0, 0, 0.2], atol=1e-6)
    np.testing.assert_allclose(alone[:, TIP], 0.5)
    _, two = tongue_of([0, 0, 0, 0, -0.4, -0.4, 0, 0, 0])
    RULES.tongue_out(two)
    out = np.array([0, 0, 0.1, 0.25, 0.4, 0.4, 0.25, 0.1, 0])
    np.testing.assert_allclose(two[:, TONGUE], -out, atol=1e-6)
    np.testing.assert_allclose(two[:, TIP], 0.5 * (1 - np.minimum(out / TIP_DOWN, 1)), atol=1e-6)


def test_the_tongue_stays_behind_lips_that_meet():
    before, curves = tongue_of([0, -0.4, -0.4, 0, 0])
    before[3, RULES.together] = curves[3, RULES.together] = 1
    RULES.tongue_out(curves)
    np.testing.assert_allclose(curves[:, TONGUE], [-0.25, -0.4, -0.4, 0, -0.1], atol=1e-6)
    others = np.delete(np.arange(len(CONTROLS)), [TONGUE, TIP])
    np.testing.assert_array_equal(curves[:, others], before[:, others])


JAW = CONTROLS.index("CTRL_C_jaw.ty")


def half_open() -> np.ndarray:
    """Three frames with the jaw at 0.4; in the last the lips are closed."""
    curves = np.tile(CONTROLS.rest, (3, 1))
    curves[:, JAW] = 0.4
    curves[2, RULES.together] = 1
    return curves


def test_mouth_opens_with_an_intensity_above_the_predicted_and_contacts_stay():
    curves = half_open()
    predicted = np.full(3, 0.575, np.float32)
    strength = np.array([0, 0.2, 0.2], np.float32) + np.float32(OPENS.usual)
    RULES.scale_opening(curves, opening_factor(OPENS, strength, predicted))
    np.testing.assert_allclose(curves[:, JAW], [0.4, 0.4 * (1 + 0.2 * OPENS.gain), 0.4], rtol=1e-5)
    others = np.delete(np.arange(len(CONTROLS.names)), RULES.lively)
    np.testing.assert_array_equal(curves[:, others], half_open()[:, others])


@pytest.mark.parametrize(("felt", "way"), [(1.15, 1), (0.45, -1), (OPENS.middle, 0)])
def test_an_emotion_opens_the_mouth_by_its_strength_one_way_and_contacts_stay(felt, way):
    factor, opened = np.full(3, 1.1, np.float32), []
    for intensity in (0, 0.5, 1, 2):
        curves = half_open()
        opened.append(RULES.scale_opening(curves, factor, felt, intensity)[:, JAW])
        np.testing.assert_allclose(curves[:, JAW], [0.44, 0.44, 0.4], rtol=1e-5)
    more = 1 + OPENS.shown * (felt - OPENS.middle)
    assert np.sign(more - 1) == way
    np.testing.assert_allclose(opened[0], [0.44, 0.44, 0.4], rtol=1e-5)
    np.testing.assert_allclose(opened[1], [0.22 * (1 + more)] * 2 + [0.4], rtol=1e-5)
    for shown in opened[2:]:
        np.testing.assert_allclose(shown, [0.44 * more, 0.44 * more, 0.4], rtol=1e-5)


def test_the_opening_follows_the_speech_around_a_frame_and_no_syllable(rng):
    """Between two even stretches of speech the mean is between theirs; silence does not count."""
    speaking = np.ones(400, bool)
    speaking[::3] = False
    values = np.where(np.arange(400) < 200, 0.4, 0.8) + rng.uniform(-0.1, 0.1, 400)
    around = mean_around(np.where(speaking, values, 0.0), speaking)
    assert np.abs(around[:80] - 0.4).max() < 0.04 and np.abs(around[320:] - 0.8).max() < 0.04
    assert np.abs(np.diff(around)).max() < 0.01
    quiet = np.zeros(400, bool)
    np.testing.assert_allclose(mean_around(values, quiet), values, rtol=1e-6)


def test_rules_that_are_off_change_nothing():
    """A random reading passes all of them; the blend is linear in the difference."""
    rng = np.random.default_rng(4)
    neutral, emotional = rng.uniform(0, 1, (2, 40, len(CONTROLS))).astype(np.float32)
    off = Stages(CONTROLS, RulesConfig.none())
    strength = rng.uniform(0, 1, 40).astype(np.float32)
    rest = np.tile(CONTROLS.rest, (40, 1))
    for apply in (
        off.sharpen_contacts,
        off.limit_contact_speed,
        off.tongue_out,
        off.apply_dead_zone,
        lambda rows: off.scale_opening(rows, 2 * strength),
        lambda rows: off.express(
            rows, rest, np.eye(9, dtype=np.float32)[[1] * 40], strength, strength
        ),
        lambda rows: off.rest_lips(rows, rows.copy()),
        lambda rows: off.rest_in_silence(rows, rows.copy(), 0 * strength, 0 * strength),
    ):
        changed = neutral.copy()
        apply(changed)
        np.testing.assert_array_equal(changed, neutral)
    expected = neutral + 2 * (emotional - neutral)
    np.testing.assert_allclose(off.blend(neutral, emotional, np.full(40, 2.0)), expected, atol=1e-6)


def test_rule_uses_the_numbers_of_its_section():
    """A dead zone of 0.1 takes 0.1 from a jaw of 0.3 and all of 0.05."""
    rules = RulesConfig.model_validate({"dead_zone": {"width": 0.1}})
    curves = np.tile(CONTROLS.rest, (2, 1)).astype(np.float32)
    jaw = CONTROLS.index("CTRL_C_jaw.ty")
    curves[:, jaw] = 0.3, 0.05
    Stages(CONTROLS, rules).apply_dead_zone(curves)
    np.testing.assert_allclose(curves[:, jaw], [0.2, 0.0], atol=1e-6)


ANGRY = np.eye(len(LABELS), dtype=np.float32)[LABELS.index("angry")]


def held(share, weights=ANGRY, predicted=0.5, rule=Expressions()):
    """Intensity of frames that show a share of the pose of anger that networks are taught."""
    table = expression_table(CONTROLS.names)
    neutral = np.zeros((3, len(CONTROLS)), np.float32)
    emotional = neutral.copy()
    emotional[:, table.places] = share * table.taught[LABELS.index("angry")]
    emotional[:, CONTROLS.index("CTRL_C_jaw.ty")] = 1  # speech, not the size of a pose
    rows, network = np.tile(weights, (3, 1)), np.full(3, predicted, np.float32)
    return held_intensity(rule, CONTROLS, neutral, emotional, rows, network)


@pytest.mark.parametrize("predicted", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_held_intensity_is_the_size_of_the_pose_whatever_is_predicted(share, predicted):
    np.testing.assert_allclose(held(share, predicted=predicted), share, atol=1e-6)
    larger = Expressions(size=1.25)  # of an actor whose captures show more
    np.testing.assert_allclose(held(share, rule=larger), share / 1.25, atol=1e-6)


@pytest.mark.parametrize(
    ("weights", "rule"),
    [
        (ANGRY, None),
        (ANGRY, Expressions(captured=("angry",))),
        (np.eye(len(LABELS), dtype=np.float32)[0], Expressions()),
    ],
    ids=["no rule", "captured", "neutral"],
)
def test_held_intensity_is_the_predicted_one_where_no_pose_was_taught(weights, rule):
    np.testing.assert_allclose(held(0.3, weights, rule=rule), 0.5)


@pytest.mark.parametrize("emotion", [label for label in LABELS if label != "neutral"])
@pytest.mark.parametrize("shown", [1.0, 0.6, 0.1, 0.0])
def test_expression_is_that_which_is_applied_though_the_network_shows_less_in_silence(
    emotion, shown
):
    """The upper face of a reading that shows a share of the pose that it is taught."""
    table, label = expression_table(CONTROLS.names), LABELS.index(emotion)
    weights = np.eye(len(LABELS), dtype=np.float32)[[label] * T]
    neutral = np.tile(CONTROLS.rest, (T, 1)).astype(np.float32)
    found = []
    for share in (1.0, shown):
        emotional = neutral.copy()
        emotional[:, table.places] += share * table.taught[label]
        holds = held_intensity(
            Expressions(), CONTROLS, neutral, emotional, weights, constant(share)
        )
        scale = expression_scale(constant(0.6), holds)
        curves = neutral.copy()
        curves[:] = RULES.blend(neutral, emotional, scale)
        RULES.express(curves, neutral, weights, scale, holds)
        found.append(curves - neutral)
    upper = [k for k, name in enumerate(CONTROLS.names) if "brow" in name or "nose" in name]
    np.testing.assert_allclose(found[1][:, upper], found[0][:, upper], atol=2e-3)
