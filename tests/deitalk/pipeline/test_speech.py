"""Speech before either product: gates, both readings, and intensity from voice and direction."""

from dataclasses import replace

import numpy as np
import pytest

from deitalk.acting import Acting
from deitalk.audio.load import load_audio, write_wav
from deitalk.audio.voice_activity import active_level_db, speech_activity
from deitalk.config.rules import VoiceIntensity
from deitalk.emotions import IntensityCurve
from deitalk.errors import AudioError
from deitalk.models.protocol import Tracks, neutral_and_acted
from deitalk.pipeline.speech import (
    EFFORT_SHARE,
    PHRASE_FRAMES,
    Speech,
    measure_intensities,
)
from deitalk.postprocess.feeling import felt_intensity
from deitalk.research.evaluation.benchmark_curves import speechlike


@pytest.fixture(scope="module")
def speech():
    silence = np.zeros(32_000, np.float32)
    return Speech.of(np.concatenate((silence, 0.1 * speechlike(3.0), silence)))


def tracks(speech, strength):
    rows = np.full(speech.n_frames, strength, np.float32)
    return Tracks(2 * rows - 1, rows)


@pytest.mark.parametrize("rest", [0.0, 0.5])
def test_mouth_is_shut_in_silence_and_a_share_of_the_expression_stays(speech, rest):
    share = speech.share(rest)
    assert speech.mouth[:30].max() == 0 and (share[:30] == np.float32(rest)).all()
    assert speech.mouth[90:120].min() == share[90:120].min() == 1
    assert (Speech.of(speech.waveform, None).share(rest) == 1).all(), "without gates"


def test_sound_has_its_speech_at_the_level_of_the_training(speech):
    assert active_level_db(speech.sound, speech.activity) == pytest.approx(-23, abs=0.01)


def test_activity_of_a_recording_is_measured_once(tmp_path, speech, monkeypatch):
    write_wav(tmp_path / "a.wav", speech.waveform)
    calls = []

    def measured(waveform):
        calls.append(len(waveform))
        return speech_activity(waveform)

    for module in ("load", "voice_activity"):
        monkeypatch.setattr(f"deitalk.audio.{module}.speech_activity", measured)
    recording = load_audio(tmp_path / "a.wav")
    assert np.array_equal(Speech.of_recording(recording).activity, speech.activity)
    assert len(calls) == 1
    longer = replace(recording, waveform=np.concatenate([recording.waveform, np.zeros(16_000)]))
    assert len(Speech.of_recording(longer).activity) == len(speech.activity) + 30


@pytest.mark.parametrize("bad", [np.zeros(0), np.zeros((2, 9)), np.array([0, np.inf]), 1.0])
def test_speech_rejects_what_is_no_row_of_finite_samples(bad):
    with pytest.raises(AudioError, match="one row of finite samples at 16 kHz"):
        Speech.of(bad)


def test_applied_intensity_is_the_factor_times_the_predicted_one(speech):
    found = tracks(speech, 0.5)
    once, twice = (
        measure_intensities(speech, found, Acting.of(emotion="happy", intensity=k)) for k in (1, 2)
    )
    np.testing.assert_array_equal(once.applied, once.predicted)
    np.testing.assert_allclose(twice.applied, 2 * once.applied)
    np.testing.assert_allclose(twice.scale, 2 * once.scale)
    happy = Acting.of(emotion="happy").emotion_track.at(speech.times)
    felt = felt_intensity(once.voice, happy, VoiceIntensity())
    np.testing.assert_allclose(once.predicted, felt * speech.share(0.5), rtol=1e-6)
    assert once.predicted[0] == pytest.approx(0.5 * felt[0])
    quiet = measure_intensities(speech, found, Acting.of(emotion="happy", rest=0))
    assert quiet.predicted[:30].max() == 0 < quiet.predicted[100] == once.predicted[100]


def test_scale_is_one_where_the_network_predicts_what_is_applied(speech):
    curve = IntensityCurve(np.zeros(1), np.array([0.5]))
    found = measure_intensities(
        speech, tracks(speech, 0.5), Acting.of(emotion="sad", intensity_curve=curve)
    )
    np.testing.assert_array_equal(found.applied, np.float32(0.5))  # also where nobody speaks
    np.testing.assert_allclose(found.scale, 1)
    np.testing.assert_array_equal(found.share, 1)
    np.testing.assert_array_equal(found.saliency, 0)


def test_neutral_weights_are_read_once():
    neutral = np.tile(np.eye(5, dtype=np.float32)[0], (4, 1))
    happy = np.tile(np.eye(5, dtype=np.float32)[2], (4, 1))
    (alone,) = neutral_and_acted(neutral)
    np.testing.assert_array_equal(alone, neutral)
    for found, expected in zip(neutral_and_acted(happy), (neutral, happy), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_keyframes_are_shown_in_silence_as_drawn(speech):
    keyed = Acting.of(emotion="time,emotion,strength\n0,neutral,1\n1,happy,1\n")
    found = measure_intensities(speech, tracks(speech, 0.5), keyed)
    np.testing.assert_array_equal(found.share, 1)
    weights = keyed.emotion_track.at(speech.times)
    felt = felt_intensity(found.voice, weights, VoiceIntensity())
    np.testing.assert_allclose(found.applied, felt, rtol=1e-6)
    assert found.applied[0] == pytest.approx(felt[90:120].mean(), abs=0.15)


def test_strength_is_the_mean_of_prosody_and_readout(speech):
    """A constant readout moves the whole and every phrase by its share of the distance to it."""
    whole, _ = speech.strengths()
    with_it, near = speech.strengths(np.full(speech.n_frames, 6.0, np.float32))
    assert with_it == pytest.approx(whole + EFFORT_SHARE * (6 - whole))
    speaking = speech.activity > 0
    assert near[speaking].mean() == pytest.approx(with_it, abs=0.1)


@pytest.mark.parametrize("decibels", [9, -9])
@pytest.mark.parametrize("frames", [6, 20, 60])
def test_phrase_of_another_strength_has_its_own(decibels, frames):
    """Its mean is that of its readout, the less the shorter it is; within it little changes."""
    activity = np.zeros(180, np.float32)
    activity[10:80] = activity[100 : 100 + frames] = 1
    speech = Speech(0.1 * speechlike(6.0), activity)
    effort, plain = np.zeros((2, 180), np.float32)
    effort[90:] = decibels
    change = speech.strengths(effort)[1] - speech.strengths(plain)[1]
    whole = EFFORT_SHARE * decibels * frames / (70 + frames)
    first, second = change[10:80].mean(), change[100 : 100 + frames]
    step = EFFORT_SHARE * decibels
    share = frames / (frames + PHRASE_FRAMES)
    assert second.mean() == pytest.approx(whole + share * (step - whole), abs=1e-3)
    assert first == pytest.approx(whole - 70 / (70 + PHRASE_FRAMES) * whole, abs=1e-3)
    assert np.ptp(second) < 0.1 * abs(step)
