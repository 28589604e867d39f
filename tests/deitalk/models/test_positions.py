"""Dynamic positional encoding against Eq. 2-3, by hand."""

import math

import torch
from hypothesis import given
from hypothesis import strategies as st

from deitalk.models.positions import dynamic_positions


def encode(frames, total, size=8):
    return dynamic_positions(torch.tensor([frames]), torch.tensor([total]), size)[0]


def test_encoding_by_hand():
    # 20 pi / 16 = 1.25 pi, both coordinates -sqrt(1/2); 10000^(2/4) = 100 leaves 0.0125 pi
    half = math.sqrt(0.5)
    expected = torch.tensor([-half, -half, 0.03925982, 0.99922904])
    torch.testing.assert_close(encode([1], 16, 4)[0], expected, atol=1e-6, rtol=0)


@given(st.integers(1, 5000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_encoding_depends_on_the_share_of_the_clip_only(place):
    t, total = place
    torch.testing.assert_close(encode([t], total), encode([2 * t], 2 * total), atol=2e-5, rtol=0)


def test_encoding_of_a_window_is_that_of_its_clip():
    whole = encode(list(range(300)), 300)
    window = encode(list(range(100, 228)), 300)
    assert torch.equal(window, whole[100:228])
    assert not torch.allclose(window, encode(list(range(128)), 128), atol=0.1)


def test_every_clip_of_a_batch_has_its_own_length():
    frames = torch.tensor([[5, 6], [5, 6]])
    both = dynamic_positions(frames, torch.tensor([50, 80]), 8)
    assert torch.equal(both[0], encode([5, 6], 50))
    assert torch.equal(both[1], encode([5, 6], 80))
