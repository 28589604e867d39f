"""Strength of a voice: independent of the gain, and higher for a strong voice than for a soft one."""

import numpy as np
import pytest
import torch

from deitalk.audio.prosody import BANDS, measure_prosody
from deitalk.audio.vocal_strength import (
    FEATURES,
    HIGHEST,
    LOWEST,
    REST_WEIGHT,
    VocalStrength,
    strength_frames,
    vocal_strength,
    without_level,
)
from deitalk.audio.voice_activity import speech_activity
from deitalk.research.training.strength_network import StrengthNetwork
from tests.deitalk.audio.test_prosody import voice


def frames_of(waveform):
    n = -(-30 * len(waveform) // 16_000)
    return strength_frames(measure_prosody(waveform, n), speech_activity(waveform))


def test_level_of_the_speech_is_taken_off_the_bands():
    """Two frames of speech with powers of 26 and 2600: their mean is 1313."""
    frames = np.zeros((4, FEATURES), np.float32)
    frames[1, :BANDS], frames[2:, :BANDS] = 2.0, -9.0
    frames[:2, -1] = 1
    frames[3, -1] = 1  # silence that counts as speech
    out, level = without_level(frames)
    power = (26 + 2600 + 26e-9) / 3
    assert level == pytest.approx(10 * np.log10(power), abs=1e-4)
    assert out[0, 0] == pytest.approx(-np.log10(power), abs=1e-5)
    assert out[2, 0] == LOWEST and out.max() <= HIGHEST
    np.testing.assert_array_equal(out[:, BANDS:], frames[:, BANDS:])


@pytest.mark.parametrize("gain", [0.01, 10.0])
def test_gain_does_not_change_the_strength(gain):
    waveform = voice(180.0, 1.0)
    plain, scaled = (vocal_strength().measure(frames_of(g * waveform)) for g in (1, gain))
    assert scaled == pytest.approx(plain, abs=0.05)


def test_bright_high_voice_is_stronger_than_a_dark_low_one():
    soft, strong = (
        vocal_strength().measure(frames_of(w)) for w in (voice(110, 1.6), voice(220, 0.9))
    )
    assert strong > soft + 2


def test_strength_without_voice_is_zero():
    for waveform in (np.zeros(16_000, np.float32), np.zeros(0, np.float32)):
        assert vocal_strength().measure(frames_of(waveform)) == 0


@torch.no_grad()
def test_frames_without_weight_do_not_count(rng):
    """Padding of a batch: the same piece, alone and beside a longer one."""
    network = StrengthNetwork().eval()
    piece = torch.tensor(rng.normal(size=(1, 40, FEATURES)), dtype=torch.float32)
    alone = network(piece, torch.ones(1, 40))
    reach = 2 * (1 + 2 + 4)
    longer = torch.cat([piece, torch.zeros(1, reach + 30, FEATURES)], dim=1)
    weight = torch.zeros(1, 40 + reach + 30)
    weight[:, :40] = 1
    padded = network(longer, weight)
    assert abs(float(alone - padded)) < 1.0, "only the edge of the convolutions differs"
    spoilt = longer.clone()
    spoilt[:, 40 + reach :] = 100.0
    torch.testing.assert_close(network(spoilt, weight), padded)


@torch.no_grad()
def test_strength_in_numpy_equals_the_network_that_is_trained(rng):
    network = StrengthNetwork(members=2).eval()
    for member in network.members:
        member.mean.normal_()
        member.spread.uniform_(0.5, 2.0)
    frames = rng.normal(size=(60, FEATURES)).astype(np.float32)
    frames[:, -2:] = rng.integers(0, 2, (60, 2))
    frames[:, BANDS + 1] = 1
    rows, _ = without_level(frames)
    weight = np.maximum(rows[:, -1], REST_WEIGHT)
    expected = float(network(torch.tensor(rows)[None], torch.tensor(weight)[None]))
    assert VocalStrength(network.weights()).measure(frames) == pytest.approx(expected, abs=1e-5)


def test_the_order_of_the_weights_changes_no_bit(rng):
    """`safetensors` gives them in another order in every process."""
    frames = rng.normal(size=(60, FEATURES)).astype(np.float32)
    frames[:, -2:] = 1
    weights = vocal_strength().weights
    orders = (rng.permutation(sorted(weights)).tolist() for _ in range(8))
    found = [VocalStrength({n: weights[n] for n in names}).follow(frames) for names in orders]
    for whole, around in found[1:]:
        assert whole == found[0][0]
        np.testing.assert_array_equal(around, found[0][1])
