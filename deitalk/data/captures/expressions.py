"""Scores of expressions in curves by a rule in action units.

The rule uses the prototypes of EMFACS (Ekman, Friesen and Hager 2002) on means of the curves
over the frames with speech:

- happy: AU12 + AU6: mean of corner pull and cheek raise
- sad: AU1 + AU15 + AU17 without AU2: mean of inner brow raise, corner depress and chin raise,
  less the outer brow raise
- angry: AU4 + AU7 + AU23: mean of brow down, inner squint and lip tightening
- surprised: AU1 + AU2 + AU5: mean of inner and outer brow raise and the lids' widening

Letters: T frames, C controls.
"""

import numpy as np

from rig import ControlSet
from rig.arrays import Bool, Float32

RULE: dict[str, tuple[tuple[str, float], ...]] = {
    "happy": (("mouth_cornerPull.ty", 0.5), ("eye_cheekRaise.ty", 0.5)),
    "sad": (
        ("brow_raiseIn.ty", 1 / 3), ("mouth_cornerDepress.ty", 1 / 3), ("jaw_ChinRaiseD.ty", 1 / 3),
        ("brow_raiseOut.ty", -1.0),
    ),
    "angry": (
        ("brow_down.ty", 1 / 3), ("eye_squintInner.ty", 1 / 3), ("mouth_tightenU.ty", 1 / 6),
        ("mouth_tightenD.ty", 1 / 6),
    ),
    "surprised": (
        ("brow_raiseIn.ty", 1 / 3), ("brow_raiseOut.ty", 1 / 3), ("eye_blink.ty", -1 / 3),
    ),
}  # fmt: skip
"""Controls of both sides and their weight."""


def style_scores(curves: Float32, speaking: Bool, controls: ControlSet) -> Float32:
    """Scores of happy, sad, angry and surprised [shape=(4,)], control units."""
    rows = curves[speaking] if speaking.any() else curves
    face = rows.mean(axis=0) - controls.rest
    scores = [
        sum(w / 2 * face[controls.index(f"CTRL_{s}_{name}")] for name, w in rule for s in "LR")
        for rule in RULE.values()
    ]
    return np.array(scores, np.float32)
