"""Speech before either product: gates, both readings, and intensity from voice and direction."""

from dataclasses import replace

import numpy as np
import pytest

from deitalk.acting import Acting
from deitalk.audio.load import load_audio, write_wav
from deitalk.audio.voice_activity import active_level_db, speech_activity
from deitalk.emotions import IntensityCurve
from deitalk.errors import AudioError
from deitalk.models.protocol import Tracks, neutral_and_acted
from deitalk.pipeline.speech import EFFORT_SHARE, Speech, measure_intensities
from deitalk.research.evaluation.benchmark_curves import speechlike
from tests.each import each


@pytest.fixture(scope="module")
def speech():
    silence = np.zeros(32_000, np.float32)
    return Speech.of(np.concatenate((silence, 0.1 * speechlike(3.0), silence)))


def tracks(speech, strength):
    rows = np.full(speech.n_frames, strength, np.float32)
    return Tracks(2 * rows - 1, rows)


def test_gates_are_shut_in_silence_and_open_in_speech(speech):
    assert speech.mouth[:30].max() == speech.shown[:30].max() == 0
    assert speech.mouth[90:120].min() == speech.shown[90:120].min() == 1


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


@each("bad", [np.zeros(0), np.zeros((2, 9)), np.array([0, np.inf]), 1.0])
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
    np.testing.assert_array_equal(once.predicted, once.voice * speech.shown)
    assert once.predicted[:30].max() == 0 < once.predicted[100]


def test_scale_is_one_where_the_network_predicts_what_is_applied(speech):
    curve = IntensityCurve(np.zeros(1), np.array([0.5]))
    found = measure_intensities(
        speech, tracks(speech, 0.5), Acting.of(emotion="sad", intensity_curve=curve)
    )
    np.testing.assert_array_equal(found.applied, np.float32(0.5))  # also where nobody speaks
    open_ = speech.shown == 1
    np.testing.assert_allclose(found.scale[open_], 1)
    np.testing.assert_array_equal(found.saliency, 0)


def test_neutral_weights_are_read_once():
    neutral = np.tile(np.eye(5, dtype=np.float32)[0], (4, 1))
    happy = np.tile(np.eye(5, dtype=np.float32)[2], (4, 1))
    (alone,) = neutral_and_acted(neutral)
    np.testing.assert_array_equal(alone, neutral)
    for found, expected in zip(neutral_and_acted(happy), (neutral, happy), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_strength_is_the_mean_of_prosody_and_readout(speech):
    """A constant readout moves the whole and every frame by its share of the distance to it."""
    whole, around = speech.strengths()
    with_it, near = speech.strengths(np.full(speech.n_frames, 6.0, np.float32))
    assert with_it == pytest.approx(whole + EFFORT_SHARE * (6 - whole))
    speaking = speech.activity > 0
    assert near[speaking].mean() == pytest.approx(with_it, abs=1e-4)
    spread = (near - near[speaking].mean())[speaking]
    expected = (1 - EFFORT_SHARE) * (around - around[speaking].mean())[speaking]
    np.testing.assert_allclose(spread, expected, atol=1e-4)


def test_louder_readout_in_one_half_raises_that_half(speech):
    effort = np.zeros(speech.n_frames, np.float32)
    effort[speech.n_frames // 2 :] = 9
    _, near = speech.strengths(effort)
    _, plain = speech.strengths(np.zeros_like(effort))
    voiced = np.flatnonzero(speech.activity > 0)
    assert (near - plain)[voiced[-1]] > (near - plain)[voiced[0]] + 4
