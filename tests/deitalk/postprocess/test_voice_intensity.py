"""Intensity of a voice: what the prosody corrects, and where it changes nothing."""

import numpy as np
import pytest

from deitalk.audio.vocal_strength import measure_prosody
from deitalk.audio.voice_activity import speech_activity
from deitalk.config.rules import VoiceIntensity
from deitalk.postprocess.voice_intensity import MOST_TAKE, take_z, voice_intensity
from tests.deitalk.audio.test_prosody import voice
from tests.each import each


def corrected(waveform: np.ndarray, network: np.ndarray, strength: float = 0.0) -> np.ndarray:
    prosody = measure_prosody(waveform, len(network))
    return voice_intensity(network, prosody, speech_activity(waveform), strength)


@each(("decibels", "base"), [(1.0, 0.1493), (5.0, 0.6766), (60.0, 1.3)])
def test_mean_of_a_take_is_that_of_its_strength(decibels, base):
    """0.15 deviations a decibel, 1.3 at most, whatever moves in the take."""
    loud = voice(seconds=6)
    loud[3 * 16_000 :] *= 3
    for waveform in (voice(), loud):
        frames = len(waveform) * 30 // 16_000
        rising = np.linspace(0.3, 0.9, frames).astype(np.float32)
        intensity = corrected(waveform, rising, decibels)
        mean = intensity[speech_activity(waveform) > 0].mean()
        assert mean == pytest.approx(0.15 + 0.85 / (1 + np.exp(-1.3 * base)), abs=1e-4)


def test_strength_is_that_around_each_frame():
    flat, rising = np.full(90, 0.5, np.float32), np.linspace(-6, 6, 90, dtype=np.float32)
    change = corrected(voice(), flat, rising) - corrected(voice(), flat)
    assert change[12] < -0.05 and change[72] > 0.05


def test_mean_of_the_network_over_a_take_is_not_used():
    """The same standard deviation more of liveliness everywhere: z = 0 is 0.575, 1 is 0.817."""
    usual, more = corrected(voice(), np.full(90, 0.575)), corrected(voice(), np.full(90, 0.8172))
    np.testing.assert_allclose(usual[10:75], more[10:75], atol=1e-4)
    rising = np.linspace(0.3, 0.8, 90)
    assert np.ptp(corrected(voice(), rising)[10:75]) > np.ptp(usual[10:75]) + 0.08


def test_louder_second_half_has_a_higher_intensity():
    """9.5 dB are 1.9 units of level, 1.7 deviations, half of which is about the mean around.

    From z = -0.43 to 0.43 the intensity rises from 0.46 to 0.69.
    """
    waveform = voice(seconds=6)
    waveform[3 * 16_000 :] *= 3
    intensity = corrected(waveform, np.full(180, 0.5, np.float32))
    assert 0.15 < intensity[110:160].mean() - intensity[20:70].mean() < 0.3


def test_whole_range_is_left_to_a_shouted_take():
    """A base at its limit, 1.3, and a variation of 0.43 deviations to either side: 0.79 to 0.92."""
    waveform = voice(seconds=6)
    waveform[3 * 16_000 :] *= 3
    intensity = corrected(waveform, np.full(180, 0.5, np.float32), 60.0)
    assert intensity[110:160].mean() - intensity[20:70].mean() > 0.1


def test_fast_changes_are_smoothed_and_the_mean_stays():
    tremble = (0.5 + 0.2 * (-1.0) ** np.arange(90)).astype(np.float32)
    steady = corrected(voice(), np.full(90, 0.5, np.float32))
    smoothed = corrected(voice(), tremble)
    assert np.abs(np.diff(smoothed - steady)[8:79]).max() < 0.01
    assert smoothed[8:80].mean() == pytest.approx(steady[8:80].mean(), abs=0.04)


def test_hiss_and_wrong_octaves_do_not_move_the_tone():
    """A frame of noise between voiced ones, bright and of any pitch, counts as the voice around."""
    prosody = measure_prosody(voice(), 90)
    hiss = prosody._replace(
        pitch=np.where(np.arange(90) % 10 == 5, prosody.pitch + 14, prosody.pitch),
        bright=np.where(np.arange(90) % 10 == 7, 1e3 * prosody.dark, prosody.bright),
    )
    on = np.ones(90, np.float32)
    flat = np.full(90, 0.5, np.float32)
    clean, other = (voice_intensity(flat, p, on) for p in (prosody, hiss))
    np.testing.assert_allclose(other, clean, atol=0.02)


def test_pause_relaxes_and_the_voice_is_awaited():
    """To 1/e of the way from rest 10 frames after the voice, and 5 before it; 0.15 is rest."""
    pause = np.zeros(3 * 16_000, np.float32)
    waveform = np.concatenate((voice(), pause, voice()))
    intensity = corrected(waveform, np.full(270, 0.5, np.float32))
    spoken = speech_activity(waveform) > 0
    last, first = np.flatnonzero(spoken[:135])[-1], 135 + np.flatnonzero(spoken[135:])[0]
    fall = (intensity[last + 10] - 0.15) / (intensity[last] - 0.15)
    rise = (intensity[first - 5] - 0.15) / (intensity[first] - 0.15)
    assert fall == pytest.approx(np.exp(-1), abs=0.02) and rise == pytest.approx(
        np.exp(-1), abs=0.02
    )
    assert intensity[(last + first) // 2] < 0.17
    assert np.abs(np.diff(intensity)).max() < 0.15, "no seam beside speech"


def test_intensity_around_speech_is_not_above_it():
    silence = np.zeros(32_000, np.float32)
    intensity = corrected(np.concatenate((silence, voice(), silence)), np.full(210, 0.9))
    spoken = intensity[60:150].max()
    assert intensity[:60].max() < spoken and intensity[155:].max() < spoken
    assert intensity[0] == pytest.approx(0.15, abs=1e-3)
    assert intensity[-1] < 0.25, "slower after the last of the voice than in a pause"


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
