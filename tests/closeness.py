"""Whether two results of the same network are the same."""

import torch

SHARE = 1e-4
"""Tolerance as a share of the largest value. Processors add float32 in different orders: on two of
them (AVX2, AVX-512) two equivalent computations of one network differed by 2e-7 and 5e-6. The faults
that the tests detect, leakage between clips or missing context, are 1e-2 and more."""


def assert_same(actual: torch.Tensor, expected: torch.Tensor) -> None:
    """Assert equality up to the float32 rounding of a network, at any scale and on any processor."""
    tolerance = SHARE * float(expected.detach().abs().max())
    torch.testing.assert_close(actual, expected, atol=tolerance, rtol=0)
