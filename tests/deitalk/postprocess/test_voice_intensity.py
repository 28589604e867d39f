"""Intensity of a voice: what the prosody corrects, and where it changes nothing."""

import numpy as np
import pytest

from deitalk.audio.prosody import measure_prosody
from deitalk.audio.voice_activity import speech_activity
from deitalk.config import VoiceIntensity
from deitalk.postprocess.voice_intensity import MOST_TAKE, take_z, voice_intensity
from tests.deitalk.audio.test_prosody import voice


def corrected(waveform: np.ndarray, strength: np.ndarray, take: float = 0.0) -> np.ndarray:
    prosody = measure_prosody(waveform, len(strength))
    return voice_intensity(strength, prosody, speech_activity(waveform), take)


def test_stronger_take_has_a_higher_intensity_everywhere():
    """z = 1 in place of 0 multiplies the odds of the share above 0.15 by exp(1.3)."""
    flat = np.full(90, 0.5, np.float32)
    usual, strong = corrected(voice(), flat), corrected(voice(), flat, take=1.0)
    share = [(x[10:75] - 0.15) / 0.85 for x in (usual, strong)]
    odds = [s / (1 - s) for s in share]
    np.testing.assert_allclose(odds[1] / odds[0], np.exp(1.3), rtol=1e-3)


def test_mean_of_the_network_over_a_take_is_not_used():
    """The same standard deviation more of liveliness everywhere: z = 0 is 0.575, 1 is 0.817."""
    usual, more = corrected(voice(), np.full(90, 0.575)), corrected(voice(), np.full(90, 0.8172))
    np.testing.assert_allclose(usual[10:75], more[10:75], atol=1e-4)
    rising = np.linspace(0.3, 0.8, 90)
    assert np.ptp(corrected(voice(), rising)[10:75]) > np.ptp(usual[10:75]) + 0.15


def test_louder_second_half_has_a_higher_intensity():
    waveform = voice(seconds=6)
    waveform[3 * 16_000 :] *= 3
    intensity = corrected(waveform, np.full(180, 0.5, np.float32))
    assert intensity[100:170].mean() > intensity[10:80].mean() + 0.05


def test_fast_changes_are_smoothed_and_the_mean_stays():
    tremble = (0.5 + 0.2 * (-1.0) ** np.arange(90)).astype(np.float32)
    steady = corrected(voice(), np.full(90, 0.5, np.float32))
    smoothed = corrected(voice(), tremble)
    assert np.abs(np.diff(smoothed[8:80])).max() < 0.02
    assert smoothed[8:80].mean() == pytest.approx(steady[8:80].mean(), abs=0.04)


def test_intensity_in_a_pause_goes_from_before_to_after():
    pause = np.zeros(3 * 16_000, np.float32)
    waveform = np.concatenate((voice(), pause, voice()))
    strength = np.full(270, 0.3, np.float32)
    strength[100:170], strength[180:] = 0.95, 0.6  # a network may predict anything in silence
    intensity = corrected(waveform, strength)
    middle = intensity[120:150]
    assert intensity[60:75].mean() < middle[0] < middle[-1] < intensity[195:210].mean()
    assert np.abs(np.diff(intensity)).max() < 0.15, "no seam beside speech"


def test_intensity_around_speech_is_not_above_it():
    silence = np.zeros(32_000, np.float32)
    strength = np.full(210, 0.9, np.float32)
    strength[60:150], strength[:20] = 0.4, 0.0
    intensity = corrected(np.concatenate((silence, voice(), silence)), strength)
    assert intensity[25:50].max() < intensity[75:135].max() + 0.05
    assert intensity[170:].max() < intensity[75:135].max() + 0.05
    np.testing.assert_array_equal(intensity[:15], 0)


def test_intensity_without_voiced_speech_is_the_network_s():
    strength = np.linspace(0, 1, 90, dtype=np.float32)
    np.testing.assert_array_equal(corrected(np.zeros(48_000, np.float32), strength), strength)
    assert corrected(np.zeros(0, np.float32), strength[:0]).shape == (0,)


def test_take_rises_with_strength_and_stays_within_its_limit():
    rule = VoiceIntensity(strength_weight=0.5)
    assert take_z(0.0, rule) == 0
    assert take_z(0.02, rule) == pytest.approx(0.01, rel=1e-3)
    values = [take_z(s, rule) for s in (-100.0, -1.0, 0.5, 2.0, 5.0, 8.0, 100.0)]
    assert values == sorted(values) and len(set(values[1:-1])) == 5
    assert max(map(abs, values)) <= MOST_TAKE
