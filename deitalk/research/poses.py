"""Named poses for contact sheets and tests: mouth shapes, emotions, single controls."""

import numpy as np

from rig.arrays import Float64
from rig.controls import default_controls
from rig.errors import RigError

MOUTH_POSES: dict[str, dict[str, float]] = {
    "rest": {},
    "AA (father)": {"CTRL_C_jaw.ty": 0.62, "*mouth_lowerLipDepress.ty": 0.25,
                    "*mouth_upperLipRaise.ty": 0.1, "CTRL_C_tongue_move.ty": -0.4},
    "IY (see)": {"CTRL_C_jaw.ty": 0.14, "*mouth_stretch.ty": 0.35, "*mouth_cornerPull.ty": 0.3,
                 "*mouth_upperLipRaise.ty": 0.25, "*mouth_lowerLipDepress.ty": 0.4,
                 "CTRL_C_tongue_move.ty": 0.5},
    "M B P": {"CTRL_C_jaw.ty": 0.18, "*mouth_lipsTogetherU.ty": 1, "*mouth_lipsTogetherD.ty": 1,
              "*mouth_pressU.ty": 0.5, "*mouth_pressD.ty": 0.5},
    "F V": {"CTRL_C_jaw.ty": 0.10, "*mouth_lipBiteD.ty": 0.8, "*mouth_upperLipRaise.ty": 0.3},
    "OW (go)": {"CTRL_C_jaw.ty": 0.30, "*mouth_funnelU.ty": 0.75, "*mouth_funnelD.ty": 0.75,
                "*mouth_purseU.ty": 0.35, "*mouth_purseD.ty": 0.35},
    "UW (you)": {"CTRL_C_jaw.ty": 0.20, "*mouth_purseU.ty": 1, "*mouth_purseD.ty": 1,
                 "*mouth_funnelU.ty": 0.08, "*mouth_funnelD.ty": 0.12,
                 "CTRL_C_tongue_inOut.ty": 0.3},
    "SH CH": {"CTRL_C_jaw.ty": 0.06, "*mouth_funnelU.ty": 0.75, "*mouth_funnelD.ty": 0.75,
              "*mouth_upperLipRaise.ty": 0.15, "*mouth_lowerLipDepress.ty": 0.3},
    "L N T D": {"CTRL_C_jaw.ty": 0.26, "*mouth_upperLipRaise.ty": 0.25,
                "*mouth_lowerLipDepress.ty": 0.35, "CTRL_C_tongue_tipMove.ty": 0.9,
                "CTRL_C_tongue_inOut.ty": -0.25},
    "TH (thin)": {"CTRL_C_jaw.ty": 0.20, "*mouth_upperLipRaise.ty": 0.2,
                  "*mouth_lowerLipDepress.ty": 0.3, "CTRL_C_tongue_inOut.ty": -0.7,
                  "CTRL_C_tongue_tipMove.ty": 0.12},
    "smile": {"*mouth_cornerPull.ty": 1, "*eye_cheekRaise.ty": 0.6},
    "frown": {"*mouth_cornerDepress.ty": 1, "*jaw_ChinRaiseD.ty": 0.3},
}  # fmt: skip
"""Twelve mouths; a leading ``*`` stands for the control on both sides."""

EMOTION_POSES: dict[str, dict[str, float]] = {
    "neutral": {"*eye_eyelidU.ty": 0.25, "*mouth_cornerDepress.ty": 0.08},
    "angry": {"*brow_down.ty": 1, "*brow_lateral.ty": 0.6, "*eye_squintInner.ty": 0.6,
              "*eye_blink.ty": -0.35, "*nose.ty": 0.45, "*mouth_upperLipRaise.ty": 0.35,
              "*mouth_lowerLipDepress.ty": 0.5, "*mouth_cornerDepress.ty": 0.45,
              "*nose.tx": 0.8, "CTRL_C_jaw.ty": 0.10, "CTRL_C_jaw_fwdBack.ty": -0.35,
              "*jaw_clench.ty": 0.8, "*mouth_stretch.ty": 0.25},
    "happy": {"*mouth_cornerPull.ty": 0.9, "*eye_cheekRaise.ty": 0.85, "*eye_squintInner.ty": 0.3,
              "*mouth_upperLipRaise.ty": 0.35, "*mouth_dimple.ty": 0.25, "CTRL_C_jaw.ty": 0.16,
              "*brow_raiseOut.ty": 0.2},
    "sad": {"*brow_raiseIn.ty": 1, "*brow_lateral.ty": 0.5, "*brow_down.ty": 0.15,
            "*mouth_cornerDepress.ty": 0.85, "*jaw_ChinRaiseD.ty": 0.55,
            "*eye_eyelidU.ty": 0.5, "*eye_squintInner.ty": 0.2, "CTRL_C_eye.ty": -0.3},
    "surprised": {"*brow_raiseIn.ty": 0.95, "*brow_raiseOut.ty": 1, "*eye_blink.ty": -0.9,
                  "CTRL_C_jaw.ty": 0.55, "*mouth_funnelU.ty": 0.25, "*mouth_funnelD.ty": 0.25},
}  # fmt: skip
"""Textbook (FACS) poses of the five emotions, for looking at the head."""


def pose_values(pose: dict[str, float], strength: float = 1.0) -> Float64:
    """Control values (185,) of a pose: rest plus its entries times `strength`.

    Raises
    ------
    RigError
        If a name is no control.
    """
    controls = default_controls()
    values = controls.rest.astype(np.float64).copy()
    for key, amount in pose.items():
        names = [f"CTRL_{s}_{key[1:]}" for s in "LR"] if key.startswith("*") else [key]
        for name in names:
            if name not in controls.names:
                raise RigError(f"pose names {name!r}, which is no control of {controls.id}")
            k = controls.index(name)
            values[k] += strength * (amount - controls.rest[k])
    return np.clip(values, controls.minimum, controls.maximum)
