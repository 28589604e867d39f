"""Brows, head and the laws of all motion above the mouth."""

from functools import cache

import numpy as np
import pytest

from deitalk.emotions import EMOTIONS, LABELS
from deitalk.errors import DeitalkError
from deitalk.postprocess.life.amounts import Life, place_of
from deitalk.postprocess.life.character import Seeds, Traits
from deitalk.postprocess.life.draws import uniforms
from deitalk.postprocess.life.face import STEMS
from deitalk.postprocess.life.head import MOST_ASIDE, NOD_SECONDS, NOD_SPEED, TURN, Head, draw_nods
from deitalk.postprocess.life.motion import Character, Moved, plan_motion, plan_motions
from deitalk.postprocess.life.neck import BREATH_CONTROL, SWALLOW_CONTROL, TURNS
from deitalk.postprocess.life.play import LOWER_LID
from deitalk.postprocess.life.voice import Accent, Phrase, Voice
from deitalk.postprocess.tracks import MOTION, MotionTracks
from deitalk.research.evaluation.nods import find_nods
from rig import default_controls
from tests.deitalk.postprocess.stages import Stages
from tests.errors import one_line

CONTROLS = default_controls()
STAGES = Stages(CONTROLS)
N_FRAMES = 900
PHRASES = tuple(Phrase(start, start + 75, start == 600) for start in range(60, 800, 90))
STRESSED = tuple(
    Accent(frame, 0.8) for phrase in PHRASES for frame in range(phrase.start + 8, phrase.stop, 16)
)
VOICE = Voice(N_FRAMES, np.zeros(N_FRAMES, np.float32), STRESSED[::4], PHRASES, STRESSED)
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


@cache
def acted(emotion):
    """Curves of a face in an emotion, which tests only read."""
    return moved(emotion)[0]


def still(n_frames, **moving):
    """Motion tracks of a face that does not move, but for `moving`."""
    tracks = MotionTracks(*(np.zeros((n_frames, width)) for width in MOTION))
    return tracks._replace(**moving)


def head_motion(voice, mixture, seed=0):
    """Motion of a head without its posture, and the posture."""
    head = Head(np.array([Seeds((0, 0, seed)).key("head")], np.uint64), np.zeros(1), np.ones(1))
    head.cue(voice.cues())
    speaks = voice.speaking[None].astype(float)
    one, first = np.arange(1), np.zeros(1, int)
    motion = head.play(one, first, speaks)[0, :, :6]
    lively = head.liveliness(one, mixture[None])[0, :, None]
    return motion * lively, head.postures(one, mixture[None])[0]


def of(curves, stem, side="L"):
    return curves[:, CONTROLS.index(f"CTRL_{side}_{stem}.ty")]


def test_only_stems_eyes_and_neck_move():
    curves, _ = moved("neutral")
    rest = np.tile(CONTROLS.rest, (N_FRAMES, 1))
    names = {CONTROLS.names[i] for i in np.flatnonzero((curves != rest).any(axis=0))}
    expected = {f"CTRL_{s}_{stem}.ty" for s in "LR" for stem in STEMS}
    expected |= {f"CTRL_{s}_eye.t{axis}" for s in "LR" for axis in "xy"}
    assert {*names} - expected <= {*TURNS, SWALLOW_CONTROL, BREATH_CONTROL} and expected <= names


def test_intensity_0_moves_like_the_neutral_reading():
    curves, neutral = moved("happy", strength=0.0)
    np.testing.assert_array_equal(curves, neutral)
    _, plain = moved("neutral")
    np.testing.assert_array_equal(neutral, plain)


def test_motion_that_is_off_is_absent():
    curves, _ = moved("angry", blinks=0, gaze=0, brows=0, head=0)
    np.testing.assert_array_equal(curves, np.tile(CONTROLS.rest, (N_FRAMES, 1)))
    seeds = Seeds.of(np.zeros(100, np.float32), "", 0)
    assert not plan_motion(VOICE, shown("sad"), seeds, life=Life(head=0)).head.any()


@pytest.mark.parametrize("part", ["blinks", "brows"])
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


@pytest.mark.parametrize("emotion", LABELS[1:])
def test_every_upper_region_moves_in_an_emotion(emotion):
    curves, _ = moved(emotion, start=0.2)
    for region in ("brow_", "eye_squintInner|eye_blink", "eye_cheekRaise"):
        parts = region.split("|")
        places = [i for i, n in enumerate(CONTROLS.names) if any(part in n for part in parts)]
        assert curves[90:780, places].std(axis=0).max() > 0.012, region


@pytest.mark.parametrize(
    ("emotion", "stem"),
    [("angry", "brow_down"), ("sad", "brow_raiseIn"), ("happy", "eye_cheekRaise"),
     ("surprised", "brow_raiseOut")],
)  # fmt: skip
def test_emotion_decides_what_an_accent_moves(emotion, stem):
    gains = {other: of(acted(other), stem)[90:780].mean() for other in EMOTIONS}
    assert max(gains, key=gains.get) == emotion
    assert np.ptp(of(acted(emotion), stem)[90:780]) > 0.12


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
        assert np.percentile(of(angry, stem) - of(neutral, stem), 5) > least, stem


def test_lids_of_a_calm_face_waver_as_those_of_readers_do():
    """Six readers: 1 to 4 % of the opening within sentences, 3 to 7 % between them."""
    tracks = [
        of(moved("neutral", seed=seed, blinks=0, gaze=0)[0], "eye_blink") for seed in range(9)
    ]
    openings = 1 - np.stack(tracks)[:, 60:780].reshape(9, 8, 90)
    assert 0.01 < openings.std(axis=2).mean() < 0.045
    assert 0.02 < openings.mean(axis=2).std() < 0.07


def test_sides_differ_by_10_to_15_percent_of_an_event():
    curves, _ = moved("surprised", blinks=0)
    left, right = (of(curves, "brow_raiseOut", side)[90:780] for side in "LR")
    assert 0.03 < np.abs(left - right).sum() / (0.5 * (left + right).sum()) < 0.25


@pytest.mark.parametrize("emotion", LABELS)
def test_controls_stay_in_their_ranges_at_twice_everything(emotion):
    curves, _ = moved(emotion, 4.0, start=0.9, brows=2, gaze=2, blinks=2, head=2)
    for stem in STEMS:
        assert of(curves, stem).max() <= 1 + 1e-6
        assert of(curves, stem).min() >= (-1 if stem == "eye_blink" else 0) - 1e-6


def test_head_nods_on_stressed_syllables():
    pitch = np.zeros(N_FRAMES)
    for seed in range(30):
        motion, posture = head_motion(VOICE, shown("neutral"), seed)
        pitch += motion[:, 1] / 30
        assert not posture.any()
    frames = np.array([stress.frame for stress in STRESSED])
    assert pitch[frames + 1].mean() < pitch[frames + 9].mean() - 0.5


def test_head_rises_before_a_phrase_and_is_low_at_its_end():
    phrase = Phrase(120, 300, False)
    voice = VOICE._replace(phrases=(phrase,), stresses=())
    pitch = np.mean(
        [head_motion(voice, shown("neutral"), seed)[0][:, 1] for seed in range(60)],
        axis=0,
    )
    before, within, end = pitch[phrase.start - 6], pitch[200:240].mean(), pitch[phrase.stop]
    assert before > within + 0.15
    assert end < within - 0.5


def draw_nods_of(strength, prominence, vigour=1.0, count=600):
    """Attack and degrees of nods of equal syllables."""
    shares = uniforms(np.array([7], np.uint64), np.arange(count), 10)
    ones = np.ones(count)
    _, attack, _, degrees = draw_nods(strength * ones, prominence * ones, vigour * ones, shares)
    return attack, degrees


def test_nods_are_deeper_on_stronger_and_higher_syllables():
    def pitch(strength, prominence):
        attack, degrees = draw_nods_of(strength, prominence, 0.3)  # slow enough for any of them
        return np.where(attack <= NOD_SECONDS[0][1], degrees[:, 1], 0)  # no turns

    strong, weak = pitch(1.0, 0.0), pitch(0.0, 0.0)
    np.testing.assert_allclose(strong[weak != 0], 2 * weak[weak != 0])
    assert (weak == 0).sum() > (strong == 0).sum(), "fewer on weak ones"
    np.testing.assert_allclose(pitch(0.5, 1.0), 1.3 * pitch(0.5, 0.0))
    np.testing.assert_array_equal(pitch(0.5, -3.0), pitch(0.5, 0.0))


def test_some_stresses_turn_or_tilt_the_head_more_slowly():
    attack, degrees = draw_nods_of(1.0, 0.0, 0.3)
    slow = attack > NOD_SECONDS[0][1]
    assert 0.02 < slow.mean() < 0.12
    aside = degrees[slow & degrees.any(axis=1)]
    assert (np.abs(aside[:, [0, 2]]).max(axis=1) > 2 * np.abs(aside[:, 1])).all()
    assert 0.2 < (aside[:, 0] > 0).mean() < 0.8  # to both sides
    most = max(abs(angle) for turn in TURN for angle in turn)
    assert np.abs(draw_nods_of(1.0, 2.0)[1][:, 0]).max() <= MOST_ASIDE * most + 1e-6


def test_no_nod_goes_down_faster_than_readers_nod():
    attack, degrees = draw_nods_of(1.0, 2.0, 2.5)
    peak = 0.5 * np.pi * np.abs(degrees[:, 1]) / attack  # of a raised cosine
    assert peak.max() < 1.05 * NOD_SPEED
    calm, fast = draw_nods_of(0.2, 0.0, 0.3)[0], draw_nods_of(0.2, 0.0, 4.0)[0]
    assert (calm <= fast + 1e-12).all() and (calm < fast).any()


def test_nods_of_one_voice_come_in_phases():
    """Depths on an even beat of equal stresses spread more than those of single nods."""
    beat = tuple(Accent(frame, 1.0) for frame in range(90, 8910, 30))
    voice = Voice(9000, np.zeros(9000, np.float32), (), (Phrase(60, 8940, False),), beat)
    head = head_motion(voice, np.zeros((9000, 9), np.float32), 2)
    _, depths = find_nods(head[0][:, 1].astype(np.float64), 30)
    assert 0.5 < depths.std() / depths.mean() < 0.9


@pytest.mark.parametrize(
    ("emotion", "column", "sign"), [("sad", 1, -1), ("angry", 5, 1), ("surprised", 5, -1)]
)
def test_posture_is_that_of_the_emotion(emotion, column, sign):
    _, posture = head_motion(VOICE, shown(emotion))
    middle = posture[200:600, column]
    assert (sign * middle > 0.5).all()
    assert np.abs(np.diff(posture, axis=0)).max() < 0.5
    whole, half = (
        plan_motion(VOICE, shown(emotion), Seeds((0, 0, 0)), life=Life(head=factor)).head
        for factor in (1, 0.5)
    )
    assert sign * whole[200:600, column].mean() > 0.4
    np.testing.assert_allclose(half, whole / 2, atol=1e-5)


def test_eyes_turn_against_the_head():
    seeds = Seeds.of(np.zeros(100, np.float32), "", 0)
    turned = plan_motion(VOICE, shown("neutral"), seeds)
    unturned = plan_motion(VOICE, shown("neutral"), seeds, life=Life(head=0))
    compensated = turned.tracks.calm_gaze - unturned.tracks.calm_gaze
    np.testing.assert_allclose(compensated[:, 0], turned.head[:, 0], atol=1e-4)
    np.testing.assert_allclose(compensated[:, 1], -turned.head[:, 1], atol=1e-4)


@pytest.mark.parametrize("emotion", ["angry", "surprised"])
def test_anger_keeps_its_eyes_on_the_listener_under_a_lowered_head(emotion):
    """The posture is undone as the motion is; anger at 1.25 has no aversions left, surprise has."""
    motion = plan_motion(VOICE, shown(emotion, 1.25), Seeds((1, 2, 3)))
    seen = motion.tracks.gaze - motion.head[:, :2] * (1, -1)
    assert (np.abs(seen).max() < 1e-3) == (emotion == "angry")
    assert np.abs(motion.head[:, 1]).max() > 2


@pytest.mark.parametrize("n_frames", [20, 70, 151])
def test_a_take_ends_with_open_eyes(n_frames):
    voice = Voice(n_frames, np.zeros(n_frames, np.float32), (), (Phrase(0, n_frames, False),))
    calm = np.zeros((n_frames, len(LABELS)), np.float32)
    for seed in range(60):
        lids = plan_motion(voice, calm, Seeds((0, 0, seed))).tracks.lids
        assert not lids[-1].any()


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
        for place in ((10.0, -5.0, 65.0), (0.0, 0.0, 65.0))
    )
    np.testing.assert_allclose((there - here), [[10, -5]] * N_FRAMES, atol=1e-4)


@pytest.mark.parametrize(
    "text", ["brows=.8,head=1.2, gaze=0", {"brows": 0.8, "head": 1.2, "gaze": 0}]
)
def test_amounts_are_read_from_text_and_mappings(text):
    assert Life.of(text) == Life(brows=0.8, head=1.2, gaze=0.0)
    assert Life.of(str(Life.of(text))) == Life.of(text)


@pytest.mark.parametrize(
    "life",
    ["nose=1", "brows", "brows=3", "brows=-1", "brows=nan", "brows=1,brows=1", {"head": True}, 3,
     {"head": "x"}, "brows=1e9"],
)  # fmt: skip
def test_amounts_reject_other_names_and_numbers(life):
    with one_line(DeitalkError, match="life"):
        Life.of(life)


@pytest.mark.parametrize("look", ["1", "1,2,3", "a,b", (90, 0), (float("nan"), 0), None])
def test_look_rejects_what_are_no_two_angles(look):
    with pytest.raises(DeitalkError, match="look_at"):
        place_of(look)


def test_takes_side_by_side_move_as_each_alone():
    """Of any lengths, seeds and emotions, beside one that listens to another and mirrors it."""
    takes = []
    for seed, (n_frames, emotion) in enumerate([(40, "sad"), (900, "happy"), (1500, "angry")]):
        phrases = tuple(Phrase(at, at + 75, False) for at in range(5, n_frames - 80, 90))
        voice = Voice(n_frames, np.zeros(n_frames, np.float32), (), phrases, ())
        mixture = np.zeros((n_frames, len(LABELS)), np.float32)
        mixture[:, LABELS.index(emotion)] = 1
        takes.append(Moved(voice, mixture, Character(Seeds((0, 0, seed)))))
    takes[1] = takes[1]._replace(heard=VOICE, felt=shown("sad"))
    for take, together in zip(takes, plan_motions(takes), strict=True):
        (alone,) = plan_motions([take])
        assert len(together.head) == take.voice.n_frames
        for ours, theirs in zip(together.tracks, alone.tracks, strict=True):
            np.testing.assert_array_equal(ours, theirs)
        np.testing.assert_array_equal(together.head, alone.head)
