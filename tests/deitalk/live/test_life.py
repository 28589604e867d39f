"""Motion above the mouth of a voice that has not ended: events by hand, pieces, laws."""

import numpy as np
import pytest

from deitalk.config.rules import Idle
from deitalk.emotions import LABELS
from deitalk.live.intensity import Measures
from deitalk.live.life import RunningLife, RunningVoice
from deitalk.postprocess.life.amounts import Life
from deitalk.postprocess.life.head import STEMS
from deitalk.postprocess.life.voice import Noise
from rig import default_controls
from tests.deitalk.postprocess.stages import Stages
from tests.each import each

CONTROLS = default_controls()
STAGES = Stages(CONTROLS)
AHEAD = 2


ONLY_BROWS = Life(blinks=0, gaze=0, head=0)


def voice(frames=240, every=60):
    """A level voice, 9 dB stronger for 0.2 s every two seconds."""
    level = np.full(frames, -20.0)
    for peak in range(every, frames, every):
        level[peak - 3 : peak + 4] += 9 * np.hanning(9)[1:-1]
    zeros = np.zeros(frames)
    measures = Measures(level, zeros, np.full(frames, 40.0), np.ones(frames), level)
    return measures, np.ones(frames, bool)


def moved(
    measures, speaking, *, piece=1000, emotion="neutral", strength=1.0, life=ONLY_BROWS, seed=0
):
    """Curves and head of a face at rest."""
    running = RunningLife(Idle(), life, seed, AHEAD)
    count, done, out, heads = len(speaking), 0, [], []
    mixture = np.zeros((count, len(LABELS)), np.float32)
    mixture[:, LABELS.index(emotion)] = strength
    for start in range(0, count, piece):
        part = slice(start, start + piece)
        running.feed(Measures(*(m[part] for m in measures)), speaking[part])
        new = max(min(start + piece, count) - AHEAD - done, 0)
        curves = np.zeros((new, len(CONTROLS)), np.float32)
        motion = running.take(mixture[done : done + new])
        STAGES.play(curves, curves.copy(), motion.tracks)
        heads.append(np.zeros((new, 6)) if motion.head is None else motion.head)
        out.append(curves)
        done += new
    return np.concatenate(out), np.concatenate(heads)


KINDS = ("start", "end", "speech", "pause", "accent", "stress")


def cues(measures, speaking, kind=""):
    return [cue for cue in RunningVoice(AHEAD).feed(measures, speaking) if kind in cue.kind]


def brows(**options):
    return moved(*voice(), **options)[0]


def syllables(frames=900, every=12, pause=(400, 500)):
    """A syllable of 12 dB every 0.4 s, with a pause in the middle."""
    frame = np.arange(frames)
    level = -20 - 6 * (1 - np.cos(2 * np.pi * frame / every))
    speaking = (frame < pause[0]) | (frame >= pause[1])
    level[~speaking] = -80
    zeros = np.zeros(frames)
    return Measures(level, zeros, np.full(frames, 40.0), np.ones(frames), level), speaking


def column(curves, stem):
    return curves[:, CONTROLS.index(f"CTRL_L_{stem}.ty")]


def test_accents_are_peaks_and_known_soon_after():
    measures, speaking = voice()
    found = cues(measures, speaking, "accent")
    assert len(found) == 3 and all(0 <= round(30 * cue.time) % 60 <= 3 for cue in found)
    assert all(0 < cue.size <= 1 for cue in found)
    assert all(cue.known == pytest.approx(cue.time + (1 - AHEAD) / 30) for cue in found)


def test_every_syllable_is_a_stress_and_phrases_begin_and_end():
    measures, speaking = syllables()
    found = cues(measures, speaking)
    frames = {kind: [round(30 * cue.time) for cue in found if cue.kind == kind] for kind in KINDS}
    assert len(frames["stress"]) == pytest.approx(800 / 12, abs=3)
    assert all(f % 12 in (1, 2) for f in frames["stress"][2:-1] if not 400 <= f < 515)
    assert frames["start"] == [0, 500] and frames["end"] == [400]
    known = [round(30 * cue.known) for cue in found if cue.kind == "end"]
    assert known == [406 - AHEAD], "0.2 s are no pause"
    pauses = [cue.size for cue in found if cue.kind == "pause"]
    assert pauses == [0.3, 0.45, 0.5, 0.6, 0.8, 0.9, 1.2, 3.0]
    assert len(frames["speech"]) == 400 // 30 + 400 // 30


@each("level", [-20.0, -60.0])
def test_level_voice_and_silence_have_no_accent_and_no_stress(level):
    flat, zeros = np.full(200, level), np.zeros(200)
    measures = Measures(flat, zeros, zeros + 40, zeros + 1, flat)
    found = cues(measures, np.full(200, level > -40))
    assert not {cue.kind for cue in found} & {"accent", "stress"}


@each("seconds", [0.1, 0.7])
def test_noise_has_its_spread_and_the_speed_of_its_gaussian(seconds):
    noise = Noise((2.0, 0.5), (seconds, seconds), np.random.default_rng(0))
    values = np.concatenate([noise.at(7 * k, 7) for k in range(3000)])
    assert values.std(axis=0) == pytest.approx([2.0, 0.5], rel=0.15)
    speed = 30 * np.diff(values, axis=0).std(axis=0) / [2.0, 0.5]
    assert speed == pytest.approx([2**-0.5 / seconds] * 2, rel=0.15)


def test_pieces_give_the_same_motion():
    spoken = syllables(240, pause=(100, 140))
    whole, head = moved(*spoken, life=Life())
    for piece in (1, 7):
        curves, turned = moved(*spoken, life=Life(), piece=piece)
        np.testing.assert_allclose(curves, whole, atol=1e-6)
        np.testing.assert_allclose(turned, head, atol=1e-5)
    other, turned = moved(*spoken, life=Life(), seed=1)
    assert np.abs(other - whole).max() > 0.1 and np.abs(turned - head).max() > 0.3


def test_anger_knits_the_brows_between_accents():
    flat = np.full(600, -20.0), np.zeros(600), np.full(600, 40.0), np.ones(600)
    level = Measures(*flat, flat[0]), np.ones(600, bool)
    calm, angry = (moved(*level, emotion=emotion)[0][60:] for emotion in ("neutral", "angry"))
    for stem, least in (("brow_lateral", 0.03), ("eye_squintInner", 0.05), ("brow_down", 0.05)):
        assert (column(angry, stem) - column(calm, stem)).min() > least, stem


def test_gaze_is_averted_within_long_phrases():
    level = np.full(3600, -20.0)
    zeros, speaking = np.zeros(3600), np.ones(3600, bool)
    measures = Measures(level, zeros, zeros + 40, zeros + 1, level)
    curves, _ = moved(measures, speaking, life=Life(blinks=0, brows=0, head=0))
    sideways = np.abs(curves[:, CONTROLS.index("CTRL_L_eye.tx")]) * 40
    away = sideways > 3.5
    assert 3 < (away[1:] & ~away[:-1]).sum() < 60  # in two minutes without a pause


def test_motion_before_an_accent_does_not_depend_on_it():
    """The first accent is at frame 60, and known at 61: frames to 58 are without it."""
    measures, speaking = voice()
    accented = brows()
    calm, _ = moved(measures, speaking & False)
    np.testing.assert_array_equal(accented[:58], calm[:58])
    assert column(accented, "brow_raiseIn")[60:100].max() > 0.03
    assert column(calm, "brow_raiseIn").max() < 0.06


def test_emotion_decides_what_moves():
    sizes = {e: {s: column(brows(emotion=e), s).max() for s in STEMS} for e in LABELS}
    assert sizes["angry"]["brow_down"] > sizes["neutral"]["brow_down"] + 0.05
    assert sizes["happy"]["eye_cheekRaise"] > sizes["neutral"]["eye_cheekRaise"] + 0.05
    assert sizes["surprised"]["brow_raiseOut"] > sizes["neutral"]["brow_raiseOut"] + 0.02
    still = [i for i, n in enumerate(CONTROLS.names) if not any(s in n for s in STEMS)]
    assert not brows()[:, still].any()
    nothing, head = moved(*voice(), life=Life(blinks=0, gaze=0, brows=0, head=0))
    assert not nothing.any() and not head.any()


def pitches(measures, speaking, count=8, **options):
    """Mean pitch of the head over seeds [shape=(T,)], degrees."""
    heads = [moved(measures, speaking, life=Life(), seed=k, **options)[1] for k in range(count)]
    return np.mean(heads, axis=0)[:, 1]


def test_head_is_lowest_a_fifth_of_a_second_after_syllables_and_sinks_after_phrases():
    pitch = pitches(*syllables())
    beats = pitch[60:396].reshape(-1, 12).mean(axis=0)
    assert 3 <= beats.argmin() <= 8 and np.ptp(beats) > 0.4
    assert pitch[412:426].min() < pitch[60:396].mean() - 0.1
    assert pitch[480:498].mean() > pitch[412:426].mean() + 0.5, "ready for the next phrase"


def test_head_and_neck_are_at_rest_at_the_start_and_hold_the_emotions_posture():
    curves, head = moved(*syllables(), life=Life(), emotion="sad")
    assert not head[0, :3].any() and not curves[0, CONTROLS.index("CTRL_L_eye.tx")]
    assert head[200:390, 1].mean() < -2
    half = moved(*syllables(), life=Life(head=0.5), emotion="sad")[1]
    np.testing.assert_allclose(half, head / 2, atol=1e-5)
    neck = CONTROLS.index("CTRL_neck_throatExhaleInhale.ty")
    assert curves[410:440, neck].max() > 0.3 and curves[100:390, neck].max() == 0


def test_intensity_0_moves_like_a_neutral_voice():
    calm = moved(*syllables(), life=Life(), emotion="happy", strength=0.0)
    for mine, neutral in zip(calm, moved(*syllables(), life=Life()), strict=True):
        np.testing.assert_array_equal(mine, neutral)


def test_eyes_turn_against_the_head_and_rest_where_they_are_told():
    column_of = CONTROLS.index("CTRL_L_eye.tx")
    still, (turned, head), told = (
        moved(*syllables(), life=Life(blinks=0, **options))
        for options in ({"head": 0}, {}, {"look_at": (20.0, 0.0)})
    )
    difference = turned[:, column_of] - still[0][:, column_of]
    np.testing.assert_allclose(40 * difference, head[:, 0], atol=1e-3)
    np.testing.assert_allclose(told[0][30:, column_of] - turned[30:, column_of], 0.5, atol=1e-4)


def test_blinks_come_as_often_as_in_a_whole_take_and_gather_at_ends_of_phrases():
    lid, begins = CONTROLS.index("CTRL_L_eye_blink.ty"), np.zeros(1800)
    measures, speaking = syllables(1800, pause=(900, 960))
    for seed in range(16):
        closed = moved(measures, speaking, life=Life(head=0), seed=seed)[0][:, lid] > 0.4
        begins[1 : len(closed)] += closed[1:] & ~closed[:-1]
    assert 10 <= begins.sum() / 16 <= 26, "a minute"
    assert begins[904:914].mean() > 2 * begins[60:900].mean()


@each("piece", [1, 7])
def test_eyes_turn_to_another_place_within_a_fifth_of_a_second(piece):
    """Without motion of their own they are where the listener is: ahead, then 20 degrees left."""
    running = RunningLife(Idle(), Life(blinks=0, gaze=0, head=0, brows=0), 0, AHEAD)
    running.feed(*voice())
    given = []
    running.look_at((20.0, 0.0), 140)
    for _ in range(0, 210, piece):
        face = np.zeros((piece, len(CONTROLS)), np.float32)
        motion = running.take(np.zeros((piece, len(LABELS)), np.float32))
        STAGES.play(face, face.copy(), motion.tracks)
        given.append(face)
    faces = np.concatenate(given)
    eyes = np.abs(faces[:, np.abs(faces).max(axis=0).argmax()])
    assert not faces[:140].any()
    assert (np.diff(eyes[139:146]) > 0).all() and eyes[145] == eyes[-1] > 0.1
