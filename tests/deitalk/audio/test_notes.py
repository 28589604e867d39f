"""Warnings about recordings without usable speech: synthetic signals and a bundled recording."""

from pathlib import Path

import numpy as np
import pytest

from deitalk.audio.load import load_audio
from deitalk.audio.speech_warnings import describe
from deitalk.audio.voice_activity import active_level_db, noise_likeness, speech_activity

SPEECH = Path(__file__).resolve().parents[3] / "docs/samples" / "promise.flac"


@pytest.fixture(scope="module")
def speech() -> np.ndarray:
    return load_audio(SPEECH).waveform


def noise(rng, seconds: float, slope: float = 0.0) -> np.ndarray:
    """Gaussian noise of -20 dBFS whose power falls by f ** -slope."""
    spectrum = np.fft.rfft(rng.normal(size=round(16000 * seconds)))
    spectrum *= np.arange(1.0, len(spectrum) + 1) ** (-slope / 2)
    samples = np.fft.irfft(spectrum)
    return (0.1 * samples / samples.std()).astype(np.float32)


def at_level(speech: np.ndarray, level_db: float) -> np.ndarray:
    return speech * np.float32(10 ** ((level_db - active_level_db(speech)) / 20))


def test_speech_of_usual_level_has_no_notes(speech):
    for level_db in (-12, -23, -45):
        assert describe(at_level(speech, level_db)) == ()


@pytest.mark.parametrize("peak", [0.0, 1e-6, 3e-5])
def test_silence_has_a_note(rng, peak):
    (note,) = describe((peak * rng.uniform(-1, 1, 16000)).astype(np.float32))
    assert note.startswith("silence")


@pytest.mark.parametrize("slope", [-1.0, 0.0, 1.0, 2.0])
@pytest.mark.parametrize("seconds", [0.5, 3.0, 20.0])
def test_steady_noise_of_any_colour_is_no_speech(rng, slope, seconds):
    (note,) = describe(noise(rng, seconds, slope))
    assert note.startswith("no speech found, only steady sound (-")


def test_noise_of_varying_level_is_no_voice(rng):
    strength = np.repeat(rng.uniform(0, 1, 100), 1600).astype(np.float32)
    for slope in (0.0, 1.0):
        samples = noise(rng, 10.0, slope) * strength
        assert speech_activity(samples).any()
        (note,) = describe(samples)
        assert note.startswith("no voice found")


@pytest.mark.parametrize("snr_db", [20, 10, 5, 0])
def test_a_voice_in_noise_is_a_voice(speech, rng, snr_db):
    level = 10 ** ((active_level_db(speech) - snr_db) / 20)
    noisy = speech + level * noise(rng, len(speech) / 16000)[: len(speech)] / np.float32(0.1)
    assert describe(noisy.astype(np.float32)) == ()


def test_flatness_of_noise_is_the_theoretical_one(rng):
    samples = noise(rng, 20.0)
    everything = np.ones(600)
    # of an exponentially distributed power the geometric mean is exp(-0.577) of the mean
    assert noise_likeness(samples, everything) == pytest.approx(np.exp(-0.5772), abs=0.04)
    assert noise_likeness(samples, np.zeros(600)) == 0
    harmonics = sum(np.sin(2 * np.pi * 150 * k * np.arange(16000) / 16000) for k in range(1, 27))
    assert noise_likeness(0.02 * harmonics, np.ones(30)) < 0.2


def test_speech_at_minus_65_dbfs_is_very_quiet(speech):
    notes = describe(at_level(speech, -65))
    assert any("very quiet (-65 dBFS)" in note for note in notes)
