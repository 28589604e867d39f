"""A clip encoded several times, parts of a period apart: the shifts, and the mean."""

from fractions import Fraction

import pytest
import torch

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.config.frontends import MelConfig
from deitalk.frontends import build_frontend
from deitalk.frontends.mel_bilstm import phase_shifts

MEL = {
    "n_mels": 16,
    "conv_channels": (4, 4, 4),
    "spec_hidden": 4,
    "spectral_size": 12,
    "time_hidden": 8,
    "attention_size": 6,
    "window_seconds": 0.032,
    "frame_rate": 60,
    "window_frames": 32,
    "query_frames": 5,
    "weight_norm": False,
}
FRONTENDS = {
    "segment": lambda phases: MelConfig(**MEL, recurrence="segment", phases=phases),
    "window": lambda phases: MelConfig(**MEL, recurrence="window", phases=phases),
}


def noise(seconds):
    generator = torch.Generator().manual_seed(3)
    return 0.1 * torch.randn(round(seconds * SAMPLE_RATE), generator=generator)


def test_phase_shifts_by_hand():
    assert phase_shifts(1, 60) == [0]
    assert phase_shifts(2, 62.5) == [-64, 64]  # half of 256 samples apart
    assert phase_shifts(4, 62.5) == [-96, -32, 32, 96]
    assert phase_shifts(2, 60) == [-67, 67]  # of 266.7


@pytest.mark.parametrize("phases", [1, 2, 3, 5])
@pytest.mark.parametrize("rate", [60, 100, 125])
def test_phase_shifts_divide_a_period_evenly_about_0(phases, rate):
    shifts = phase_shifts(phases, rate)
    step = Fraction(SAMPLE_RATE, rate * phases)
    assert [-shift for shift in reversed(shifts)] == shifts
    for before, after in zip(shifts, [*shifts[1:], shifts[0] + SAMPLE_RATE / rate], strict=True):
        assert abs(after - before - step) <= 1


@pytest.mark.parametrize("make", FRONTENDS.values())
@torch.no_grad()
def test_two_phases_give_the_mean_of_two_encodings(make):
    n_frames = 70
    sound = torch.cat([torch.zeros(SAMPLE_RATE // 2), noise(n_frames / 30 - 1)])
    torch.manual_seed(1)
    once = build_frontend(make(1)).eval()
    twice = build_frontend(make(2)).eval()
    twice.load_state_dict(once.state_dict())
    early = once.encode(torch.cat([torch.zeros(67), sound]), n_frames)
    late = once.encode(sound[67:], n_frames)
    rows = twice.encode(sound, n_frames)
    torch.testing.assert_close(rows, (early + late) / 2)
    assert (early - late).abs().max() > 100 * (rows - (early + late) / 2).abs().max()
    torch.testing.assert_close(
        twice(sound.unsqueeze(0), n_frames), once(sound.unsqueeze(0), n_frames)
    )
