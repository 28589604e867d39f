"""Mel spectrogram: SDFA's numbers, alignment in time, derivatives."""

import numpy as np
import pytest
import torch
from transformers.audio_utils import hertz_to_mel, mel_to_hertz

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.mel import (
    FLOOR,
    MelSpectrogram,
    derivative,
    nearest_spectra,
    sine_tapers,
    spectra_centres,
)
from deitalk.config.frontends import MelConfig

SETTINGS = [(0.064, 125.0, 128), (0.032, 60.0, 80), (0.032, 60.0, 80, 3)]
"""SDFA's, and those of configs/mel.yaml by one window and by tapers."""


every_mel = pytest.mark.parametrize("mel", [MelSpectrogram(*settings) for settings in SETTINGS])


def noise(seconds=1.0, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return 0.1 * torch.randn(1, int(seconds * SAMPLE_RATE), generator=generator)


def test_window_of_sdfa_lasts_568_milliseconds():
    config = MelConfig()
    hops = (config.window_frames - 1) / config.frame_rate
    assert hops + config.window_seconds == pytest.approx(0.568)
    # the same in samples: what the 64 spectra around time 4096 read
    mel = MelSpectrogram(config.window_seconds, config.frame_rate, config.n_mels)
    centres = spectra_centres(64, config.frame_rate)
    first, last = int(centres[0]) - mel.length // 2, int(centres[-1]) + mel.length // 2
    assert (last - first) / SAMPLE_RATE == pytest.approx(0.568)


def test_linear_ramp_has_constant_derivative():
    slope = derivative(0.25 * torch.arange(10.0).unsqueeze(0))
    assert slope[0].tolist() == [0.125, *[0.25] * 8, 0.125]  # beyond the ends they repeat
    assert derivative(slope)[0, 2:-2].tolist() == [0] * 6


@every_mel
def test_channels_are_the_spectrum_and_its_derivatives(mel):
    spectrum, slope, curvature = mel(noise(), 30)[0]
    torch.testing.assert_close(slope[:, 4], (spectrum[:, 5] - spectrum[:, 3]) / 2)
    torch.testing.assert_close(
        curvature[:, 4], (spectrum[:, 6] - 2 * spectrum[:, 4] + spectrum[:, 2]) / 4
    )


@every_mel
def test_piece_has_the_spectra_of_the_whole_clip(mel):
    waveform = noise(2.0)
    whole, piece = mel(waveform, 100), mel(waveform, 30, first=40)
    torch.testing.assert_close(piece[:, 0], whole[:, 0, :, 40:70])
    # a derivative at the ends of what was asked for has no neighbour
    torch.testing.assert_close(piece[..., 2:-2], whole[..., 42:68])


@every_mel
@pytest.mark.parametrize("frame", [1, 7, 20, 29])
def test_click_at_a_frame_peaks_at_its_spectrum(mel, frame):
    waveform = torch.zeros(1, SAMPLE_RATE)
    waveform[0, round(frame * SAMPLE_RATE / 30)] = 1
    loudness = mel(waveform, int(mel.frame_rate))[0, 0].mean(dim=0)
    peak = int(loudness.argmax())
    assert abs(peak - frame * mel.frame_rate / 30) <= 0.5
    assert abs(peak - int(nearest_spectra(30, mel.frame_rate)[frame])) <= 1


def test_frames_and_spectra_of_the_default_coincide():
    assert nearest_spectra(6, 60).tolist() == [0, 2, 4, 6, 8, 10]
    assert nearest_spectra(4, 120, stack=2).tolist() == [0, 2, 4, 6]
    assert nearest_spectra(7, 125).tolist() == [0, 4, 8, 12, 17, 21, 25]  # 4.17 apart


@every_mel
def test_a_pure_tone_peaks_in_its_band(mel):
    t = torch.arange(SAMPLE_RATE) / SAMPLE_RATE
    n_mels = mel.filters.shape[1]
    ends = (hertz_to_mel(float(hz), mel_scale="slaney") for hz in (50, 7600))
    bands = mel_to_hertz(np.linspace(*ends, n_mels + 2), mel_scale="slaney")[1:-1]
    for frequency in (1000.0, 3000.0):
        tone = torch.sin(2 * torch.pi * frequency * t).unsqueeze(0)
        band = int(mel(tone, 40)[0, 0, :, 20].argmax())
        assert abs(band - int(np.abs(bands - frequency).argmin())) <= 1


@every_mel
def test_ten_times_louder_adds_log_of_a_hundred(mel):
    quiet, loud = mel(noise() * 10, 30), mel(noise() * 100, 30)
    difference = (loud - quiet)[0, 0, :, 5:25]
    torch.testing.assert_close(
        difference, torch.full_like(difference, np.log(100) / 3.5), atol=2e-3, rtol=0
    )


@every_mel
def test_silence_and_beyond_the_clip_are_the_floor(mel):
    floor = (np.log(FLOOR) + 6.5) / 3.5
    silent = mel(torch.zeros(1, 100), 20)
    assert silent[0, 0].numpy() == pytest.approx(floor)
    assert not silent[0, 1:].any()
    beyond = mel(noise(0.2), 40, first=60)
    assert beyond[0, 0, :, 20:].numpy() == pytest.approx(floor)


def test_sine_tapers_by_hand():
    root = np.sqrt(0.5)  # of 3 samples: sin(pi t / 4) and sin(pi t / 2), of energy 2
    expected = np.array([[root, 1, root], [1, 0, -1]]) * root
    np.testing.assert_allclose(sine_tapers(3, 2).numpy(), expected, atol=1e-7)
    product = sine_tapers(512, 4).double()
    torch.testing.assert_close(
        product @ product.T, torch.eye(4, dtype=torch.float64), atol=1e-6, rtol=0
    )


def test_three_tapers_have_the_power_of_one_window_and_a_third_of_its_variance():
    sound = noise(60.0)
    powers = []
    for tapers in (1, 3):
        mel = MelSpectrogram(0.032, 30.0, 80, tapers)  # windows do not overlap
        mel.filters = torch.eye(257)[:, 8:-8]  # bins of the Fourier transform alone
        powers.append(mel.power(mel.windows(sound, 1800))[0, 1:-1].double())
    means, variances = zip(*((p.mean(), p.var(dim=0).mean()) for p in powers), strict=True)
    assert means[1] / means[0] == pytest.approx(1, abs=0.02)
    assert variances[0] / means[0] ** 2 == pytest.approx(1, abs=0.05)  # of an exponential law
    assert variances[1] / means[1] ** 2 == pytest.approx(1 / 3, abs=0.03)
