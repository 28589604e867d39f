"""Level, pitch, brightness and bands of synthetic voices."""

import numpy as np
import pytest

from deitalk.audio.prosody import (
    BAND_EDGES_HZ,
    level_db,
    measure_prosody,
)
from deitalk.research.evaluation.contours import prosody_index

RATE = 16_000


def voice(pitch_hz: float = 120.0, fall: float = 2.0, seconds: float = 3.0) -> np.ndarray:
    """Harmonics whose amplitude falls with their number to some power, in syllables of 0.35 s."""
    t = np.arange(round(seconds * RATE)) / RATE
    numbers = np.arange(1, int(7000 / pitch_hz))[:, None]
    tone = (np.sin(2 * np.pi * pitch_hz * numbers * t) / numbers**fall).sum(axis=0)
    floor = 1e-5 * np.random.default_rng(0).standard_normal(len(t))
    return (0.1 * tone * (np.mod(t, 0.5) < 0.35) + floor).astype(np.float32)


def test_level_is_mean_power_within_the_window():
    square = np.where(np.arange(1600) % 2, 0.5, -0.5).astype(np.float32)  # power 1/4
    level = level_db(square, np.array([0, 800, 1600]))
    np.testing.assert_allclose(level, 10 * np.log10([1 / 8, 1 / 4, 1 / 8]), atol=1e-6)
    np.testing.assert_allclose(level_db(square, np.array([1595]), 20), 10 * np.log10(3 / 16))
    np.testing.assert_allclose(level_db(0 * square, np.array([800])), -100)


def test_pitch_in_semitones_over_100_hz():
    measured = measure_prosody(voice(150.0), 90)
    assert measured.voiced.sum() > 45
    expected = 12 * np.log2(150 / 100)
    np.testing.assert_allclose(np.median(measured.pitch[measured.voiced]), expected, atol=0.15)


def test_tilt_of_two_tones_is_their_ratio():
    """10 dB apart."""
    t = np.arange(2 * RATE) / RATE
    tones = 0.1 * np.sin(2 * np.pi * 300 * t) + 0.1 / 10**0.5 * np.sin(2 * np.pi * 2100 * t)
    measured = measure_prosody(tones.astype(np.float32), 60)
    np.testing.assert_allclose(measured.tilt[5:55], -10, atol=0.05)


def test_measures_do_not_depend_on_the_piece_length(monkeypatch):
    waveform, found = voice(seconds=5), []
    for piece in (150, 37):
        monkeypatch.setattr("deitalk.audio.prosody.PIECE", piece)
        found.append(measure_prosody(waveform, 150))
    for a, b in zip(*found, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)


@pytest.mark.parametrize("gain", [0.01, 10.0])
def test_gain_does_not_change_the_index(gain):
    waveform = voice()
    waveform[RATE:] *= 0.5
    plain, scaled = measure_prosody(waveform, 90), measure_prosody(gain * waveform, 90)
    np.testing.assert_allclose(prosody_index(scaled), prosody_index(plain), atol=1e-3)


def test_power_of_a_tone_lies_in_the_band_around_it():
    t = np.arange(RATE) / RATE
    for hertz in (300, 1000, 4000):
        bands = measure_prosody(0.1 * np.sin(2 * np.pi * hertz * t).astype(np.float32), 30).bands
        place = int(bands[15].argmax())
        assert BAND_EDGES_HZ[place] - 8 <= hertz <= BAND_EDGES_HZ[place + 1] + 8
        assert bands[15, max(place - 1, 0) : place + 2].sum() > 0.999 * bands[15].sum()
