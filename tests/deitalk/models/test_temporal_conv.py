"""Dilated convolutions: the reach of a frame, by hand and by perturbation."""

import pytest
import torch

from deitalk.models.temporal_conv import TemporalConv, receptive_margin

DILATIONS = (1, 2, 4, 8, 1, 2, 4, 8)


@pytest.fixture
def stack():
    """Positive weights, so that on positive inputs no path through a ReLU is dead."""
    torch.manual_seed(0)
    layers = [TemporalConv(3, 3, 3, d, dropout=0.5) for d in DILATIONS]
    for layer in layers:
        layer.conv.weight.data.abs_().mul_(0.5)
    return torch.nn.Sequential(*layers).double().eval()


def test_one_layer_by_hand():
    layer = TemporalConv(1, 1, 3, dilation=4, dropout=0.0)
    with torch.no_grad():
        layer.conv.weight.copy_(torch.tensor([[[1.0, 10.0, -100.0]]]))
        layer.conv.bias.fill_(0.5)
    x = torch.arange(12.0).view(1, 1, 12)
    x[0, 0, 11] = -3
    out = layer(x).detach()[0, 0]
    assert out.shape == (12,)
    assert float(out[7]) == 3 + 70 + 300 + 0.5  # frame 11 is -3
    assert float(out[4]) == 0  # 0 + 40 - 800 is below zero: ReLU
    assert float(out[10]) == 6 + 100 + 0.5  # beyond the end there is nothing


def test_margin_of_the_paper_is_thirty_frames():
    assert receptive_margin(DILATIONS, 3) == 30
    assert receptive_margin((1,), 5) == 2
    assert receptive_margin((1, 2, 4, 8), 3) == 15


def test_one_frame_changes_thirty_on_either_side_and_no_more(stack):
    x = torch.rand(1, 3, 140, dtype=torch.float64)
    changed = x.clone()
    changed[0, :, 70] += 1
    moved = (stack(changed) != stack(x)).any(dim=1)[0].nonzero().flatten()
    assert moved.tolist() == list(range(40, 101))


def test_signal_keeps_its_size_through_eight_layers():
    torch.manual_seed(0)
    wide = torch.nn.Sequential(*(TemporalConv(64, 64, 3, d, 0.0) for d in DILATIONS))
    x = torch.randn(1, 64, 400)
    share = (wide(x)[..., 60:-60].square().mean() / x.square().mean()).item()
    assert 0.25 < share < 4  # torch's own initialisation leaves 1e-3 of it
