"""Rig curves that repeat measured faces on the embedded head.

Letters: T frames at 30 per second, C controls, M measures.
"""

import numpy as np
import torch

from deitalk.research.lips.nearest import nearest_curves
from deitalk.research.video.head_face import MEASURES, SIDES, HeadFace
from deitalk.research.video.proportions import Measured
from rig import ControlSet
from rig.arrays import Float32

LOOSENESS = {
    "CTRL_C_jaw.ty": 0.5,
    "CTRL_C_jaw.tx": 0.15,
    "CTRL_C_mouth.tx": 0.15,
    "mouth_upperLipRaise": 0.4,
    "mouth_lowerLipDepress": 0.4,
    "mouth_cornerPull": 0.4,
    "mouth_cornerDepress": 0.3,
    "mouth_stretch.ty": 0.3,
    "mouth_funnel": 0.3,
    "mouth_purse": 0.3,
    "mouth_lipsTogether": 0.6,
    "brow_down": 0.4,
    "brow_lateral": 0.3,
    "brow_raiseIn": 0.5,
    "brow_raiseOut": 0.5,
    "eye_blink": 0.6,
    "eye_squintInner": 0.3,
}
"""Controls that landmarks show, by parts of their names, and how far they readily move."""
GAZE = tuple(f"CTRL_{side}_eye.{axis}" for axis in ("tx", "ty") for side in SIDES)
TOLERANCE_CM = {
    "opening": 0.02,
    "jaw": 0.2,
    "edge": 0.12,
    "brow_squeeze": 0.12,
    "lower_lid": 0.08,
}
"""Error of a measure that costs as much as a control moved by its looseness, by parts of names:
the detector places the rims of lips and lids well, chin and outer edges of the lips less so."""
USUAL_TOLERANCE_CM = 0.04
CHUNK = 1000
"""Frames that are solved at a time."""


def shown_controls(controls: ControlSet, *, gaze: bool) -> tuple[str, ...]:
    """Controls that landmarks determine: no tongue, teeth, lip bite or cheeks."""
    return tuple(
        name
        for name in controls.names
        if any(part in name for part in LOOSENESS) or (gaze and name in GAZE)
    )


def solve_curves(measured: Measured, face: HeadFace, controls: ControlSet) -> Float32:
    """Curves near rest with which the head does what was measured [shape=(T, C)].

    Bounded least squares (`nearest_curves`): squared errors of the measures
    over `TOLERANCE_CM` plus squared controls over `LOOSENESS`, within the ranges of the controls.
    The gaze is not solved for but taken, since lids follow it.

    Parameters
    ----------
    measured : Measured
        T frames.
    face : HeadFace
        The head.
    controls : ControlSet
        The default board.
    """
    n_frames = len(measured.displacements)
    prior = torch.tensor(np.tile(controls.rest, (n_frames, 1))).float()
    if measured.gaze is not None:
        for name in GAZE:
            column = measured.gaze[:, int(name.endswith(".ty"))]
            prior[:, controls.index(name)] = torch.from_numpy(column.copy())
    loose = torch.tensor(
        [
            next((far for part, far in LOOSENESS.items() if part in name), 0.0)
            for name in controls.names
        ]
    )
    tolerance = torch.tensor(
        [
            next((far for part, far in TOLERANCE_CM.items() if part in name), USUAL_TOLERANCE_CM)
            for name in MEASURES
        ]
    )
    wanted = torch.from_numpy(measured.displacements)
    solved = [
        nearest_curves(
            prior[k : k + CHUNK], wanted[k : k + CHUNK], face, loose, tolerance, controls
        )
        for k in range(0, n_frames, CHUNK)
    ]
    values: Float32 = torch.cat(solved).numpy()
    return values
