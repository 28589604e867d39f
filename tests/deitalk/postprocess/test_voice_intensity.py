"""Intensity heard in a voice: what measurement adds, and where it must change nothing."""

import numpy as np
import pytest

from deitalk.audio.prosody import measure_prosody
from deitalk.audio.voice_activity import speech_activity
from deitalk.postprocess.voice_intensity import MOST_EFFORT, vocal_effort_z, voice_intensity
from tests.deitalk.audio.test_prosody import voice


def hear(waveform: np.ndarray, strength: np.ndarray) -> np.ndarray:
    prosody = measure_prosody(waveform, len(strength))
    return voice_intensity(strength, prosody, speech_activity(waveform))


def test_a_brighter_take_is_heard_livelier_everywhere():
    flat = np.full(90, 0.5, np.float32)
    soft, loud = hear(voice(fall=1.2), flat), hear(voice(fall=0.8), flat)
    assert (loud[5:80] > soft[5:80] + 0.03).all()


def test_what_the_network_says_of_a_take_as_a_whole_does_not_count():
    """The same standard deviation more of liveliness everywhere: z = 0 is 0.575, 1 is 0.817."""
    usual, more = hear(voice(), np.full(90, 0.575)), hear(voice(), np.full(90, 0.8172))
    np.testing.assert_allclose(usual[10:75], more[10:75], atol=1e-4)
    rising = np.linspace(0.3, 0.8, 90)
    assert np.ptp(hear(voice(), rising)[10:75]) > np.ptp(usual[10:75]) + 0.15


def test_the_second_half_of_a_voice_that_rises_is_livelier():
    waveform = voice(seconds=6)
    waveform[3 * 16_000 :] *= 3
    heard = hear(waveform, np.full(180, 0.5, np.float32))
    assert heard[100:170].mean() > heard[10:80].mean() + 0.05


def test_a_tremble_is_smoothed_and_its_mean_stays():
    tremble = (0.5 + 0.2 * (-1.0) ** np.arange(90)).astype(np.float32)
    steady = hear(voice(), np.full(90, 0.5, np.float32))
    smoothed = hear(voice(), tremble)
    assert np.abs(np.diff(smoothed[8:80])).max() < 0.02
    assert smoothed[8:80].mean() == pytest.approx(steady[8:80].mean(), abs=0.04)


def test_a_pause_goes_from_what_was_before_it_to_what_follows():
    pause = np.zeros(3 * 16_000, np.float32)
    waveform = np.concatenate((voice(), pause, voice()))
    strength = np.full(270, 0.3, np.float32)
    strength[100:170], strength[180:] = 0.95, 0.6  # a network may hear anything in silence
    heard = hear(waveform, strength)
    middle = heard[120:150]
    assert heard[60:75].mean() < middle[0] < middle[-1] < heard[195:210].mean()
    assert np.abs(np.diff(heard)).max() < 0.15, "no seam beside speech"


def test_silence_around_speech_is_no_livelier_than_it():
    silence = np.zeros(32_000, np.float32)
    strength = np.full(210, 0.9, np.float32)
    strength[60:150], strength[:20] = 0.4, 0.0
    heard = hear(np.concatenate((silence, voice(), silence)), strength)
    assert heard[25:50].max() < heard[75:135].max() + 0.05
    assert heard[170:].max() < heard[75:135].max() + 0.05
    np.testing.assert_array_equal(heard[:15], 0)


def test_silence_and_whispers_keep_the_network_s():
    strength = np.linspace(0, 1, 90, dtype=np.float32)
    np.testing.assert_array_equal(hear(np.zeros(48_000, np.float32), strength), strength)
    assert hear(np.zeros(0, np.float32), strength[:0]).shape == (0,)


def test_no_microphone_moves_a_take_further_than_the_limit():
    for fall in (0.2, 5.0):
        prosody = measure_prosody(voice(fall=fall), 90)
        assert abs(vocal_effort_z(prosody)) <= MOST_EFFORT
