"""Motion above the mouth of a voice that has not ended: events by hand, pieces, laws."""

import numpy as np
import pytest

from deitalk.emotions import LABELS
from deitalk.live.cues import RunningCues
from deitalk.live.intensity import Measures
from deitalk.postprocess.life.amounts import Life
from deitalk.postprocess.life.character import Seeds
from deitalk.postprocess.life.motion import Character, MotionStreams
from deitalk.postprocess.life.voice import (
    ACCENT,
    ACCENTS_PER_SECOND,
    END,
    PAUSE,
    SPEECH,
    START,
    STRESS,
    Cues,
)
from deitalk.postprocess.tracks import MotionTracks
from rig import default_controls
from tests.deitalk.postprocess.stages import Stages

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


def moved(measures, speaking, *, piece=None, life=ONLY_BROWS, seed=0):
    """Curves and head of a face at rest; by pieces of so many frames, else with all cues known."""
    running, stream = RunningCues(AHEAD), MotionStreams([Character(Seeds((0, 0, seed)), life)])
    state, count, done, out, heads = running.first(1), len(speaking), 0, [], []
    if piece is None:
        stream.cue(cues(measures, speaking))
        return played(stream, speaking[:-AHEAD])
    for start in range(0, count, piece):
        part = slice(start, start + piece)
        found, state = running(
            Measures(*(m[None, part] for m in measures)), speaking[None, part], state
        )
        stream.cue(found)
        stop = max(min(start + piece, count) - AHEAD, done)
        curves, head = played(stream, speaking[done:stop])
        out.append(curves)
        heads.append(head)
        done = stop
    return np.concatenate(out), np.concatenate(heads)


def played(stream, speaking):
    """Curves of a face at rest and the head of the next frames."""
    if not len(speaking):
        return np.zeros((0, len(CONTROLS)), np.float32), np.zeros((0, 6), np.float32)
    motion = stream.move(speaking[None], np.zeros((1, len(speaking), len(LABELS)), np.float32))
    return shown(motion, 0), motion.head[0]


def shown(motion, stream):
    """Curves of the face of a stream, at rest but for its motion."""
    curves = np.zeros((motion.head.shape[1], len(CONTROLS)), np.float32)
    STAGES.play(curves, curves.copy(), MotionTracks(*(track[stream] for track in motion.tracks)))
    return curves


def faces(count, life=Life()):
    """Faces of so many seeds, side by side."""
    return MotionStreams([Character(Seeds((0, 0, seed)), life) for seed in range(count)])


def to_each(found, count):
    """The cues of one voice for so many streams."""
    return Cues.joined([found._replace(stream=found.stream + k) for k in range(count)])


def spoken_by(streams, count, measures, speaking):
    """Motion of faces that speak with one voice."""
    streams.cue(to_each(cues(measures, speaking), count))
    rows = np.tile(speaking[:-AHEAD], (count, 1))
    return streams.move(rows, np.zeros((*rows.shape, len(LABELS)), np.float32))


KINDS = {"start": START, "end": END, "speech": SPEECH, "pause": PAUSE, "accent": ACCENT,
         "stress": STRESS}  # fmt: skip


def cues(measures, speaking, kind=None):
    running = RunningCues(AHEAD)
    given = Measures(*(track[None] for track in measures)), speaking[None]
    found, _ = running(*given, running.first(1))
    return found if kind is None else found.where(found.kind == kind)


def syllables(frames=900, every=12, pause=(400, 500), rise=12):
    """A syllable of 12 dB every 0.4 s, with a pause in the middle."""
    frame = np.arange(frames)
    level = -20 - rise / 2 * (1 - np.cos(2 * np.pi * frame / every))
    speaking = (frame < pause[0]) | (frame >= pause[1])
    level[~speaking] = -80
    zeros = np.zeros(frames)
    return Measures(level, zeros, np.full(frames, 40.0), np.ones(frames), level), speaking


def column(curves, stem):
    return curves[:, CONTROLS.index(f"CTRL_L_{stem}.ty")]


def test_accents_are_peaks_and_known_soon_after():
    measures, speaking = voice()
    found = cues(measures, speaking, ACCENT)
    assert len(found.time) == 3
    assert all(0 <= frame % 60 <= 3 for frame in np.round(30 * found.time))
    assert ((0 < found.size) & (found.size <= 1)).all()
    assert found.known == pytest.approx(found.time + (1 - AHEAD) / 30)


def test_accents_are_few_where_all_syllables_are_strong():
    """Speech of 27 s has .53 a second, and those that the first ones do not wait for."""
    found = cues(*syllables(rise=24), ACCENT)
    assert 5 < len(found.time) <= ACCENTS_PER_SECOND * 800 / 30 + 2
    assert np.diff(found.time).min() >= 0.5


def test_every_syllable_is_a_stress_and_phrases_begin_and_end():
    measures, speaking = syllables()
    found = cues(measures, speaking)
    frames = {n: np.round(30 * found.time[found.kind == k]).tolist() for n, k in KINDS.items()}
    assert len(frames["stress"]) == pytest.approx(800 / 12, abs=3)
    assert all(f % 12 in (1, 2) for f in frames["stress"][2:-1] if not 400 <= f < 515)
    assert frames["start"] == [0, 500] and frames["end"] == [400]
    assert np.round(30 * found.known[found.kind == END]) == [406 - AHEAD], "0.2 s are no pause"
    pauses = found.size[found.kind == PAUSE].tolist()
    assert pauses == [0.3, 0.45, 0.5, 0.6, 0.8, 0.9, 1.2, 3.0]
    assert len(frames["speech"]) == 400 // 30 + 400 // 30


@pytest.mark.parametrize("level", [-20.0, -60.0])
def test_level_voice_and_silence_have_no_accent_and_no_stress(level):
    flat, zeros = np.full(200, level), np.zeros(200)
    measures = Measures(flat, zeros, zeros + 40, zeros + 1, flat)
    found = cues(measures, np.full(200, level > -40))
    assert not {*found.kind.tolist()} & {ACCENT, STRESS}


def test_pieces_give_the_same_motion():
    spoken = syllables(120, pause=(50, 80))
    whole, head = moved(*spoken, life=Life())
    for piece in (1, 7):
        curves, turned = moved(*spoken, life=Life(), piece=piece)
        np.testing.assert_allclose(curves, whole, atol=1e-6)
        np.testing.assert_allclose(turned, head, atol=1e-5)
    other, turned = moved(*spoken, life=Life(), seed=1)
    assert np.abs(other - whole).max() > 0.1 and np.abs(turned - head).max() > 0.3


def test_gaze_is_averted_within_long_phrases():
    level = np.full(1800, -20.0)
    zeros, speaking = np.zeros(1800), np.ones(1800, bool)
    measures = Measures(level, zeros, zeros + 40, zeros + 1, level)
    curves, _ = moved(measures, speaking, life=Life(blinks=0, brows=0, head=0))
    sideways = np.abs(curves[:, CONTROLS.index("CTRL_L_eye.tx")]) * 40
    away = sideways > 4.5
    assert 1 < (away[1:] & ~away[:-1]).sum() < 30  # in a minute without a pause


def test_motion_before_an_accent_does_not_depend_on_it():
    """The first accent is at frame 60, and known at 61: frames to 58 are without it."""
    measures, speaking = voice()
    accented, _ = moved(measures, speaking)
    calm, _ = moved(
        measures._replace(level=np.full(240, -20.0), sonority=np.full(240, -20.0)), speaking
    )
    np.testing.assert_array_equal(accented[:58], calm[:58])
    assert max(column(accented, s)[60:100].max() for s in ("brow_raiseIn", "brow_down")) > 0.1


def test_head_is_lowest_a_fifth_of_a_second_after_syllables_and_sinks_after_phrases():
    pitch = spoken_by(faces(8), 8, *syllables()).head[..., 1].mean(axis=0)
    beats = pitch[60:396].reshape(-1, 12).mean(axis=0)
    assert 3 <= beats.argmin() <= 8 and np.ptp(beats) > 0.4
    assert pitch[412:426].min() < pitch[60:396].mean() - 0.1
    assert pitch[480:498].mean() > pitch[412:426].mean() + 0.3, "ready for the next phrase"


def test_blinks_come_as_often_as_in_a_whole_take_and_gather_at_ends_of_phrases():
    lid, begins = CONTROLS.index("CTRL_L_eye_blink.ty"), np.zeros(1800)
    motion = spoken_by(faces(8, Life(head=0)), 8, *syllables(1800, pause=(900, 960)))
    for stream in range(8):
        closed = shown(motion, stream)[:, lid] > 0.4
        begins[1 : len(closed)] += closed[1:] & ~closed[:-1]
    assert 10 <= begins.sum() / 8 <= 26, "a minute"
    assert begins[904:914].mean() > 2 * begins[60:900].mean()


def test_eyes_turn_to_another_place_within_a_fifth_of_a_second():
    """Without motion of their own they are where the listener is: ahead, then 20 degrees left."""
    still = Life(blinks=0, gaze=0, head=0, brows=0)
    stream, given = MotionStreams([Character(Seeds((0, 0, 0)), still)]), []
    stream.look_at(0, (20.0, 0.0, 65.0), 140)
    for _ in range(0, 210, 7):
        given.append(played(stream, np.ones(7, bool))[0])
    faces = np.concatenate(given)
    eyes = np.abs(faces[:, np.abs(faces).max(axis=0).argmax()])
    assert not faces[:140].any()
    assert (np.diff(eyes[139:146]) > 0).all() and abs(eyes[145] - eyes[-1]) < 1e-6 < 0.1 < eyes[-1]


def test_streams_side_by_side_move_as_each_alone():
    """Of other voices, seeds, factors and emotions; one began 20 frames before the others."""
    lives = [Life(), Life(head=0.5, brows=1.5), Life(blinks=0, look_at=(5.0, 0.0, 80.0))]
    mixture = np.zeros((3, 90, len(LABELS)), np.float32)
    for k, emotion in enumerate(("happy", "sad", "angry")):
        mixture[k, :, LABELS.index(emotion)] = 0.8
    spoken = [syllables(240, pause=(60, 80 + 10 * k)) for k in range(3)]
    who = [Character(Seeds((0, 0, k)), life) for k, life in enumerate(lives)]
    together = MotionStreams(who)
    together.move(spoken[1][1][None, :20], mixture[1:2, :20], np.array([1]))
    found = [cues(*one) for one in spoken]
    joined = [part._replace(stream=part.stream + k) for k, part in enumerate(found)]
    together.cue(Cues.joined(joined))
    rows = np.stack([one[1][:90] for one in spoken])
    motion = together.move(rows, mixture)
    for k in range(3):
        alone = MotionStreams(who[k : k + 1])
        if k == 1:
            alone.move(spoken[1][1][None, :20], mixture[1:2, :20])
        alone.cue(found[k])
        one = alone.move(rows[k : k + 1], mixture[k : k + 1])
        for ours, theirs in zip(motion.tracks, one.tracks, strict=True):
            np.testing.assert_allclose(ours[k], theirs[0], atol=1e-9)
        np.testing.assert_allclose(motion.head[k], one.head[0], atol=1e-6)
    assert motion.head.std(axis=1).max() > 0.1


def test_a_stream_that_begins_again_moves_as_at_first():
    measures, speaking = syllables(240, pause=(60, 80))
    who, calm = Character(Seeds((0, 0, 3))), np.zeros((2, 120, len(LABELS)), np.float32)
    found, rows = cues(measures, speaking), np.tile(speaking[:120], (2, 1))
    streams = MotionStreams([Character(Seeds((0, 0, 9))), who])
    streams.cue(found._replace(stream=found.stream + 1))
    first = streams.move(rows, calm)
    streams.reset(1, who)
    streams.cue(found._replace(stream=found.stream + 1))
    again = streams.move(rows, calm)
    for ours, theirs in zip(first.tracks, again.tracks, strict=True):
        np.testing.assert_array_equal(ours[1], theirs[1])
    assert not np.array_equal(first.tracks.gaze[0], again.tracks.gaze[0])


def test_a_listener_nods_at_the_ends_of_the_others_phrases():
    silent, calm = np.zeros((16, 600), bool), np.zeros((16, 600, len(LABELS)), np.float32)
    hearing, deaf = faces(16), faces(16)
    hearing.hear(to_each(cues(*syllables(600, pause=(300, 330))), 16))
    with_it, without = (each.move(silent, calm).head[..., 1] for each in (hearing, deaf))
    pitch = (with_it - without).mean(axis=0)
    assert not pitch[:300].any()
    assert pitch[306:330].min() < -0.8, "lowest 0.2 to 0.7 s after the end is known"


def test_cues_of_streams_side_by_side_are_those_of_each_alone_in_any_pieces():
    voices = [voice(), syllables(240, pause=(100, 140)), syllables(240, every=9, pause=(30, 200))]
    rows = Measures(*(np.stack(tracks) for tracks in zip(*(v[0] for v in voices), strict=True)))
    speaking = np.stack([v[1] for v in voices])
    running = RunningCues(AHEAD)
    state, parts, at = running.first(3), [], 0
    for size in (1, 50, 3, 186):
        part = slice(at, at + size)
        new, state = running(Measures(*(t[:, part] for t in rows)), speaking[:, part], state)
        parts.append(new)
        at += size
    found = Cues.joined(parts)
    for k, spoken in enumerate(voices):
        mine, alone = found.where(found.stream == k), cues(*spoken)
        assert len(alone.time) > 3
        for ours, theirs in zip(mine[1:], alone[1:], strict=True):
            np.testing.assert_array_equal(ours, theirs)
