"""Running level of a voice that has not ended: the causal form of `normalise_level`.

The level is a mean of the power of the frames so far that forgets, and counts a frame by how loud
it is beside the mean. Pauses and quiet noise hardly change it. It begins with that of a quiet
voice, with the weight of a few frames. Each frame needs the one before, so a graph of ONNX for
several frames is given sound at the usual level.

Letters: B streams, T rig frames, P spectra of a frame, W samples of a spectrum.
"""

import numpy as np

from deitalk.array_functions import Array, library
from rig.arrays import Float32

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


def first_level(batch: int) -> Float32:
    """State before the first frame [shape=(B, 2)]: the mean and its weight in frames."""
    return np.tile(np.array([FIRST_POWER, FIRST_FRAMES], np.float32), (batch, 1))


def follow_level(power: Array, state: Array) -> tuple[Array, Array]:
    """Running level at each frame, of that frame and those before it.

    Parameters
    ----------
    power : array [shape=(B, T)]
        Mean square of every frame's sound.
    state : array [shape=(B, 2)]
        From `first_level`, or from the call before.

    Returns
    -------
    level : array [shape=(B, T)]
        Mean square of the speech so far.
    state : array [shape=(B, 2)]
        For the next call.
    """
    xp, levels = library(power), []
    level, weight = state[:, 0], state[:, 1]
    for k in range(power.shape[1]):
        now = power[:, k]
        share = now / (now + QUIET * level * weight / FORGET_FRAMES)
        weight = weight * (1 - share / FORGET_FRAMES) + share
        level = xp.clip(level + (now - level) * (share / weight), SOFTEST, LOUDEST)
        levels.append(level)
    return xp.stack(levels, axis=1), xp.stack((level, weight), axis=1)


def levelled(windows: Array, spectra: int, state: Array) -> tuple[Array, Array]:
    """Samples at the usual level.

    Parameters
    ----------
    windows : array [shape=(B, T P, W)]
        Samples of the spectra of whole frames.
    spectra : int
        P.
    state : array [shape=(B, 2)]
        As for `follow_level`.

    Returns
    -------
    windows : array [shape=(B, T P, W)]
    state : array [shape=(B, 2)]
    """
    frames = windows.reshape(windows.shape[0], -1, spectra, windows.shape[-1])
    level, state = follow_level((frames * frames).mean(-1).mean(-1), state)
    given = frames * (USUAL_POWER / level)[:, :, None, None] ** 0.5
    return given.reshape(windows.shape), state
