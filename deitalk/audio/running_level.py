"""Running level of a voice that has not ended: the causal form of `normalise_level`.

The level is a mean of the power of the frames so far that forgets, and counts a frame by how loud
it is beside the mean. Pauses and quiet noise hardly change it. It begins with that of a quiet
voice, with the weight of a few frames.

Letters: B streams, T rig frames.
"""

import torch
from torch import Tensor

USUAL_POWER = 10**-2.3
"""Mean square of speech at the level of the training, -23 dB re full scale."""
FORGET_FRAMES = 240.0
"""Frames of speech that the mean remembers (8 s)."""
FIRST_POWER, FIRST_FRAMES = 10**-3.3, 4.0
"""Mean at the start, and its weight in frames: a quiet voice, which a loud one corrects at once."""
QUIET = 0.02
"""Power beside a mean of full weight, -17 dB, at which a frame counts half; less for a young mean,
which is to find quiet voices soon."""
SOFTEST, LOUDEST = 1e-7, 10.0
"""Limits of the mean square: -70 to 10 dB."""


def first_level(batch: int, like: Tensor) -> Tensor:
    """State before the first frame [shape=(B, 2)]: the mean and its weight in frames."""
    return like.new_tensor([FIRST_POWER, FIRST_FRAMES]).repeat(batch, 1)


def follow_level(power: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
    """Running level at each frame, of that frame and those before it.

    Parameters
    ----------
    power : Tensor [shape=(B, T)]
        Mean square of every frame's sound.
    state : Tensor [shape=(B, 2)]
        From `first_level`, or from the call before.

    Returns
    -------
    level : Tensor [shape=(B, T)]
        Mean square of the speech so far.
    state : Tensor [shape=(B, 2)]
        For the next call.
    """
    level, weight = state.unbind(dim=1)
    levels = []
    for now in power.unbind(dim=1):
        share = now / (now + QUIET * level * weight / FORGET_FRAMES)
        weight = weight * (1 - share / FORGET_FRAMES) + share
        level = level + (now - level) * (share / weight)
        level = level.clamp(SOFTEST, LOUDEST)
        levels.append(level)
    return torch.stack(levels, dim=1), torch.stack((level, weight), dim=1)
