"""Opening of the mouth from curves, in speech and in silence."""

import numpy as np

from deitalk.audio.voice_activity import speech_activity
from deitalk.phones import Phones
from rig import ControlSet
from rig.arrays import Float32

JAW = "CTRL_C_jaw.ty"
OPENING = (JAW, "CTRL_L_mouth_upperLipRaise.ty", "CTRL_R_mouth_upperLipRaise.ty",
           "CTRL_L_mouth_lowerLipDepress.ty", "CTRL_R_mouth_lowerLipDepress.ty")  # fmt: skip
"""Controls whose mean is the mouth's opening."""


def mouth_opening(curves: Float32, controls: ControlSet) -> Float32:
    """Mean of jaw, upper-lip and lower-lip opening [shape=(T,)]."""
    mean: Float32 = curves[:, [controls.index(name) for name in OPENING]].mean(axis=1)
    return mean


def opening_in_silence(opening: Float32, waveform: Float32, phones: Phones) -> float:
    """Mean opening in long pauses over its 95th percentile in speech; NaN without either."""
    speaking = speech_activity(waveform) > 0
    times = np.arange(len(opening)) / 30
    silent = np.zeros(len(opening), bool)
    for start, end, name in phones:
        if name == "SIL" and end - start > 0.6:
            silent |= (times > start + 0.25) & (times < end - 0.15)
    silent &= ~speaking
    if not silent.any() or not speaking.any():
        return float("nan")
    return float(opening[silent].mean() / (np.percentile(opening[speaking], 95) + 1e-9))
