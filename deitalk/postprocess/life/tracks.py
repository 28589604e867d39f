"""Shapes over time that the parts share: swells of events, slow noise, fades at the ends.

Letters: T frames at 30 per second.
"""

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from rig.arrays import Float32, Float64
from rig.curves.filters import gaussian_smooth

RISE_SECONDS, FADE_SECONDS = 0.5, 0.9
"""Motion begins at rest with a take, and comes to rest before its end."""
STILL_SECONDS = 0.5
"""Rest at the end, but for a silence that is too short for it."""
CUT_SECONDS = 0.2
"""Silence at the end below which a take counts as cut."""


def swell(
    n_frames: int, peak: float, attack: float, decay: float, hold: float = 0.0
) -> tuple[slice, Float64]:
    """Rise to 1 at a time, hold, and fall, in raised cosines.

    Parameters
    ----------
    n_frames : int
        T.
    peak, attack, decay, hold : float
        Seconds.

    Returns
    -------
    slice
        Frames of the take in which it is above 0.
    array [shape=(frames,), range 0 to 1]
        Its values there.
    """
    first = min(max(int((peak - attack) * FRAME_RATE), 0), n_frames)
    last = min(max(int((peak + hold + decay) * FRAME_RATE) + 1, first), n_frames)
    time = np.arange(first, last) / FRAME_RATE - peak
    rise = np.clip(1 + time / attack, 0, 1)
    fall = np.clip(1 - (time - hold) / decay, 0, 1)
    shape: Float64 = 0.25 * (1 - np.cos(np.pi * rise)) * (1 - np.cos(np.pi * fall))
    return slice(first, last), shape


def slow_noise(n_frames: int, seconds: float, rng: np.random.Generator) -> Float64:
    """Noise of unit variance with a Gaussian spectrum [shape=(T,)]; `seconds` is the sigma."""
    sigma = seconds * FRAME_RATE
    margin = int(4 * sigma) + 1
    noise = gaussian_smooth(rng.standard_normal(n_frames + 2 * margin), sigma)
    scaled: Float64 = noise[margin : margin + n_frames] * np.sqrt(2 * sigma * np.sqrt(np.pi))
    return scaled


def presence(n_frames: int, silence: float) -> Float32:
    """Share of the motion shown: 0 at the start of a take and in silence at its end [shape=(T,)].

    Parameters
    ----------
    n_frames : int
        T.
    silence : float
        Seconds without speech at the end; a take that is cut in its speech keeps its motion.
    """
    time = np.arange(n_frames) / FRAME_RATE
    rise, fade = np.clip(time / RISE_SECONDS, 0, 1), np.ones(n_frames)
    if silence > CUT_SECONDS:
        still = min(STILL_SECONDS, silence / 3)
        left = (n_frames - 1) / FRAME_RATE - time - still
        fade = np.clip(left / min(FADE_SECONDS, silence - still), 0, 1)
    shape: Float32 = (rise * rise * (3 - 2 * rise) * fade * fade * (3 - 2 * fade)).astype("f4")
    return shape
