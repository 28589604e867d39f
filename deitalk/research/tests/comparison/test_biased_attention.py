"""Attention biased towards the recent past: hand-worked numbers, and torch's own layer."""

import math

import torch
from torch import nn

from deitalk.research.comparison.biased_attention import (
    BiasedLayer,
    causal_bias,
    head_slopes,
    periodic_positions,
)


def layer():
    torch.manual_seed(4)
    return BiasedLayer(width=8, aligned_size=6, heads=2, period=3, dropout=0.0).eval()


def test_positions_by_hand_and_again_after_a_period():
    found = periodic_positions(7, 4, period=3)
    assert found[0].tolist() == [0, 1, 0, 1]  # sin 0, cos 0
    second = [math.sin(2), math.cos(2), math.sin(2 / 100), math.cos(2 / 100)]
    torch.testing.assert_close(found[2], torch.tensor(second))
    assert torch.equal(found[3:6], found[:3]) and torch.equal(found[6], found[0])


def test_slopes_of_two_heads_are_those_of_alibi():
    assert head_slopes(2).tolist() == [2**-4, 2**-8]


def test_bias_falls_with_each_whole_period_and_shuts_the_future():
    bias = causal_bias(8, heads=2, period=3)
    assert bias[0, 7].tolist() == [-2 / 16, -2 / 16, -1 / 16, -1 / 16, -1 / 16, 0, 0, 0]
    assert bias[1, 2, :3].tolist() == [0, 0, 0]
    assert torch.isinf(bias[:, 2, 3:]).all()


@torch.no_grad()
def test_layer_equals_the_one_of_torch_under_the_same_masks():
    ours, frames = layer(), 10
    theirs = nn.TransformerDecoderLayer(8, 2, 16, dropout=0.0, batch_first=True).eval()
    own, other = theirs.self_attn, theirs.multihead_attn
    own.in_proj_weight.copy_(ours.project.weight)
    own.in_proj_bias.copy_(ours.project.bias)
    own.out_proj.load_state_dict(ours.join.state_dict())
    aligned, x = torch.randn(3, frames, 6), torch.randn(3, frames, 8)
    # Values are the aligned features' map, keys and queries are 0: each frame is given one key.
    other.in_proj_weight.zero_()
    other.in_proj_weight[16:] = torch.eye(8)
    other.in_proj_bias.zero_()
    other.out_proj.weight.copy_(torch.eye(8))
    other.out_proj.bias.zero_()
    theirs.linear1.load_state_dict(ours.feed[0].state_dict())
    theirs.linear2.load_state_dict(ours.feed[3].state_dict())
    memory = ours.aligned(aligned)
    one_key = torch.full((frames, frames), -math.inf).fill_diagonal_(0)
    mask = causal_bias(frames, 2, 3).repeat(3, 1, 1)
    expected = theirs(x, memory, tgt_mask=mask, memory_mask=one_key)
    torch.testing.assert_close(ours(x, aligned), expected)


@torch.no_grad()
def test_frame_after_frame_equals_all_at_once():
    net = layer()
    x, aligned = torch.randn(2, 11, 8), torch.randn(2, 11, 6)
    seen, past, rows = net.aligned(aligned), None, []
    for t in range(11):
        row, past = net.step(x[:, t], seen[:, t], past)
        rows.append(row)
    torch.testing.assert_close(torch.stack(rows, dim=1), net(x, aligned))
