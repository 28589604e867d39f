"""One frame of a causal curve model as a graph for ONNX: sound and state in, curves and state out.

The level of the sound follows itself from frame to frame, so a graph of several frames would need a
loop; one frame a call needs none.
"""

from copy import deepcopy
from typing import cast

import torch
from torch import Tensor, nn

from deitalk.models.causal_torch import TensorState, advance, causal_frontend, first_state
from deitalk.models.curve_model import DEITalk
from deitalk.models.onnx.whisper_graph import ProductMel

OUTPUTS = ("curves", "neutral", "saliency", "intensity")


class CausalGraph(nn.Module):
    """A causal curve model, one frame of B streams a call.

    Parameters
    ----------
    model : DEITalk
        With a causal frontend.
    """

    def __init__(self, model: DEITalk) -> None:
        super().__init__()
        self.model = deepcopy(model)
        frontend = causal_frontend(self.model)
        frontend.mel = ProductMel.of(frontend.mel)

    def forward(self, windows: Tensor, emotion: Tensor, *state: Tensor) -> tuple[Tensor, ...]:
        """Predict the next frame.

        Parameters
        ----------
        windows : Tensor [shape=(B, P, W)]
            Samples of the spectra of one rig frame.
        emotion : Tensor [shape=(B, 5 + actors)]
            Weights of the styles.
        state : Tensor
            From the call before; see `first_states`.
        """
        before = TensorState.of(state, causal_frontend(self.model).n_states)
        rows, after = advance(self.model, windows, emotion[:, None], before)
        frame = (rows.emotional, rows.neutral, rows.saliency, rows.strength)
        return (*(part[:, 0] for part in frame), *after.tensors())


def first_states(model: DEITalk) -> dict[str, Tensor]:
    """Names and first values of a stream's state, without the stream's axis."""
    state = first_state(model, 1)
    layers = range(len(state.frontend.layers) // 3)
    names = ["level", "mel", "place"]
    names += [f"{part}_{k}" for k in layers for part in ("rows", "keys", "values")]
    names += ["saliency_past"]
    names += [f"{k}_{i}" for k in ("neutral", "emotional") for i in range(len(state.neutral))]
    finite = (part[0].clamp_min(torch.finfo(torch.float32).min) for part in state.tensors())
    return dict(zip(names, cast("list[Tensor]", list(finite)), strict=True))
