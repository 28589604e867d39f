"""The cosine bank: bands where the mel scale has them, levels whatever the phase."""

import numpy as np
import pytest
import torch
from torch import nn

from deitalk.config import Wav2VecConfig
from deitalk.errors import ConfigError
from deitalk.frontends.cosine_bank import NORM, PHASES, begin_as_cosines, cosine_bank
from deitalk.frontends.wav2vec import Wav2VecFrontend

BANDS, KERNEL = 64, 320
TIME = np.arange(KERNEL) / 16_000


def levels(signal: np.ndarray) -> np.ndarray:
    """Rectified and summed over the phases: one number a band."""
    return np.maximum(cosine_bank(BANDS, KERNEL) @ signal, 0).reshape(BANDS, PHASES).sum(1)


def mel_centres() -> np.ndarray:
    """The centres of librosa's HTK mel filters between the same ends."""
    librosa = pytest.importorskip("librosa", reason="needs the extra 'train'")
    return librosa.mel_frequencies(BANDS + 2, fmin=60, fmax=7600, htk=True)[1:-1]


@pytest.mark.parametrize("band", [8, 20, 40, 63])
def test_a_tone_sounds_loudest_in_its_mel_band_whatever_its_phase(band):
    frequency = mel_centres()[band]
    heard = [
        levels(np.cos(2 * np.pi * (frequency * TIME + phase))) for phase in np.linspace(0, 1, 24)
    ]
    assert all(int(row.argmax()) == band for row in heard)
    own = np.array([row[band] for row in heard])
    assert np.ptp(own) < 0.17 * own.mean()  # cos 30 degrees = 0.87


def test_filters_are_of_one_length_and_cancel_over_the_phases():
    bank = cosine_bank(BANDS, KERNEL)
    np.testing.assert_allclose(np.linalg.norm(bank, axis=1), NORM)
    # Cosines a third of a turn apart sum to zero.
    sums = bank.reshape(BANDS, PHASES, KERNEL).sum(1)
    assert np.abs(sums).max() < 0.1 * np.abs(bank).max()


def test_high_bands_have_shorter_windows_than_low_ones():
    energy = np.square(cosine_bank(BANDS, KERNEL)).reshape(BANDS, PHASES, KERNEL).sum(1)
    centre = np.arange(KERNEL) - (KERNEL - 1) / 2
    width = np.sqrt((energy * centre**2).sum(1) / energy.sum(1))
    assert width[-1] == pytest.approx(width[0] / 2, rel=0.05)


def test_only_the_first_layer_of_a_new_encoder_begins_so():
    shape = {
        "conv_dim": [12, 16],
        "conv_kernel": [160, 8],
        "conv_stride": [80, 4],
        "hidden_size": 32,
        "num_hidden_layers": 1,
        "num_attention_heads": 2,
        "intermediate_size": 32,
        "num_conv_pos_embeddings": 8,
        "num_conv_pos_embedding_groups": 4,
    }
    states = []
    for begins in (False, True):
        torch.manual_seed(0)
        config = Wav2VecConfig(checkpoint=None, cosine_bank=begins, encoder=shape)
        states.append(Wav2VecFrontend.build(config).state_dict())
    unlike = [name for name in states[0] if not torch.equal(states[0][name], states[1][name])]
    assert unlike == ["encoder.feature_extractor.conv_layers.0.conv.weight"]
    expected = torch.from_numpy(cosine_bank(4, 160)).float().unsqueeze(1)
    assert torch.equal(states[1][unlike[0]], expected)


@pytest.mark.parametrize(("channels", "kernel_size"), [(32, 320), (12, 10)])
def test_a_layer_that_cannot_hold_a_bank_is_one_line(channels, kernel_size):
    with pytest.raises(ConfigError, match=f"{channels}, must be .* {kernel_size}, at least 160"):
        begin_as_cosines(nn.Conv1d(1, channels, kernel_size))
