"""Prosody contours: the applied change is measured, and phones stay in time with the sound."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deitalk.audio.prosody import measure_prosody
from deitalk.research.evaluation.contours import (
    apply_contour,
    contour_at,
    prosody_index,
    random_contour,
)

RATE = 16_000


def tone(hz: float, seconds: float = 2.0, amplitude: float = 0.1) -> np.ndarray:
    return (amplitude * np.sin(2 * np.pi * hz * np.arange(int(seconds * RATE)) / RATE)).astype(
        np.float32
    )


def constant(z: float) -> tuple[np.ndarray, np.ndarray]:
    return np.array([0.0, 100.0]), np.array([z, z])


def level_db(waveform: np.ndarray) -> float:
    return 10 * np.log10(np.mean(waveform[800:-800].astype(np.float64) ** 2))


@pytest.mark.parametrize("z", [-1.0, 1.0])
def test_one_deviation_is_4_5_db_and_5_percent_of_time_and_pitch(z):
    waveform = tone(200)
    moved, (source, target) = apply_contour(waveform, constant(z))
    assert level_db(moved) - level_db(waveform) == pytest.approx(4.5 * z, abs=0.3)
    assert len(moved) / len(waveform) == pytest.approx(1 / (1 + 0.05 * z), rel=1e-3)
    spectrum = np.abs(np.fft.rfft(moved * np.hanning(len(moved)), 1 << 18))
    peak = spectrum.argmax() * RATE / (1 << 18)
    assert peak == pytest.approx(200 * (1 + 0.05 * z), rel=2e-3)
    assert (target[-1] - target[0]) / (source[-1] - source[0]) == pytest.approx(1 / (1 + 0.05 * z))


def test_identity_contour_keeps_the_waveform():
    rng = np.random.default_rng(0)
    spectrum = np.fft.rfft(rng.standard_normal(2 * RATE))
    spectrum[np.fft.rfftfreq(2 * RATE, 1 / RATE) > 6500] = 0
    waveform = np.fft.irfft(spectrum)
    waveform = (0.5 * waveform / np.abs(waveform).max()).astype(np.float32)
    same, (source, target) = apply_contour(waveform, constant(0.0))
    assert abs(len(same) - len(waveform)) <= 1
    inner = slice(400, len(waveform) - 400)
    error = np.sqrt(np.mean((same[inner] - waveform[inner]) ** 2) / np.mean(waveform[inner] ** 2))
    assert 20 * np.log10(error) < -60
    np.testing.assert_allclose(source, target, atol=1e-9)


def test_full_scale_is_not_scaled_by_the_identity_and_nothing_clips():
    waveform = tone(200, amplitude=0.999)
    same, _ = apply_contour(waveform, constant(0.0))
    assert np.abs(same).max() == pytest.approx(0.999, abs=2e-3)
    loud, _ = apply_contour(waveform, constant(2.0))
    assert np.abs(loud).max() == pytest.approx(0.99, abs=1e-6)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.4, 4.0))
def test_time_map_is_monotone_and_gives_the_time_of_a_click(seed, seconds):
    rng = np.random.default_rng(seed)
    contour = random_contour(seconds, rng)
    at = rng.uniform(0.2, 0.9) * seconds
    waveform = np.zeros(int(seconds * RATE), np.float32)
    waveform[round(at * RATE)] = 0.5
    moved, (source, target) = apply_contour(waveform, contour)
    assert (np.diff(target) > 0).all() and target[0] == 0
    assert source[-1] >= len(waveform) / RATE, "the map covers the clip"
    arrived = np.abs(moved).argmax() / RATE
    assert arrived == pytest.approx(np.interp(at, source, target), abs=2.5 / RATE)
    assert len(moved) / RATE == pytest.approx(
        np.interp(len(waveform) / RATE, source, target), abs=2 / RATE
    )


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 20))
def test_random_contours_are_centred_bounded_and_cover_the_clip(seed, seconds):
    times, z = random_contour(seconds, np.random.default_rng(seed))
    assert times[0] == 0 and times[-1] >= seconds and (np.diff(times) >= 0.7).all()
    assert z[times <= seconds].mean() == pytest.approx(0, abs=1e-9)
    assert np.ptp(z) <= 3.6 + 1e-9
    fine = contour_at((times, z), np.linspace(0, seconds, 500))
    assert fine.min() >= z.min() - 1e-9 and fine.max() <= z.max() + 1e-9
    np.testing.assert_allclose(contour_at((times, z), times), z, atol=1e-9)


def speechlike(rng: np.random.Generator, seconds: float = 4.0) -> np.ndarray:
    """A buzz of 120 Hz with three syllables a second."""
    t = np.arange(int(seconds * RATE)) / RATE
    buzz = sum(np.sin(2 * np.pi * 120 * k * t) / k for k in range(1, 30))
    syllables = np.clip(np.sin(2 * np.pi * 3 * t) + 0.7, 0, None)
    return (0.05 * buzz * syllables + 1e-4 * rng.standard_normal(len(t))).astype(np.float32)


def test_the_index_measures_what_a_contour_applied(rng):
    contour = (np.array([0.0, 1.5, 2.5, 4.1]), np.array([-1.2, -1.2, 1.2, 1.2]))
    moved, (source, target) = apply_contour(speechlike(rng), contour)
    n = int(len(moved) / RATE * 30)
    index = prosody_index(measure_prosody(moved, n))
    applied = contour_at(contour, np.interp(np.arange(n) / 30, target, source))
    assert np.corrcoef(index, applied)[0, 1] > 0.8
    assert index[applied > 0.8].mean() - index[applied < -0.8].mean() > 0.5
