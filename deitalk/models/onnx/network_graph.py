"""Networks as graphs: sound and emotion of a whole clip in, or the next frames of streams.

The layers are those of the model; what lies between them is written without operations that other
runtimes lack.
"""

from copy import copy
from typing import cast

import torch
from torch import Tensor, nn

from deitalk.errors import CheckpointError
from deitalk.frontends.whisper import WhisperFrontend
from deitalk.models.causal_model import causal_frontend, first_state, plain_styles
from deitalk.models.curve_model import DEITalk
from deitalk.models.onnx.spectra import with_formulas
from deitalk.models.onnx.whisper_graph import WhisperGraph

OUTPUTS, EFFORT = ("curves", "neutral", "saliency", "intensity"), "effort"
"""Outputs of the graphs, in their order; a whole clip has the last one where a model reads it."""


class CurveGraph(nn.Module):
    """A curve model, arguments and results without a batch.

    Parameters
    ----------
    model : DEITalk
        With a Whisper frontend and an intensity module.

    Raises
    ------
    CheckpointError
        If it has other ones.
    """

    def __init__(self, model: DEITalk) -> None:
        super().__init__()
        self.model = model
        if model.config.own_decoder is not None:
            raise CheckpointError("an own decoder has no graph: what it does is not known")
        if model.config.frontend.kind != "whisper" or not model.config.intensity:
            raise CheckpointError(
                "only models with a Whisper frontend and an intensity module have a graph, such as "
                "default and live"
            )
        self.frontend = WhisperGraph(cast("WhisperFrontend", model.frontend))

    def forward(
        self, sound: Tensor, emotion: Tensor, place: Tensor, peak: Tensor | None = None
    ) -> tuple[Tensor, ...]:
        """Predict a clip: `OUTPUTS`, and `EFFORT`.

        Parameters
        ----------
        sound : Tensor [shape=(S,)]
            16 kHz, level-normalised.
        emotion : Tensor [shape=(T, 5 + actors)]
            Weights of the styles.
        place : Tensor [shape=(T,), range 0 to 1]
            Frame i of T as i / T.
        peak : Tensor [shape=()]
            See `WhisperGraph.forward`; without it the clip is whole.
        """
        model, speech = self.model, self.frontend(sound, emotion.shape[0], peak)
        intensity = model.intensity(speech)
        readings = model.decoder(
            model.place(speech, place[None], torch.ones(1)).expand(2, -1, -1),
            torch.stack((plain_styles(emotion), emotion)),
            intensity.guidance.expand(2, -1, -1),
        )
        if model.lips is not None:
            readings = model.lips.correct(readings, model.lips(speech)[0])
        rows = readings[1], readings[0], intensity.saliency[0], intensity.strength[0]
        return rows if intensity.effort is None else (*rows, intensity.effort[0])


def causal_graph(model: DEITalk) -> DEITalk:
    """A copy of a causal model, with its weights, whose operators a graph can have."""
    found = copy(model)
    found._modules = dict(model._modules)
    found.frontend = with_formulas(causal_frontend(model))
    return found


def first_states(model: DEITalk) -> dict[str, Tensor]:
    """Names and first values of a stream's state but its level, without the stream's axis."""
    state = first_state(model, 1)
    looks = enumerate(causal_frontend(model).ahead)
    names = ["mel", "place"]
    parts = "rows", "keys", "values"
    names += [f"{part}_{k}" for k, ahead in looks for part in parts[0 if ahead else 1 :]]
    names += ["saliency_past"]
    names += [f"decoder_{i}" for i in range(len(state.decoder))]
    names += ["lips_past"] * len(state.lips)
    finite = (part[0].clamp_min(torch.finfo(torch.float32).min) for part in state.tensors()[1:])
    return dict(zip(names, cast("list[Tensor]", list(finite)), strict=True))
