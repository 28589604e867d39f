"""Whether two results of the same network are the same."""

import torch

SHARE = 1e-4
"""Of the largest value. Processors add float32 in other orders: on two of them (AVX2, AVX-512) two
ways through one network differed by 2e-7 and 5e-6 of it. What the tests look for, a clip that hears
another or a piece without its context, is 1e-2 and more."""


def assert_same(actual: torch.Tensor, expected: torch.Tensor) -> None:
    """Equal up to the rounding of a network of float32, whatever its scale and the processor."""
    tolerance = SHARE * float(expected.detach().abs().max())
    torch.testing.assert_close(actual, expected, atol=tolerance, rtol=0)
