"""Augmentations of SDFA §4.3: what each keeps, and how much it changes the rest."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from deitalk.audio.mel import MelSpectrogram
from deitalk.research.meshes.augmentation import (
    SILENCE,
    add_noise,
    pre_emphasise,
    scale_bins,
    stretch_time,
    zero_bins,
)

RATE = 16_000


def tone(seconds=2.0):
    return np.sin(2 * np.pi * 220 * np.arange(int(seconds * RATE)) / RATE).astype(np.float32)


def ramp(n_mels=16, width=24):
    """Value 100 f + l at bin f of spectrum l."""
    return 100.0 * torch.arange(n_mels)[:, None] + torch.arange(width, dtype=torch.float32)


def test_silence_is_what_the_spectrogram_gives():
    mel = MelSpectrogram(0.064, 125, 128)(torch.zeros(1, RATE), 3)
    torch.testing.assert_close(mel[0, 0], torch.full((128, 3), SILENCE))


@pytest.mark.parametrize("pink", [False, True])
@pytest.mark.parametrize("snr_db", [5.0, 30.0])
def test_noise_has_the_given_level(rng, pink, snr_db):
    x = tone()
    noise = add_noise(x, snr_db, rng, pink=pink) - x
    assert 10 * np.log10(np.mean(x**2) / np.mean(noise**2)) == pytest.approx(snr_db, abs=0.05)


def test_pink_noise_falls_by_three_decibels_an_octave_and_white_does_not(rng):
    x = tone(20)
    for pink, expected in ((False, 0.0), (True, -3.01)):
        noise = add_noise(x, 0, rng, pink=pink) - x
        frequency, power = signal.welch(noise, RATE, nperseg=2048)
        used = (frequency > 60) & (frequency < 7000)
        slope = np.polyfit(np.log2(frequency[used]), 10 * np.log10(power[used]), 1)[0]
        assert slope == pytest.approx(expected, abs=0.15)


def test_pre_emphasis_by_hand():
    x = np.array([1, 2, 4, 4], np.float32)
    np.testing.assert_allclose(pre_emphasise(x, 0.5), [1, 1.5, 3, 2])
    np.testing.assert_array_equal(pre_emphasise(x, 0.0), x)


@given(st.floats(0.8, 1.25))
def test_time_keeps_its_middle_and_takes_a_new_slope(factor):
    out = stretch_time(ramp(width=40), factor, 16)
    assert out.shape == (16, 16)
    torch.testing.assert_close(out[:, 8], ramp(width=40)[:, 20])
    expected = torch.full((16, 15), 1 / factor)
    torch.testing.assert_close(out.diff(dim=1), expected, atol=2e-4, rtol=0)


def test_zeroed_bins_are_silent_and_others_are_unchanged():
    mel = ramp()
    out = zero_bins(mel, (2, 5))
    assert (out[[2, 5]] == SILENCE).all()
    kept = [f for f in range(16) if f not in (2, 5)]
    assert torch.equal(out[kept], mel[kept])
    assert torch.equal(mel, ramp())


def test_sine_gain_equals_an_equaliser_of_as_many_decibels():
    """Six decibels more power everywhere is the waveform times 10^(6/20)."""
    x = torch.from_numpy(tone(0.5) + 0.1 * np.random.default_rng(0).standard_normal(8000)).float()
    spectrogram = MelSpectrogram(0.064, 125, 64)
    quiet, loud = (spectrogram(y[None], 40)[0, 0] for y in (x, x * 10 ** (6 / 20)))
    flat = scale_bins(quiet, 6.0, 0.0, np.pi / 2)
    torch.testing.assert_close(flat, loud, atol=0.02, rtol=0)
    assert torch.equal(scale_bins(quiet, 0.0, 1.0, 0.3), quiet)
    one_period = (scale_bins(quiet, 6.0, 1.0, 0.0) - quiet)[:, 0]
    assert one_period.sum().abs() < 1e-4
    assert one_period.argmax() == 16 and one_period.argmin() == 48
