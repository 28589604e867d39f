"""Brows, head and the laws of all motion above the mouth."""

import numpy as np
import pytest

from deitalk.emotions import EMOTIONS, LABELS
from deitalk.errors import DeitalkError
from deitalk.postprocess.life.amounts import Life, place_of
from deitalk.postprocess.life.head import (
    BREATH_CONTROL,
    MOST_ASIDE,
    NOD_SECONDS,
    NOD_SPEED,
    STEMS,
    SWALLOW_CONTROL,
    TURN,
    TURNS,
    Brows,
    Head,
    draw_accent,
    draw_nod,
)
from deitalk.postprocess.life.motion import plan_motion
from deitalk.postprocess.life.play import LOWER_LID
from deitalk.postprocess.life.voice import Accent, Phrase, Seeds, Swells, Traits, Voice, presence
from deitalk.postprocess.tracks import MOTION, MotionTracks
from deitalk.research.evaluation.nods import find_nods
from rig import default_controls
from tests.deitalk.postprocess.stages import Stages
from tests.each import each
from tests.errors import one_line

CONTROLS = default_controls()
STAGES = Stages(CONTROLS)
N_FRAMES = 900
PHRASES = tuple(Phrase(start, start + 75, start == 600) for start in range(60, 800, 90))
STRESSED = tuple(
    Accent(frame, 0.8) for phrase in PHRASES for frame in range(phrase.start + 8, phrase.stop, 16)
)
VOICE = Voice(N_FRAMES, np.zeros(N_FRAMES, np.float32), STRESSED, PHRASES, STRESSED)
UPPER = ("_brow_", "_eye_", "_eye.")


def shown(emotion, strength=1.0):
    mixture = np.zeros((N_FRAMES, len(LABELS)), np.float32)
    mixture[:, LABELS.index(emotion)] = strength
    return mixture


def moved(emotion="neutral", strength=1.0, start=0.0, seed=0, **life):
    """Curves of a face whose controls stand at `start` above rest, and its neutral reading."""
    seeds = Seeds.of(np.zeros(100, np.float32), "", seed)
    neutral = np.tile(CONTROLS.rest, (N_FRAMES, 1))
    curves = neutral.copy()
    upper = [i for i, name in enumerate(CONTROLS.names) if "_brow_" in name or "_eye_" in name]
    curves[:, upper] += start
    motion = plan_motion(VOICE, shown(emotion, strength), seeds, life=Life(**life))
    STAGES.play(curves, neutral, motion.tracks)
    return curves, neutral


def still(n_frames, **moving):
    """Motion tracks of a face that does not move, but for `moving`."""
    tracks = MotionTracks(*(np.zeros((n_frames, width)) for width in MOTION))
    return tracks._replace(**moving)


def plan_brows(voice, traits, rng):
    brows = Brows(traits, rng)
    for cue in voice.cues():
        brows.cue(cue)
    return brows.at(0, voice.n_frames, np.ones(voice.n_frames))


def head_motion(voice, traits, mixture, rng):
    """Motion and posture of a head."""
    head = Head(traits, rng, (voice.n_frames - 1) / 30)
    for cue in voice.cues():
        head.cue(cue)
    motion = head.at(0, voice.n_frames, voice.speaking)[:, :6]
    return motion * head.liveliness(mixture)[:, None], head.posture(mixture)


def of(curves, stem, side="L"):
    return curves[:, CONTROLS.index(f"CTRL_{side}_{stem}.ty")]


def test_only_brows_lids_cheeks_eyes_and_neck_move():
    curves, _ = moved("angry")
    rest = np.tile(CONTROLS.rest, (N_FRAMES, 1))
    names = {CONTROLS.names[i] for i in np.flatnonzero((curves != rest).any(axis=0))}
    expected = {f"CTRL_{s}_{stem}.ty" for s in "LR" for stem in STEMS}
    expected |= {f"CTRL_{s}_eye.t{axis}" for s in "LR" for axis in "xy"}
    assert {*names} - expected <= {*TURNS, SWALLOW_CONTROL, BREATH_CONTROL} and expected <= names
    assert np.array_equal(curves[0], rest[0])
    assert np.array_equal(curves[-14:], rest[-14:])


def test_intensity_0_moves_like_the_neutral_reading():
    curves, neutral = moved("happy", strength=0.0)
    np.testing.assert_array_equal(curves, neutral)
    _, plain = moved("neutral")
    np.testing.assert_array_equal(neutral, plain)


def test_motion_that_is_off_is_absent():
    curves, _ = moved("angry", blinks=0, gaze=0, brows=0, head=0)
    np.testing.assert_array_equal(curves, np.tile(CONTROLS.rest, (N_FRAMES, 1)))
    seeds = Seeds.of(np.zeros(100, np.float32), "", 0)
    assert plan_motion(VOICE, shown("sad"), seeds, life=Life(head=0)).head is None


@each("part", ["blinks", "brows"])
def test_a_part_that_is_off_changes_no_other(part):
    whole, _ = moved("sad", head=0)
    without, _ = moved("sad", head=0, **{part: 0})
    gaze = CONTROLS.index("CTRL_L_eye.tx")
    np.testing.assert_array_equal(whole[:, gaze], without[:, gaze])
    if part == "blinks":
        difference = np.abs(of(whole, "brow_raiseIn") - of(without, "brow_raiseIn"))
        assert np.median(difference) < 0.02
    else:
        shut = [np.flatnonzero(of(curves, "eye_blink") > 0.9) for curves in (whole, without)]
        assert len(shut[0]) and np.array_equal(*shut)


def test_blinks_draw_the_lower_lids_up():
    curves = np.tile(CONTROLS.rest, (3, 1)).astype(np.float32)
    lids = np.array([[0, 0], [1, 0.5], [0, 0]], np.float32)
    gaze = np.array([[0.0, 0], [0, 0], [0, -20]])
    STAGES.play(curves, curves.copy(), still(3, gaze=gaze, lids=lids))
    np.testing.assert_allclose(of(curves, "eye_squintInner"), [0, LOWER_LID, 0], atol=1e-6)
    np.testing.assert_allclose(of(curves, "eye_squintInner", "R")[1], LOWER_LID / 2, atol=1e-6)


def test_gaze_of_full_range_gives_controls_at_1():
    curves, gaze = np.tile(CONTROLS.rest, (2, 1)), np.array([[40.0, 30.0], [-20.0, -40.0]])
    STAGES.play(curves, curves.copy(), still(2, gaze=gaze))
    eyes = [CONTROLS.index(f"CTRL_R_eye.t{axis}") for axis in "xy"]
    np.testing.assert_allclose(curves[:, eyes], [[1, 1], [-0.5, -1]])


def test_neutral_brows_are_calm_and_alive():
    brows = np.stack([of(moved("neutral")[0], "brow_raiseIn", side) for side in "LR"])
    assert 0.015 < brows[:, 60:800].std() < 0.08
    assert brows.max() < 0.3


@each("emotion", LABELS[1:])
def test_every_upper_region_moves_in_an_emotion(emotion):
    curves, _ = moved(emotion, start=0.2)
    for region in ("brow_", "eye_squintInner|eye_blink", "eye_cheekRaise"):
        parts = region.split("|")
        places = [i for i, n in enumerate(CONTROLS.names) if any(part in n for part in parts)]
        assert curves[90:780, places].std(axis=0).max() > 0.02, region


@each(
    ("emotion", "stem"),
    [("angry", "brow_down"), ("sad", "brow_raiseIn"), ("happy", "eye_cheekRaise"),
     ("surprised", "brow_raiseOut")],
)  # fmt: skip
def test_emotion_decides_what_an_accent_moves(emotion, stem):
    acted, neutral = moved(emotion)
    gains = {other: of(moved(other)[0], stem)[90:780].mean() for other in EMOTIONS}
    assert max(gains, key=gains.get) == emotion
    assert of(acted, stem).max() > of(neutral, stem).max() + 0.05


def test_brows_rise_in_150_to_400_ms_and_fall_more_slowly():
    lone = Voice(180, np.zeros(180, np.float32), (Accent(90, 1.0),), (Phrase(30, 150, False),))
    found = [plan_brows(lone, Traits(), np.random.default_rng(i)).accents[:, 0] for i in range(40)]
    swells = [track for track in found if track.max() > 0.1]
    assert len(swells) > 25
    for track in swells:
        peak = track.argmax()
        rise, fall = np.flatnonzero(track > 0.02 * track.max())[[0, -1]]
        assert peak == pytest.approx(90 - 2, abs=6)  # 60 ms before the accent, or held
        assert 0.08 <= (peak - rise) / 30 <= 0.42
        assert fall - peak > peak - rise


def test_a_few_raises_are_of_one_brow_more_often_the_stronger():
    """Sides of the others differ by no more than the character's and the event's difference."""
    sides = np.array([draw_accent(1.0, 0.12, np.random.default_rng(i)).sides for i in range(800)])
    taken = sides[sides.any(axis=1)]
    ratio = taken.min(axis=1) / taken.max(axis=1)
    alone = ratio < 0.3
    assert 0.06 < alone.mean() < 0.18
    assert ratio[~alone].min() > 0.74
    assert 0.55 < (taken[alone, 0] > taken[alone, 1]).mean() < 0.85


def test_brows_knit_before_some_phrases_and_stay_still_in_some():
    phrases = (Phrase(30, 120, False), Phrase(150, 270, False))
    voice = Voice(330, np.zeros(330, np.float32), (Accent(200, 1.0),), phrases)
    plans = [plan_brows(voice, Traits(), np.random.default_rng(i)) for i in range(80)]
    knit = [plan.frowns for plan in plans if plan.frowns.any()]
    assert 0.2 < len(knit) / 80 < 0.5
    for frown in knit:
        assert 120 < frown[:, 0].argmax() <= 150  # in the pause, before the phrase
    assert 0.55 < np.mean([plan.accents.any() for plan in plans]) < 0.85
    still = voice._replace(phrases=(Phrase(30, 270, False),))
    assert not plan_brows(still, Traits(), np.random.default_rng(0)).frowns.any()


def test_a_take_of_one_phrase_has_accents_of_the_brows():
    accents = tuple(Accent(frame, 1.0) for frame in range(40, 160, 15))
    voice = Voice(200, np.zeros(200, np.float32), accents, (Phrase(30, 170, False),))
    plans = [plan_brows(voice, Traits(), np.random.default_rng(i)) for i in range(60)]
    assert all(plan.accents.max() > 0.1 for plan in plans)


def test_anger_knits_the_brows_and_leaves_the_upper_lids_between_accents():
    calm = VOICE._replace(accents=(), stresses=())
    seeds = Seeds.of(np.zeros(100, np.float32), "", 0)
    faces = []
    for emotion in ("neutral", "angry"):
        curves = np.tile(CONTROLS.rest, (N_FRAMES, 1)).astype(np.float32)
        only_brows = Life(blinks=0, gaze=0, head=0)
        motion = plan_motion(calm, shown(emotion), seeds, life=only_brows)
        STAGES.play(curves, curves.copy(), motion.tracks)
        faces.append(curves[90:780])
    neutral, angry = faces
    for stem, least in (("brow_lateral", 0.03), ("eye_squintInner", 0.05), ("brow_down", 0.05)):
        assert (of(angry, stem) - of(neutral, stem)).min() > least, stem


def test_lids_of_a_calm_face_waver_as_those_of_readers_do():
    """Six readers: 1 to 4 % of the opening within sentences, 3 to 7 % between them."""
    tracks = [
        of(moved("neutral", seed=seed, blinks=0, gaze=0)[0], "eye_blink") for seed in range(9)
    ]
    openings = 1 - np.stack(tracks)[:, 60:780].reshape(9, 8, 90)
    assert 0.01 < openings.std(axis=2).mean() < 0.045
    assert 0.03 < openings.mean(axis=2).std() < 0.07


def test_frown_lowers_and_knits_the_brows_of_a_neutral_face():
    frowns, ones = np.full((60, 2), [0.5, 0.4]), np.ones((60, 1))
    tracks = still(60, frowns=frowns, posture=ones, amount=ones)
    curves = np.tile(CONTROLS.rest, (60, 1)).astype(np.float32)
    STAGES.play(curves, curves.copy(), tracks)
    assert of(curves, "brow_down")[30] == pytest.approx(0.08, abs=1e-3)
    assert of(curves, "brow_down", "R")[30] == pytest.approx(0.064, abs=1e-3)
    assert of(curves, "brow_lateral")[30] > 0.05 > of(curves, "brow_raiseIn")[30]


def test_question_lifts_the_brows():
    events = plan_brows(VOICE, Traits(), np.random.default_rng(0))
    asked = next(phrase for phrase in PHRASES if phrase.is_question)
    assert events.question[asked.stop - 2] > 0.9
    assert events.question[asked.start] == 0


def test_sides_differ_by_10_to_15_percent_of_an_event():
    curves, _ = moved("surprised", blinks=0)
    left, right = (of(curves, "brow_raiseOut", side)[90:780] for side in "LR")
    assert 0.03 < np.abs(left - right).sum() / (0.5 * (left + right).sum()) < 0.25


@each("emotion", LABELS)
def test_controls_stay_in_their_ranges_at_twice_everything(emotion):
    curves, _ = moved(emotion, 4.0, start=0.9, brows=2, gaze=2, blinks=2, head=2)
    for stem in STEMS:
        assert of(curves, stem).max() <= 1 + 1e-6
        assert of(curves, stem).min() >= (-1 if stem == "eye_blink" else 0) - 1e-6


def test_head_nods_on_stressed_syllables_and_is_at_rest_at_both_ends():
    pitch = np.zeros(N_FRAMES)
    for seed in range(30):
        motion, posture = head_motion(
            VOICE, Traits(), shown("neutral"), np.random.default_rng(seed)
        )
        pitch += motion[:, 1] / 30
        assert not posture.any()
    head = plan_motion(VOICE, shown("neutral"), Seeds((0, 0, 0))).head
    assert not head[[0, -1]].any()
    frames = np.array([stress.frame for stress in STRESSED])
    assert pitch[frames + 1].mean() < pitch[frames + 9].mean() - 0.5


def test_head_rises_before_a_phrase_and_is_low_at_its_end():
    phrase = Phrase(120, 300, False)
    voice = VOICE._replace(phrases=(phrase,), stresses=())
    pitch = np.mean(
        [
            head_motion(voice, Traits(), shown("neutral"), np.random.default_rng(seed))[0][:, 1]
            for seed in range(60)
        ],
        axis=0,
    )
    before, within, end = pitch[phrase.start - 6], pitch[200:240].mean(), pitch[phrase.stop]
    assert before > within + 0.3
    assert end < within - 0.5


def test_nods_are_deeper_on_stronger_and_higher_syllables():
    def drawn(strength, prominence):
        draws = [draw_nod(strength, prominence, np.random.default_rng(i)) for i in range(200)]
        return [nod for nod in draws if nod.attack <= NOD_SECONDS[0][1]]  # no turns

    def depth(strength, prominence):
        return -np.mean([nod.degrees[1] for nod in drawn(strength, prominence)])

    strong, weak = drawn(1.0, 0.0), drawn(0.0, 0.0)
    pairs = [(a.degrees[1], b.degrees[1]) for a, b in zip(strong, weak, strict=True)]
    assert all(a == pytest.approx(2 * b) for a, b in pairs if b)
    assert sum(b == 0 for _, b in pairs) > sum(a == 0 for a, _ in pairs)  # fewer on weak ones
    assert depth(0.5, 1.0) == pytest.approx(1.3 * depth(0.5, 0.0))
    assert depth(0.5, -3.0) == depth(0.5, 0.0)


def test_some_stresses_turn_or_tilt_the_head_more_slowly():
    draws = [draw_nod(1.0, 0.0, np.random.default_rng(i)) for i in range(600)]
    turns = [nod for nod in draws if nod.attack > NOD_SECONDS[0][1]]
    assert 0.02 < len(turns) / len(draws) < 0.12
    aside = np.array([nod.degrees for nod in turns if nod.degrees.any()])
    assert (np.abs(aside[:, [0, 2]]).max(axis=1) > 2 * np.abs(aside[:, 1])).all()
    assert 0.2 < (aside[:, 0] > 0).mean() < 0.8  # to both sides
    most = max(abs(degrees) for turn in TURN for degrees in turn)
    loud = [draw_nod(1.0, 2.0, np.random.default_rng(i)) for i in range(600)]
    assert max(np.abs(nod.degrees[0]) for nod in loud) <= MOST_ASIDE * most + 1e-6


def test_no_nod_goes_down_faster_than_readers_nod():
    frame = np.arange(90)
    for seed in range(200):
        nod = draw_nod(1.0, 2.0, np.random.default_rng(seed)).scaled(2.5)
        swells = Swells(1)
        swells.add(1.5, (nod.attack, 0.0, nod.decay), {0: nod.degrees[1]}, -np.inf)
        pitch = swells.at(0, 90)[:, 0]
        assert np.abs(np.diff(pitch)[frame[:-1] < 45]).max() * 30 < 1.05 * NOD_SPEED
    calm = draw_nod(0.2, 0.0, np.random.default_rng(1))
    assert calm.scaled(1.0).attack == calm.attack


def test_nods_of_one_voice_come_in_phases():
    """Depths on an even beat of equal stresses spread more than those of single nods."""
    beat = tuple(Accent(frame, 1.0) for frame in range(90, 8910, 30))
    voice = Voice(9000, np.zeros(9000, np.float32), (), (Phrase(60, 8940, False),), beat)
    head = head_motion(voice, Traits(), np.zeros((9000, 9), np.float32), np.random.default_rng(2))
    _, depths = find_nods(head[0][:, 1].astype(np.float64), 30)
    assert 0.5 < depths.std() / depths.mean() < 0.9


@each(("emotion", "column", "sign"), [("sad", 1, -1), ("angry", 5, 1), ("surprised", 5, -1)])
def test_posture_is_that_of_the_emotion(emotion, column, sign):
    _, posture = head_motion(VOICE, Traits(), shown(emotion), np.random.default_rng(0))
    middle = posture[200:600, column]
    assert (sign * middle > 0.5).all()
    assert np.abs(np.diff(posture, axis=0)).max() < 0.5


def test_eyes_turn_against_the_head():
    seeds = Seeds.of(np.zeros(100, np.float32), "", 0)
    turned = plan_motion(VOICE, shown("neutral"), seeds)
    unturned = plan_motion(VOICE, shown("neutral"), seeds, life=Life(head=0))
    compensated = turned.tracks.calm_gaze - unturned.tracks.calm_gaze
    np.testing.assert_allclose(compensated[:, 0], turned.head[:, 0], atol=1e-4)
    np.testing.assert_allclose(compensated[:, 1], -turned.head[:, 1], atol=1e-4)


@each("emotion", ["angry", "surprised"])
def test_anger_keeps_its_eyes_on_the_listener_under_a_lowered_head(emotion):
    """The posture is undone as the motion is; anger at 1.25 has no aversions left, surprise has."""
    motion = plan_motion(VOICE, shown(emotion, 1.25), Seeds((1, 2, 3)))
    seen = motion.tracks.gaze - motion.head[:, :2] * (1, -1)
    assert (np.abs(seen).max() < 1e-3) == (emotion == "angry")
    assert np.abs(motion.head[:, 1]).max() > 2


@each("silence", [0, 0.1, 3])
def test_a_take_that_is_cut_keeps_its_motion(silence):
    shares = presence(0, 300, 299 / 30, silence)
    assert shares[0] == 0
    assert shares[60:200].min() == 1
    assert shares[-1] == (silence < 1)


def test_emotions_of_a_recording_have_their_own_times_and_one_character():
    takes = [Seeds((1, 2, 3), emotion) for emotion in range(2)]
    assert Traits.of(takes[0].character()) == Traits.of(takes[1].character())
    lids = [plan_motion(VOICE, shown("neutral"), seeds).tracks.lids for seeds in takes]
    assert not np.array_equal(*lids)


def test_one_side_of_the_mouth_does_more_and_silence_none():
    """A smile of .4 over speech of .2 on a side .1 stronger: .2 (1 + .0175) + .2 (1 + .035)."""
    neutral = np.tile(CONTROLS.rest, (2, 1)).astype(np.float32)
    smile = [CONTROLS.index(f"CTRL_{side}_mouth_cornerPull.ty") for side in "LR"]
    neutral[0, smile] = 0.2
    curves = neutral.copy()
    curves[0, smile] = 0.4
    spoken = neutral.copy()
    STAGES.play(curves, spoken, still(2, side=np.full((2, 1), 0.1), amount=np.ones((2, 1))))
    np.testing.assert_allclose(curves[0, smile], [0.4105, 0.3895], atol=1e-6)
    np.testing.assert_array_equal(curves[1], neutral[1])


def test_gaze_rests_where_it_is_told():
    seeds = Seeds.of(np.zeros(100, np.float32), "", 0)
    there, here = (
        plan_motion(VOICE, shown("neutral"), seeds, life=Life(look_at=place)).tracks.gaze
        for place in ((10.0, -5.0), (0.0, 0.0))
    )
    np.testing.assert_allclose((there - here)[60:800], [[10, -5]] * 740, atol=1e-4)
    assert not (there - here)[-1].any()


@each("text", ["brows=.8,head=1.2, gaze=0", {"brows": 0.8, "head": 1.2, "gaze": 0}])
def test_amounts_are_read_from_text_and_mappings(text):
    assert Life.of(text) == Life(brows=0.8, head=1.2, gaze=0.0)
    assert Life.of(str(Life.of(text))) == Life.of(text)


@each(
    "life",
    ["nose=1", "brows", "brows=3", "brows=-1", "brows=nan", "brows=1,brows=1", {"head": True}, 3,
     {"head": "1"}, "brows=1e9"],
)  # fmt: skip
def test_amounts_reject_other_names_and_numbers(life):
    with one_line(DeitalkError, match="life"):
        Life.of(life)


@each("look", ["1", "1,2,3", "a,b", (90, 0), (float("nan"), 0), None])
def test_look_rejects_what_are_no_two_angles(look):
    with pytest.raises(DeitalkError, match="look_at"):
        place_of(look)
