"""Variants of the emotions: laws of every one, how they are drawn, and how they are given."""

import re
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest

from deitalk import animate
from deitalk.acting import Acting
from deitalk.config.rules import Expressions
from deitalk.emotions.variants import EMOTION_OF
from deitalk.errors import EmotionError
from deitalk.live.animator import LiveAnimator
from deitalk.postprocess.life.character import Seeds, Traits
from deitalk.postprocess.variants import (
    COLUMNS,
    HABITS,
    USUAL_STATE,
    choose_ways,
    habit_factors,
    show_habits,
)
from deitalk.research.evaluation.benchmark_curves import speechlike
from rig import default_controls
from rig.emotions import EMOTIONS, LABELS, VARIANTS
from rig.face.head import build_head
from tests.deitalk.postprocess.stages import Stages

CONTROLS = default_controls()
RULES = Stages(CONTROLS)
LEFT = [i for i, name in enumerate(CONTROLS.names) if name.startswith("CTRL_L_")]
RIGHT = [CONTROLS.index(CONTROLS.names[i].replace("_L_", "_R_")) for i in LEFT]


def one_hot(names, name):
    return np.eye(len(names), dtype=np.float32)[[list(names).index(name)]]


SHOWN = [*EMOTION_OF, *LABELS]
"""Every variant, and every emotion in its own pose."""


def shown(variant, applied=1.0, *, neutral=None, emotional=None, side=1.0, weight=1.0):
    """One frame of a variant on two readings; by default faces at rest."""
    rest = CONTROLS.rest[None].astype(np.float32)
    neutral = rest if neutral is None else neutral
    curves = neutral + applied * ((neutral if emotional is None else emotional) - neutral)
    applied = np.array([applied], np.float32)
    emotion = one_hot(LABELS, EMOTION_OF.get(variant, variant))
    weight = weight if variant in EMOTION_OF else 0
    ways = np.float32(weight) * one_hot(COLUMNS, variant if variant in EMOTION_OF else COLUMNS[0])
    RULES.express(curves, neutral, emotion, applied, np.ones(1, np.float32), ways, side)
    return curves


def readings(seed):
    rng = np.random.default_rng(seed)
    span = CONTROLS.maximum - CONTROLS.minimum
    rows = CONTROLS.rest + span * rng.uniform(0, 0.4, (2, len(CONTROLS)))
    return {"neutral": rows[:1].astype(np.float32), "emotional": rows[1:].astype(np.float32)}


def test_every_emotion_but_neutral_has_three_variants_with_names_of_their_own():
    assert [*VARIANTS] == [*LABELS[1:]]
    assert all(len(own) >= 3 and {*own.values()} >= {-1, 1} for own in VARIANTS.values())
    names = [name for own in VARIANTS.values() for name in own]
    assert len({*names, *LABELS, "plain"}) == len(names) + len(LABELS) + 1


@pytest.mark.parametrize("variant", SHOWN)
@pytest.mark.parametrize("seed", range(2))
def test_no_intensity_is_the_neutral_reading_and_more_goes_further_the_same_way(variant, seed):
    given = readings(seed)
    steps = [shown(variant, k, **given) - given["neutral"] for k in (0, 0.3, 0.6, 1, 1.5)]
    assert not steps[0].any()
    for less, more in pairwise(steps):
        assert (np.abs(more) >= np.abs(less) - 1e-6).all()
        assert (more * less >= -1e-9).all()


@pytest.mark.parametrize("variant", SHOWN)
def test_closed_lips_stay_closed(variant):
    neutral = CONTROLS.rest[None].astype(np.float32).copy()
    neutral[:, RULES.seals] = 1
    curves = shown(variant, 1.5, neutral=neutral)
    np.testing.assert_array_equal(curves[:, RULES.opening], neutral[:, RULES.opening])
    np.testing.assert_array_equal(curves[:, RULES.seals], neutral[:, RULES.seals])


@pytest.mark.parametrize("variant", EMOTION_OF)
def test_half_a_variant_is_half_way_from_the_pose_of_the_emotion(variant):
    plain, half, whole = (shown(variant, weight=weight) for weight in (0, 0.5, 1))
    np.testing.assert_allclose(half, (plain + whole) / 2, atol=1e-6)
    assert np.abs(whole - plain).max() > 0.05


@pytest.mark.parametrize("variant", EMOTION_OF)
def test_the_other_side_is_the_mirror(variant):
    """Of a symmetric reading, also where the emotion is of one side."""
    left, right = (shown(variant, side=side) for side in (1, -1))
    np.testing.assert_allclose(left[:, LEFT], right[:, RIGHT], atol=1e-6)
    np.testing.assert_allclose(left[:, RIGHT], right[:, LEFT], atol=1e-6)


def test_an_emotion_that_captures_show_has_no_variants():
    from deitalk.postprocess.expressions import expression_table

    captured = expression_table(CONTROLS.names, EMOTIONS)
    rows = [k for k, name in enumerate([*LABELS, *EMOTION_OF.values()]) if name in EMOTIONS]
    assert not captured.poses[rows].any() and not captured.parting[rows].any()
    assert (captured.gains[rows[: len(EMOTIONS)]] == 1).all()
    assert not captured.gains[rows[len(EMOTIONS) :]].any()


def test_the_page_lists_every_variant():
    page = (Path(__file__).parents[3] / "docs/emotions.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| (\w+) \| (.*) \|$", page, re.M))
    for emotion, own in VARIANTS.items():
        columns = {cell.partition(":")[0].strip() for cell in rows[emotion].split("|")}
        assert columns == {*own}, emotion


def drawn(seed=0, actor="anna", sound=0, state=None, **given):
    waveform = np.full(100, sound / 1000, np.float32)
    traits = Traits.of(Seeds.of(waveform, actor, seed).character())
    return choose_ways(given, replace(traits, own=float(actor != "")), seed, state)


def test_of_nobody_no_muscle_is_habitual_and_actors_differ_in_all():
    assert (drawn(actor="").habits == 1).all() and (drawn(plain=1.0).habits == 1).all()
    found = np.array([drawn(actor=f"actor {k}").habits for k in range(100)])
    assert 0.68 < found.min() < 0.72 and 2.15 < found.max() < 2.24
    assert (np.log(found).std(axis=0) > 0.15).all()
    assert np.abs(np.corrcoef(found.T) - np.eye(len(HABITS))).max() < 0.45


def test_habits_are_of_the_expression_alone_and_keep_the_laws_of_intensity():
    ranges = CONTROLS.minimum, CONTROLS.maximum
    given = {name: np.clip(rows, *ranges) for name, rows in readings(0).items()}
    factors = habit_factors(CONTROLS, Expressions(), drawn(seed=4).habits)
    steps = []
    for k in (0, 0.3, 0.6, 1):
        curves = np.clip(shown("hot", k, **given), *ranges)
        show_habits(curves, given["neutral"], CONTROLS, factors)
        steps.append(curves - given["neutral"])
    assert not steps[0].any()
    for less, more in pairwise(steps):
        assert (np.abs(more) >= np.abs(less) - 1e-6).all()
    assert (factors[[*RULES.seals, *RULES.opening]] == 1).all()
    assert (factors != 1).sum() > 30


def test_a_habit_leaves_room_for_a_stronger_voice():
    n = len(CONTROLS)
    neutral = np.tile(CONTROLS.rest, (4, 1)).astype(np.float32)
    room = CONTROLS.maximum - neutral
    shown = neutral + room * np.array([[0.01], [0.6], [0.9], [1.0]], np.float32)
    for factor in (0.7, 1.8):
        found = show_habits(shown.copy(), neutral, CONTROLS, np.full(n, factor, np.float32))
        shares = ((found - neutral) / np.where(room > 0, room, 1))[:, (room > 0).all(axis=0)].T
        np.testing.assert_allclose(shares[:, 0], 0.01 * factor, rtol=0.02)
        assert (np.diff(shares) > 0.05).all()
        # (1.8 * .6) / (1 + .8 * .6), and .7 * .6
        np.testing.assert_allclose(shares[:, 1], {0.7: 0.42, 1.8: 0.7297}[factor], rtol=1e-3)


def test_an_actor_that_captures_show_has_no_habits():
    rule = Expressions(captured=("angry",))
    assert (habit_factors(CONTROLS, rule, drawn(seed=4).habits) == 1).all()
    assert (habit_factors(CONTROLS, None, drawn(seed=4).habits) == 1).all()


def rows_of(ways):
    """Weights of each emotion's own variants."""
    table = {}
    for name, own in VARIANTS.items():
        table[name] = ways.weights[..., [COLUMNS.index(v) for v in own]]
    return table


def test_a_take_is_between_the_variants_of_each_emotion_and_near_one():
    found = [rows_of(drawn(seed)) for seed in range(200)]
    for name in VARIANTS:
        weights = np.array([rows[name] for rows in found])
        np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-5)
        assert 0.82 < weights.max(axis=1).mean() < 0.9
        assert (np.bincount(weights.argmax(axis=1), minlength=3) > 40).all()
    assert not drawn().of(one_hot(LABELS, "neutral")).any()


def test_the_phrases_of_a_take_have_the_variants_that_takes_of_their_strength_have():
    states = np.array([-0.5, 0.2, 2.0])
    take = drawn(state=states)
    for state, weights in zip(states, take.weights, strict=True):
        np.testing.assert_allclose(weights, drawn(state=state).weights, rtol=1e-6)
    angry, mixed = take.of(one_hot(LABELS, "angry")), np.zeros((3, len(LABELS)), np.float32)
    assert not angry[:, [k for k, name in enumerate(COLUMNS) if EMOTION_OF[name] != "angry"]].any()
    mixed[:, [LABELS.index("angry"), LABELS.index("sad")]] = 0.3, 0.7
    np.testing.assert_allclose(take.of(mixed).sum(axis=1), 1, rtol=1e-5)


@pytest.mark.parametrize(
    ("other", "is_same"),
    [
        ({}, True),
        ({"seed": 1}, False),
        ({"sound": 5}, True),
        ({"actor": "ben"}, False),
        ({"state": 0.0}, False),
        ({"actor": ""}, False),
    ],
)
def test_seed_strength_and_actor_choose(other, is_same):
    assert np.array_equal(drawn().weights, drawn(**other).weights) == is_same


@pytest.mark.parametrize("seed", [0, 3])
@pytest.mark.parametrize("state", [-0.5, None, 2.0])
def test_of_nobody_the_strength_alone_chooses_whatever_the_sound(seed, state):
    """Variants that were drawn for each recording hid which of two takes is the stronger one."""
    first, second = (drawn(seed, actor="", sound=sound, state=state) for sound in (1, 2))
    np.testing.assert_array_equal(first.weights, second.weights)
    if seed == 0 and state is None:
        for weights in rows_of(first).values():
            np.testing.assert_allclose(weights, 1 / len(weights), rtol=1e-6)


def test_takes_of_a_named_actor_are_alike():
    anna = [drawn(actor="anna", sound=sound) for sound in (1, 2)]
    np.testing.assert_array_equal(anna[0].weights, anna[1].weights)
    assert anna[0].side == anna[1].side
    assert (drawn(actor="ben", sound=1).weights != anna[0].weights).any()


@pytest.mark.parametrize("emotion", VARIANTS)
def test_a_voice_at_the_usual_state_is_between_the_variants(emotion):
    """That of sadness is 6 dB lower: people are quieter in it."""
    usual = USUAL_STATE - 0.6 * (emotion == "sad")
    np.testing.assert_allclose(rows_of(drawn(actor="", state=usual))[emotion], 1 / 3, rtol=1e-6)


@pytest.mark.parametrize("emotion", VARIANTS)
def test_a_weak_voice_is_not_of_one_variant_alone(emotion):
    """A calm reader is weak; surprise of one brow was none for those who looked."""
    assert rows_of(drawn(actor="", state=-0.6))[emotion].max() < 0.7


@pytest.mark.parametrize("emotion", VARIANTS)
def test_a_strong_voice_is_nearer_to_the_variant_of_strong_voices(emotion):
    own = VARIANTS[emotion]
    loud, quiet = (list(own.values()).index(home) for home in (1, -1))
    for seed in range(20):
        steps = [rows_of(drawn(seed, state=z))[emotion] for z in (-2, -1, 0, 1, 2)]
        odds = [np.log(row[loud] / row[quiet]) for row in steps]
        assert (np.diff(odds) > 0).all()


def test_given_variants_are_shown_and_the_others_drawn():
    free, given = drawn(), drawn(hot=0.6, cold=0.4)
    assert rows_of(given)["angry"] == pytest.approx([0.6, 0.4, 0])
    assert (rows_of(given)["happy"] == rows_of(free)["happy"]).all()
    assert not drawn(plain=1.0).weights.any()


@pytest.mark.parametrize(
    ("text", "weights", "written"),
    [
        ("hot", {"hot": 1}, "hot"),
        (" Hot , warm", {"hot": 1, "warm": 1}, "hot,warm"),
        ("hot=.7,cold=.3", {"hot": 0.7, "cold": 0.3}, "hot=0.7,cold=0.3"),
        ({"smug": 0.5}, {"smug": 0.5}, "smug=0.5"),
        ("plain", {"plain": 1}, "plain"),
        ("", {}, ""),
    ],
)
def test_text_of_a_variant(text, weights, written):
    acting = Acting.of(variant=text)
    assert acting.variant == pytest.approx(weights)
    assert acting.settings == ({"variant": written} if written else {})
    assert Acting.of(**acting.settings).variant == acting.variant


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("angry", "unknown variant 'angry'; known are angry: hot, cold, disgusted;"),
        ("hot,plain", "unknown variant 'plain'"),
        ("hot=2", "variant hot=2: weights must be 0 to 1"),
        ("hot=nan", "it must be a finite number"),
        ("hot=x", "it must be a finite number"),
        ("hot=.7,cold=.6", "variants of angry sum to 1.3; they must not exceed 1"),
        ("hot,hot", "variant hot is given twice"),
        (5, "variant 5 must be a text"),
    ],
)
def test_a_wrong_variant_is_refused_in_one_line(text, rule):
    with pytest.raises(EmotionError, match=rule) as caught:
        Acting.of(variant=text)
    assert "\n" not in str(caught.value)


def test_takes_of_two_seeds_differ_in_their_expression_and_one_seed_is_one_take():
    sound = speechlike(2.0)
    takes = [
        animate(sound, "angry", sample_rate=16_000, seed=seed, life="off").curves.values
        for seed in (1, 1, 3)
    ]
    np.testing.assert_array_equal(takes[0], takes[1])
    assert np.abs(takes[0] - takes[2]).max() > 0.1


def test_a_take_that_follows_another_has_its_character():
    """Of other sound; the traits of the take before are its character's."""
    first, second = speechlike(2.0), 0.5 * speechlike(2.5)[::-1].copy()
    before = animate(first, "angry", sample_rate=16_000)
    free, led = (
        animate(second, "angry", sample_rate=16_000, after=after) for after in (None, before)
    )
    assert led.traits == pytest.approx(before.traits, abs=1e-5)
    assert led.traits["own"] == 0
    assert free.traits != led.traits


def test_live_voices_have_variants_too():
    sound, poses = speechlike(2.0), []
    for variant in ("hot", "cold", "hot"):
        animator = LiveAnimator("live", "angry", variant=variant, life="off")
        poses.append(np.concatenate((animator.feed(sound), animator.finish())))
    np.testing.assert_array_equal(poses[0], poses[2])
    lid = CONTROLS.index("CTRL_L_eye_blink.ty")
    assert poses[1][:, lid].min() > poses[0][:, lid].min() + 0.1


def test_a_variant_that_is_not_shown_is_said():
    take = animate(speechlike(1.0), "happy", sample_rate=16_000, variant="hot", life="off")
    assert any("variant hot is of angry" in note for note in take.recording.warnings)
    assert not any("variant" in note for note in animate(
        speechlike(1.0), "happy", sample_rate=16_000, variant="warm", life="off"
    ).recording.warnings)  # fmt: skip


def test_variants_of_an_emotion_are_poses_of_their_own():
    """On faces at rest: what the table adds differs, by more than size."""
    for own in VARIANTS.values():
        for a, b in combinations(own, 2):
            rest = CONTROLS.rest
            r = np.corrcoef(shown(a)[0] - rest, shown(b)[0] - rest)[0, 1]
            assert r < 0.9, (a, b)


def taught(emotion):
    """The reading of a face at rest in an emotion, as networks are taught it."""
    from deitalk.postprocess.expressions import expression_table

    table, face = expression_table(CONTROLS.names), CONTROLS.rest[None].astype(np.float32)
    face[0, table.places] += table.taught[LABELS.index(emotion)]
    return face


@pytest.mark.parametrize("person", ["Ada", "Bruno", "Chidi", "Kaya"])
@pytest.mark.parametrize("emotion", ["happy", "sad"])
def test_the_iris_stays_visible_in_a_smile_and_in_sadness(emotion, person):
    """Gap of the lids of embedded heads at intensity 1 over that at rest, in all variants: warm
    joy left .05 of it, and dejection, which looked sleepy, .23. Both narrow the eyes."""
    head, table = build_head(person), (emotion, *VARIANTS[emotion])
    poses = [shown(variant, emotional=taught(emotion))[0] for variant in table]
    vertices = head.pose(np.stack((CONTROLS.rest, *poses)).astype(np.float32))
    up, low = (head.landmarks[f"eye_{lid}_left"] for lid in ("upper", "lower"))
    gaps = vertices[:, up, 1] - vertices[:, low, 1]
    shares = gaps[1:] / gaps[0]
    assert shares.min() > 0.5 and shares.max() < 0.95, dict(zip(table, shares, strict=True))


@pytest.mark.parametrize("variant", EMOTION_OF)
def test_a_variant_is_nearest_to_its_own_emotion(variant):
    """By the angle between poses, with a margin: disgusted anger was nearer to disgust, attentive
    calm to surprise, worried fear within .05 of sadness."""
    pose = shown(variant, emotional=taught(EMOTION_OF[variant]))[0] - CONTROLS.rest
    likeness = {}
    for emotion in VARIANTS:
        other = shown(emotion, emotional=taught(emotion))[0] - CONTROLS.rest
        likeness[emotion] = pose @ other / np.linalg.norm(pose) / np.linalg.norm(other)
    assert likeness.pop(EMOTION_OF[variant]) > 0.15 + max(likeness.values()), likeness
