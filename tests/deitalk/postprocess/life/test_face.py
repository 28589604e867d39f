"""Brows, lids, cheeks, smiles and sneers: accents on prominence, a neutral face that is alive."""

import csv

import numpy as np
import pytest
from scipy.signal import find_peaks

from deitalk.audio.load import load_audio
from deitalk.emotions import LABELS
from deitalk.pipeline.speech import Speech
from deitalk.postprocess.life.amounts import Life
from deitalk.postprocess.life.character import Seeds
from deitalk.postprocess.life.face import STEMS, Face, FaceTracks
from deitalk.postprocess.life.motion import plan_motion
from deitalk.postprocess.life.voice import Accent, Phrase, Voice, measure_voice
from deitalk.postprocess.tracks import MOTION, MotionTracks
from deitalk.research.evaluation.prominence import find_syllables
from rig import RigCurves, default_controls
from rig.controls import DEFAULT_ID
from rig.conversion.arkit import raw_to_arkit
from tests.deitalk.postprocess.stages import Stages

CONTROLS = default_controls()
STAGES = Stages(CONTROLS)
ONE, FIRST = np.arange(1), np.zeros(1, int)
K = len(STEMS)


def face_of(seed=0, side=0.0):
    key = np.array([Seeds((0, 0, seed)).key("face")], np.uint64)
    return Face(key, np.array([side]), np.ones(1))


def events(voice, seed=0, talks=1.0, **who):
    """Tracks of a take, in whose talk nothing comes by itself to the brows."""
    face = face_of(seed, **who)
    face.cue(voice.cues())
    found = face.play(ONE, FIRST, np.full((1, voice.n_frames), talks))
    return FaceTracks(*(track[0] for track in found))


def spoken(frames, accents=(), phrases=None):
    phrases = (Phrase(0, frames, False),) if phrases is None else phrases
    return Voice(frames, np.zeros(frames, np.float32), tuple(accents), tuple(phrases))


def stem(tracks, name, side=0):
    return tracks.gestures[:, side * K + STEMS.index(name)]


def played(voice, seed=0, emotion="neutral", strength=1.0, **life):
    """Curves of a face at rest."""
    mixture = np.zeros((voice.n_frames, len(LABELS)), np.float32)
    mixture[:, LABELS.index(emotion)] = strength
    motion = plan_motion(voice, mixture, Seeds((0, 0, seed)), life=Life(**life))
    curves = np.tile(CONTROLS.rest, (voice.n_frames, 1)).astype(np.float32)
    STAGES.play(curves, curves.copy(), motion.tracks)
    return RigCurves(curves, CONTROLS.names, control_set=DEFAULT_ID)


def reading(seconds=40):
    """Phrases of 3.4 s with pauses of 0.6 s, with one and two accents in turn."""
    frames = seconds * 30
    phrases = [Phrase(start + 9, start + 111, False) for start in range(0, frames - 119, 120)]
    places = [p.start + at for k, p in enumerate(phrases) for at in ((15, 81) if k % 2 else (40,))]
    accents = [Accent(frame, 0.3 + 0.7 * (k % 3) / 2) for k, frame in enumerate(places)]
    return spoken(frames, accents, phrases)


def test_brows_rise_in_150_to_400_ms_before_the_syllable_and_fall_more_slowly():
    lone = spoken(180, [Accent(90, 1.0)])
    for seed in range(40):
        track = events(lone, seed).accents.max(axis=1)
        assert track.max() > 0.5
        top = np.flatnonzero(track > 0.98 * track.max())
        rise, fall = np.flatnonzero(track > 0.02 * track.max())[[0, -1]]
        assert 84 <= top[0] <= 90, "at its height at the syllable's"
        assert 4 <= top[0] - rise <= 12 and fall - top[-1] > top[0] - rise


def test_every_syllable_that_stands_out_moves_the_brows_the_more_the_stronger():
    heights = [
        np.mean([events(spoken(180, [Accent(90, size)]), k).accents.max() for k in range(40)])
        for size in (0.1, 0.5, 1.0)
    ]
    assert heights[0] > 0.25 and heights[0] < 0.8 * heights[1] < 0.8**2 * heights[2]


def test_a_neutral_face_raises_most_accents_and_knits_the_others():
    kinds = [events(spoken(120, [Accent(60, 1.0)]), seed) for seed in range(200)]
    raises = np.array([np.ptp(stem(one, "brow_raiseIn")) > 0.2 for one in kinds])
    knits = np.array([np.ptp(stem(one, "brow_down")) > 0.15 for one in kinds])
    assert (raises != knits).mean() > 0.9 and 0.5 < raises.mean() < 0.8


def test_an_expression_is_held_in_silence_as_in_speech_and_rises_on_accents():
    """A calm face with a pose of .5: without accents it is .5 in silence, under it in speech."""
    rest = np.tile(CONTROLS.rest, (90, 1)).astype(np.float32)
    inner = [CONTROLS.index(f"CTRL_{side}_brow_raiseIn.ty") for side in "LR"]
    mixture = np.zeros((90, len(LABELS)), np.float32)
    motion = plan_motion(spoken(90), mixture, Seeds((0, 0, 0)))
    tracks = motion.tracks._replace(side=0 * motion.tracks.side, gestures=np.zeros((90, 2 * K)))

    def shown(accents, spoken):
        curves = rest.copy()
        curves[:, inner] = 0.5
        tracks_of = tracks._replace(accents=np.full((90, 2), accents))
        STAGES.play(curves, rest.copy(), tracks_of, spoken)
        return curves[:, inner].mean()

    assert shown(0.0, 0.0) == pytest.approx(0.5) == shown(0.2, 1.0)
    assert shown(0.0, 1.0) < 0.5 < shown(1.0, 1.0)


def test_a_few_accents_are_of_one_side_more_often_the_stronger():
    """Sides of the others differ by no more than the character's and the event's difference."""
    lone = spoken(120, [Accent(60, 1.0)])
    sides = np.array([events(lone, seed, side=0.12).accents.max(axis=0) for seed in range(400)])
    sides = -np.log(1 - sides)  # before they saturate
    ratio = sides.min(axis=1) / sides.max(axis=1)
    alone = ratio < 0.4
    assert 0.06 < alone.mean() < 0.18
    assert ratio[~alone].min() > 0.7
    assert 0.55 < (sides[alone, 0] > sides[alone, 1]).mean() < 0.85


def test_brows_knit_before_some_phrases_in_thought():
    voice = spoken(330, (), [Phrase(30, 120, False), Phrase(150, 270, False)])
    knit = []
    for seed in range(80):
        track = stem(events(voice, seed), "brow_down")
        if np.ptp(track) > 0.08:
            knit.append(track.argmax())
    assert 0.2 < len(knit) / 80 < 0.5
    assert all(120 < top <= 150 for top in knit), "in the pause, before the phrase"


def test_question_lifts_the_brows():
    voice = spoken(200, (), [Phrase(30, 150, True)])
    track = stem(events(voice), "brow_raiseIn")
    assert track[146:152].max() > 0.15 and np.abs(track[:100]).max() < 0.05


def test_a_gesture_moves_what_its_row_says_and_yields_to_an_emotion():
    gestures, ones = np.zeros((4, 2 * K)), np.ones((4, 1))
    gestures[:, STEMS.index("brow_down")] = 0.2
    gestures[:, K + STEMS.index("brow_down")] = 0.1
    mixture = np.zeros((4, len(LABELS)))
    mixture[2:, LABELS.index("happy")] = (0.5, 1.0)
    tracks = MotionTracks(*(np.zeros((4, width)) for width in MOTION))
    tracks = tracks._replace(gestures=gestures, amount=ones, mixture=mixture)
    curves = np.tile(CONTROLS.rest, (4, 1)).astype(np.float32)
    STAGES.play(curves, curves.copy(), tracks)
    left, right = (curves[:, CONTROLS.index(f"CTRL_{s}_brow_down.ty")] for s in "LR")
    assert left == pytest.approx([0.2, 0.2, 0.115, 0.03], abs=1e-6)
    assert right == pytest.approx(left / 2, abs=1e-6)


# What people do: ranges (95th less 5th percentile), speeds and shares of stillness of five captured
# takes, see docs/life.md.
PEOPLE = [
    ("BrowInnerUp", 0.10, 0.30, 0.9, 0.35),
    ("BrowDownLeft", 0.10, 0.35, 1.1, 0.35),
    ("EyeSquintLeft", 0.12, 0.45, 1.2, 0.25),
    ("MouthSmileLeft", 0.12, 0.35, 1.0, 0.35),
    ("NoseSneerLeft", 0.05, 0.25, 0.8, 0.5),
]


@pytest.mark.parametrize("seed", range(6))
def test_a_neutral_face_is_alive_and_mostly_still(seed):
    shapes = raw_to_arkit(played(reading(), seed, blinks=0, gaze=0)).curves
    for name, least, most, fastest, still in PEOPLE:
        low, high = np.percentile(shapes[name], (5, 95))
        speed = 30 * np.abs(np.diff(shapes[name]))
        assert least <= high - low <= most, name
        assert np.percentile(speed, 95) <= fastest, name
        assert (speed < 0.06).mean() >= still, name


@pytest.mark.parametrize("seed", range(4))
def test_squint_and_cheek_come_with_a_smile(seed):
    curves = played(reading(), seed, blinks=0)
    smile, cheek, squint = (
        curves[f"CTRL_L_{name}.ty"]
        for name in ("mouth_cornerPull", "eye_cheekRaise", "eye_squintInner")
    )
    smiles = smile > 0.1
    assert 0.05 < smiles.mean() < 0.6
    assert cheek[smiles].min() > 0.04
    assert squint[smiles].mean() > 1.15 * squint[~smiles].mean()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("emotion", ["neutral", "angry", "happy", "sad", "surprised"])
def test_brows_peak_at_most_five_times_in_ten_seconds_of_reading(emotion, seed):
    curves = played(reading(), seed, emotion, blinks=0)
    brows = sum(curves[f"CTRL_{s}_brow_{n}.ty"] for s in "LR" for n in ("raiseIn", "down")) / 2
    assert 1.5 <= len(find_peaks(brows, prominence=0.1)[0]) / 4 <= 5


@pytest.mark.parametrize("seed", range(4))
def test_a_listening_face_is_never_frozen(seed):
    """Frames in which no control of the board moves by .06 a second: 5 % at most."""
    silence = Voice(900, np.zeros(900, np.float32), (), ())
    values = played(silence, seed).values
    assert (np.abs(np.diff(values, axis=0)).max(axis=1) < 0.002).mean() <= 0.05


@pytest.mark.parametrize("emotion", ["angry", "happy", "sad", "surprised"])
def test_seeds_change_an_emotion_less_than_its_strength_does(emotion):
    """The mean pose above the mouth of 12 seeds: a step of .15 of strength is larger."""
    upper = [CONTROLS.index(f"CTRL_{s}_{name}.ty") for s in "LR" for name in STEMS[:6]]

    def size(seed, strength):
        curves = np.tile(CONTROLS.rest, (300, 1)).astype(np.float32)
        curves[:, upper] = 0.5 * strength
        neutral = np.tile(CONTROLS.rest, (300, 1)).astype(np.float32)
        mixture = np.zeros((300, len(LABELS)), np.float32)
        mixture[:, LABELS.index(emotion)] = strength
        motion = plan_motion(reading(10), mixture, Seeds((0, 0, seed)))
        STAGES.play(curves, neutral, motion.tracks)
        return np.linalg.norm(curves[:, upper], axis=1).mean()

    calm, strong = (np.array([size(seed, s) for seed in range(12)]) for s in (0.7, 0.85))
    assert (strong[:, None] > calm).mean() > 0.97


def test_accents_lie_on_prominent_syllables_of_readers(shared):
    """Correlation over syllables of an accent's being there with the prominence, mean of readers."""
    folder = shared / "data/speech"
    with (folder / "librispeech.tsv").open() as table:
        rows = list(csv.DictReader(table, delimiter="\t"))
    files = sorted((folder / "librispeech").glob("*-0000.mp3"))[:20:2]
    assert rows and len(files) >= 8
    found, rates = [], []
    for path in files:
        speech = Speech.of_recording(load_audio(path))
        voice = measure_voice(speech.activity, speech.prosody)
        accents = np.array([accent.frame for accent in voice.accents]) / 30
        found.append(find_syllables(speech.waveform).r(accents))
        rates.append(10 * len(voice.accents) / (voice.n_frames / 30))
    assert np.mean(found) >= 0.5 and np.mean(rates) <= 5
