"""Accents, phrases and questions of a made voice."""

import numpy as np
import pytest

from deitalk.audio.prosody import Prosody, measure_prosody
from deitalk.audio.voice_activity import speech_activity
from deitalk.postprocess.life.character import ASYMMETRY, Seeds, Traits
from deitalk.postprocess.life.voice import ACCENT_DISTANCE, ACCENTS_PER_SECOND, measure_voice


def buzz(pitch, level):
    """A pulse-like voice: pitch in Hz and linear level of each sample."""
    phase = np.cumsum(pitch / 16_000)
    return (level * sum(np.sin(2 * np.pi * k * phase) / k for k in range(1, 12))).astype("f4")


def voice_of(pitch, level):
    waveform = buzz(pitch, level)
    n_frames = len(waveform) * 30 // 16_000
    activity = np.interp(np.arange(n_frames), np.arange(len(level)) * 30 / 16_000, level) > 0.01
    return measure_voice(activity.astype("f4"), measure_prosody(waveform, n_frames))


def test_accents_are_where_level_and_pitch_peak_and_the_strongest_are_kept():
    """Of five syllables in 9 s of speech those that stand out most, four at most."""
    time = np.arange(9 * 16_000) / 16_000
    at, tall = [1.0, 2.8, 4.6, 6.4, 8.1], [1.0, 0.8, 0.15, 0.9, 0.7]
    stress = sum(h * np.exp(-(((time - a) / 0.12) ** 2)) for a, h in zip(at, tall, strict=True))
    voice = voice_of(120 * 2 ** (stress / 3), 0.05 + 0.2 * stress)
    frames = [accent.frame for accent in voice.accents]
    assert frames == pytest.approx([30, 84, 192, 243], abs=2)
    assert all(0 < accent.strength <= 1 for accent in voice.accents)


@pytest.mark.parametrize("seconds", [6, 20])
def test_accents_are_few_and_apart(seconds):
    """Syllables of five strengths, three a second."""
    time = np.arange(seconds * 16_000) / 16_000
    tall = np.tile([1.0, 0.2, 0.6, 0.4, 0.8], seconds)[: 3 * seconds]
    stress = sum(h * np.exp(-(((time - (k + 0.5) / 3) / 0.07) ** 2)) for k, h in enumerate(tall))
    voice = voice_of(120 * 2 ** (stress / 3), 0.03 + 0.2 * stress)
    frames = np.array([accent.frame for accent in voice.accents])
    assert 0.2 * seconds <= len(frames) <= np.ceil(ACCENTS_PER_SECOND * seconds)
    assert np.diff(frames).min() >= ACCENT_DISTANCE
    assert np.mean(tall[np.clip(frames // 10, 0, len(tall) - 1)]) > 0.75


def test_stresses_are_syllables_and_stronger_where_they_rise_further():
    time = np.arange(3 * 16_000) / 16_000
    at, tall = [0.5, 0.9, 1.3, 1.7, 2.1, 2.5], [0.5, 0.1, 0.5, 0.1, 0.5, 0.1]
    syllables = sum(h * np.exp(-(((time - a) / 0.07) ** 2)) for a, h in zip(at, tall, strict=True))
    voice = voice_of(np.full(len(time), 120.0), 0.02 + 0.4 * syllables)
    assert [stress.frame for stress in voice.stresses] == pytest.approx(np.multiply(at, 30), abs=1)
    strengths = [stress.strength for stress in voice.stresses]
    assert min(strengths[::2]) > 1.5 * max(strengths[1::2])


@pytest.mark.parametrize(("end", "is_question"), [(1.6, True), (0.8, False), (1.0, False)])
def test_final_rise_is_a_question(end, is_question):
    time = np.arange(2 * 16_000) / 16_000
    pitch = 140 * np.interp(time, [0, 1.4, 2], [1, 0.95, end])
    voice = voice_of(pitch, np.full(len(time), 0.1))
    assert [phrase.is_question for phrase in voice.phrases] == [is_question]


@pytest.mark.parametrize("flaw", ["jump", "fragments"])
def test_pitch_found_in_a_creaking_end_is_no_question(flaw):
    """Statements whose last voiced frames have twice the pitch, or stand alone."""
    frames = 90
    pitch, voiced = np.linspace(6, 3, frames), np.ones(frames, bool)
    voiced[-5:] = False
    glide = pitch.copy()
    glide[-20:-5] += np.linspace(0, 7, 15)
    if flaw == "jump":
        pitch[-11:-5] += 7
    else:
        pitch = glide.copy()
        voiced[[-13, -10, -8]] = False
    calm = np.full(frames, 0.1)
    activity = np.r_[np.zeros(5), np.ones(frames - 5)].astype("f4")
    for track, mask, is_question in ((glide, voiced | (glide != 0), True), (pitch, voiced, False)):
        mask = mask & (np.arange(frames) < frames - 5)
        prosody = Prosody(calm, calm, calm, track, *2 * [mask.astype(float)], np.ones((frames, 26)))
        assert [p.is_question for p in measure_voice(activity, prosody).phrases] == [is_question]


def test_short_gaps_do_not_part_phrases():
    level = np.full(4 * 16_000, 0.1)
    level[16_000 : 16_000 + 2000] = 0  # 0.125 s
    level[40_000:48_000] = 0  # 0.5 s
    voice = voice_of(np.full(len(level), 130.0), level)
    assert [tuple(phrase[:2]) for phrase in voice.phrases] == [(0, 75), (90, 120)]
    assert list(voice.pauses()) == [(75, 90)]
    assert voice.speaking.sum() == 105


def test_silence_has_no_events():
    activity = speech_activity(np.zeros(32_000, np.float32))
    voice = measure_voice(activity, measure_prosody(np.zeros(32_000, np.float32), len(activity)))
    assert voice.accents == voice.phrases == voice.stresses == ()
    assert list(voice.pauses()) == [(0, 60)]


def test_seeds_follow_sound_actor_and_number():
    sound = np.sin(np.arange(1000, dtype=np.float32))
    first = Seeds.of(sound, "anna", 0)
    assert first == Seeds.of(sound.copy(), "anna", 0)
    others = [
        Seeds.of(sound * 0.9, "anna", 0),
        Seeds.of(sound, "ben", 0),
        Seeds.of(sound, "anna", 1),
    ]
    assert len({seeds.key("blinks") for seeds in (first, *others)}) == 4
    assert first.key("blinks") != first.key("gaze")


def test_character_is_the_same_in_two_recordings_of_an_actor():
    sounds = [np.full(500, level, np.float32) for level in (0.1, 0.2)]
    named = [Traits.of(Seeds.of(sound, "anna", 0).character()) for sound in sounds]
    nobody = [Traits.of(Seeds.of(sound, "", 0).character()) for sound in sounds]
    assert named[0] == named[1]
    assert nobody[0] != nobody[1]
    assert 2 / 3 * ASYMMETRY <= abs(named[0].side) <= ASYMMETRY
