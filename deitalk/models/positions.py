"""Dynamic positional encoding: a frame's place in its whole clip (DEITalk §3.2, Eq. 2-3).

L frames of a window, T frames of the clip, as printed.
"""

import math

import torch
from torch import Tensor


def dynamic_positions(frames: Tensor, total: Tensor, size: int) -> Tensor:
    """Sines and cosines of a frame's place relative to its clip.

    DEITalk Eq. 2: ``sin(20 pi t / (T 10000^(2i/d)))`` in the even columns, the cosine in the odd
    ones. Only ``t / T`` matters: a window cut from a clip keeps the encoding it has in the clip.

    Parameters
    ----------
    frames : Tensor [shape=(B, L)]
        Frame indices t in the whole clip (not in the window).
    total : Tensor [shape=(B,)]
        Frames T of the whole clip.
    size : int
        Width d.

    Returns
    -------
    Tensor [shape=(B, L, size), range -1 to 1]

    Notes
    -----
    Paper silent: whether t starts at 0 or 1; we count from 0. An odd d ends with a sine.
    """
    exponent = torch.arange(0, size, 2, device=frames.device, dtype=torch.float32) / size
    frequency = 20 * math.pi * 10000.0**-exponent
    place = frames.to(torch.float32) / total.to(torch.float32).unsqueeze(-1)
    angle = place.unsqueeze(-1) * frequency  # (B, L, ceil(d / 2))
    return torch.stack((angle.sin(), angle.cos()), dim=-1).flatten(-2)[..., :size]
