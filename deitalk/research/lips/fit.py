"""Curves of a corpus whose lips do on the head what was measured on people.

Letters: T frames at 30 per second, C controls, M measures.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from deitalk.emotions import EMOTIONS
from deitalk.models.curve_model import DEITalk
from deitalk.research.lips.head_lips import HeadLips
from deitalk.research.lips.nearest import nearest_curves
from rig import ControlSet

LOOSENESS = {
    "CTRL_C_jaw.ty": 0.5,
    "upperLipRaise": 0.4,
    "lowerLipDepress": 0.4,
    "funnel": 0.4,
    "purse": 0.4,
    "stretch.ty": 0.4,
    "corner.t": 0.4,
    "cornerPull": 0.4,
    "cornerDepress": 0.4,
    "ChinRaise": 0.4,
    "towards": 0.4,
    "mouth_press": 0.4,
    "pushPull": 0.4,
    "lipsTogether": 0.25,
}
"""Controls that `fit_curves` moves, by parts of their names, and how far it readily does."""


KEPT = ("neck", "tongue", "lipsTowardsTeeth")


TOLERANCE_CM = (0.02, 0.03, 0.04, 0.03, 0.03, 0.04)
"""Error of each measure that costs as much as a control moved by its looseness."""


@torch.no_grad()
def neutral_reading(
    model: DEITalk, sound: Tensor, n_frames: int, listener: DEITalk | None = None
) -> tuple[Tensor, Tensor]:
    """Speech features of a recording and the network's neutral curves, no rule applied.

    Parameters
    ----------
    model : DEITalk
        In evaluation mode.
    sound : Tensor [shape=(S,)]
        16 kHz, level-normalised.
    n_frames : int
        Rig frames T.
    listener : DEITalk or None
        Model whose frontend gives the features instead.

    Returns
    -------
    features : Tensor [shape=(T, D)]
    curves : Tensor [shape=(T, C)]
        Within the ranges of the controls.
    """
    controls = model.controls
    analysis = model.analyse(sound, n_frames)
    style = torch.eye(len(EMOTIONS))[EMOTIONS.index("neutral")]
    curves = model.decode(analysis, style.expand(n_frames, -1))
    low, high = torch.tensor(controls.minimum), torch.tensor(controls.maximum)
    speech = analysis.speech if listener is None else listener.frontend.encode(sound, n_frames)
    return speech, curves.clamp(low, high).float()


def looseness(controls: ControlSet, kept: Sequence[str] = ()) -> Tensor:
    """How far `fit_curves` readily moves every control [shape=(C,)]; 0 keeps it."""
    return torch.tensor(
        [
            0.0
            if any(part in name for part in (*KEPT, *kept))
            else next((far for part, far in LOOSENESS.items() if part in name), 0.0)
            for name in controls.names
        ]
    )


def fit_curves(
    prior: Tensor,
    measures: Tensor,
    lips: HeadLips,
    controls: ControlSet,
    kept: Sequence[str] = (),
) -> Tensor:
    """Curves near a prediction whose lips on the head do what was measured.

    Every frame minimises the squared errors of the measures over `TOLERANCE_CM` plus the squared
    moves of the controls over `LOOSENESS` (`nearest_curves`). Since both sides of the face are
    measured together, they move alike.

    Parameters
    ----------
    prior : Tensor [shape=(T, C)]
        Predicted curves; what the measures leave open stays as predicted.
    measures : Tensor [shape=(T, M)]
        Displacements from rest, cm; rows with NaN leave the frame as predicted.
    lips : HeadLips
        The head.
    controls : ControlSet
        Columns of `prior`.
    kept : sequence of str
        Controls that stay too, by parts of their names.

    Returns
    -------
    Tensor [shape=(T, C)]
        Within the ranges of the controls.
    """
    return nearest_curves(
        prior,
        measures,
        lips,
        looseness(controls, kept),
        torch.tensor(TOLERANCE_CM),
        controls,
    )
