"""Opening of the mouth from curves, in speech and in silence."""

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.phones import SILENCE, Phones
from rig import ControlSet
from rig.arrays import Float32

JAW = "CTRL_C_jaw.ty"
OPENING = (JAW, "CTRL_L_mouth_upperLipRaise.ty", "CTRL_R_mouth_upperLipRaise.ty",
           "CTRL_L_mouth_lowerLipDepress.ty", "CTRL_R_mouth_lowerLipDepress.ty")  # fmt: skip
"""Controls whose mean is the mouth's opening."""
LONG_SECONDS = 0.6
"""Least length of a pause in which the mouth should close."""


def mouth_opening(curves: Float32, controls: ControlSet) -> Float32:
    """Mean of jaw, upper-lip and lower-lip opening [shape=(T,)]."""
    mean: Float32 = curves[:, [controls.index(name) for name in OPENING]].mean(axis=1)
    return mean


def opening_in_silence(opening: Float32, phones: Phones) -> float:
    """Mean opening in long pauses over its 95th percentile in speech.

    Pauses are those of the phones' times, not of the detector that closes the mouth in them. Their
    first 0.25 s and last 0.15 s, in which people relax and prepare, do not count.

    Parameters
    ----------
    opening : ndarray [shape=(T,)]
        At 30 frames per second.
    phones : sequence of (start, end, name)
        Seconds.

    Returns
    -------
    float
        NaN without a pause of `LONG_SECONDS`, or without speech.
    """
    times = np.arange(len(opening)) / FRAME_RATE
    silent, speaking = np.zeros(len(opening), bool), np.zeros(len(opening), bool)
    for start, end, name in phones:
        if name != SILENCE:
            speaking |= (times >= start) & (times < end)
        elif end - start > LONG_SECONDS:
            silent |= (times > start + 0.25) & (times < end - 0.15)
    if not silent.any() or not speaking.any():
        return float("nan")
    return float(opening[silent].mean() / (np.percentile(opening[speaking], 95) + 1e-9))
