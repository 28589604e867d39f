"""Rows at 30 Hz, pieces and cross-fades of frontends with features at a regular stride."""

import pytest
import torch
from torch import nn

from deitalk.errors import ConfigError
from deitalk.frontends.strided import StridedFrontend
from tests.errors import one_line

CHUNK, OVERLAP = 60, 15
"""Rig frames of a piece and of two in common: 2 s and 0.5 s."""


class Samples(StridedFrontend):
    """Feature k is the sample 320 k itself, plus a number for each piece."""

    stride, centre, margin, output_size = 320, 0.0, 320, 1
    chunk_seconds, overlap_seconds = CHUNK / 30, OVERLAP / 30

    def __init__(self, steps=()):
        super().__init__()
        self.weight = nn.Parameter(torch.zeros(1))  # it tells the device
        self.steps, self.lengths, self.contexts = list(steps), [], []

    def survey(self, waveform, gain):
        return float(waveform.abs().max()) * gain

    def features(self, waveform, context=None):
        self.lengths.append(waveform.shape[1])
        self.contexts.append(context)
        step = self.steps[len(self.lengths) - 1] if self.steps else 0.0
        return waveform[:, ::320].unsqueeze(-1) + step


def clock(seconds):
    """A sound whose samples are their own times."""
    return torch.arange(round(seconds * 16_000), dtype=torch.float32) / 16_000


@pytest.mark.parametrize("n_frames", [1, 30, 60, 61, 104, 106, 150, 240])
def test_rows_are_exact_in_time_in_every_piece(n_frames):
    rows = Samples().encode(clock(n_frames / 30 + 0.1), n_frames)[:, 0]
    torch.testing.assert_close(rows, torch.arange(n_frames) / 30, atol=1e-5, rtol=0)


def test_pieces_are_bounded_and_overlap():
    frontend = Samples()
    frontend.encode(clock(8.0), 240)
    # pieces of 60 frames every 45: 0, 45, 90, 135, 180
    assert len(frontend.lengths) == 5
    assert max(frontend.lengths) <= 16_000 * CHUNK // 30 + 2 * 320 + 320


def test_a_piece_fades_into_the_next_linearly():
    """Frames 45 to 59 are in both: the second weighs 1/16, 2/16 … 15/16."""
    rows = Samples(steps=(0.0, 16.0)).encode(torch.zeros(3 * 16_000), 90)[:, 0]
    assert torch.equal(rows[:45], torch.zeros(45))
    torch.testing.assert_close(rows[45:60], torch.arange(1, 16.0))
    assert torch.equal(rows[60:], torch.full((30,), 16.0))


def test_only_clips_of_several_pieces_are_surveyed_with_their_gain():
    frontend, sound = Samples(), clock(4.0)
    frontend.encode(sound[:32_000], 60, gain=2.0)
    frontend.encode(sound, 120, gain=2.0)
    one, *several = frontend.contexts
    assert one is None
    assert several == [pytest.approx(2 * (4 - 1 / 16_000))] * 3


@pytest.mark.parametrize("n_frames", [45, 150])
def test_gain_scales_every_piece(n_frames):
    sound = clock(n_frames / 30 + 0.1)
    plain, louder = (Samples().encode(sound, n_frames, gain=gain) for gain in (1.0, 3.0))
    torch.testing.assert_close(louder, 3 * plain)


@pytest.mark.parametrize(("chunk", "overlap"), [(2, 1.5), (2, -1), (0, 0)])
def test_impossible_pieces_are_refused_in_one_line(chunk, overlap):
    with one_line(ConfigError, match="at least twice"):
        Samples().encode(clock(1.0), 30, chunk_seconds=chunk, overlap_seconds=overlap)
