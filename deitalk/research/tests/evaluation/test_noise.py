"""Noise at a given level, and its spectrum."""

import numpy as np
import pytest

from deitalk.research.evaluation.noise import mix_at_level, pink_noise

RATE = 16_000


def test_mix_at_level_adds_noise_of_that_rms():
    speech = np.zeros(1000, np.float32)
    noise = np.array([3.0, -3.0, 3.0])  # repeated
    mixed = mix_at_level(speech, noise, -20.0)
    np.testing.assert_allclose(np.abs(mixed), 0.1, rtol=1e-6)
    np.testing.assert_allclose(mix_at_level(speech + 1, noise, -20.0) - 1, mixed, atol=1e-6)


@pytest.mark.parametrize(("noise", "level_db"), [(np.zeros(5), 0.0), (np.ones(5), -np.inf)])
def test_mix_at_level_copies_speech_without_noise(noise, level_db):
    speech = np.linspace(-1, 1, 7, dtype=np.float32)
    mixed = mix_at_level(speech, noise, level_db)
    np.testing.assert_array_equal(mixed, speech)
    assert mixed is not speech


def test_pink_noise_halves_its_power_in_each_octave_band_of_equal_width():
    power = np.abs(np.fft.rfft(pink_noise(10 * RATE, seed=3))) ** 2
    bands = [power[k : 2 * k].mean() for k in (500, 1000, 2000, 4000, 8000, 16_000, 32_000)]
    np.testing.assert_allclose(np.divide(bands[1:], bands[:-1]), 0.5, rtol=0.2)
    assert power[0] == pytest.approx(0, abs=1e-3)


def test_pink_noise_has_unit_rms_and_follows_its_generator():
    noise = pink_noise(RATE, np.random.default_rng(7))
    assert np.sqrt(np.mean(np.square(noise))) == pytest.approx(1, abs=1e-5)
    np.testing.assert_array_equal(noise, pink_noise(RATE, 7))
