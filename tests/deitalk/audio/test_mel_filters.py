"""Mel filters: Slaney's scale at known points, and the matrices of transformers and librosa."""

import librosa
import numpy as np
import pytest
from transformers.audio_utils import mel_filter_bank

from deitalk.audio.log_mel import N_FFT, log_mel_filters
from deitalk.audio.mel_filters import hz_to_mel, mel_filters, mel_to_hz


@pytest.mark.parametrize(("hz", "mel"), [(0, 0), (200, 3), (1000, 15), (6400, 42)])
def test_mel_scale_is_linear_to_one_kilohertz_then_27_steps_to_6400(hz, mel):
    assert hz_to_mel(hz) == pytest.approx(mel)
    assert mel_to_hz(np.array([float(mel)]))[0] == pytest.approx(hz)


@pytest.mark.parametrize(("n_fft", "n_mels"), [(512, 80), (1024, 40), (256, 26)])
def test_filters_equal_those_of_transformers(n_fft, n_mels):
    ours = mel_filters(16_000, n_fft, n_mels, 50, 7600)
    theirs = mel_filter_bank(n_fft // 2 + 1, n_mels, 50, 7600, 16_000, mel_scale="slaney").T
    assert ours.dtype == np.float32
    np.testing.assert_allclose(ours, theirs, atol=1e-7)


@pytest.mark.parametrize("n_mels", [80, 128])
def test_filters_of_whisper_equal_those_of_librosa(n_mels):
    theirs = librosa.filters.mel(sr=16_000, n_fft=N_FFT, n_mels=n_mels)
    np.testing.assert_allclose(log_mel_filters(n_mels), theirs, atol=1e-7)
