"""Networks as graphs: sound and emotion of a whole clip in, or the next frames of streams.

The layers are those of the model; what lies between them is written without operations that other
runtimes lack.
"""

import math
from copy import copy
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.errors import CheckpointError
from deitalk.frontends.whisper import WhisperFrontend
from deitalk.models.causal_model import causal_frontend, first_state
from deitalk.models.curve_model import DEITalk
from deitalk.models.intensity import local_maximum
from deitalk.models.onnx.spectra import with_formulas
from deitalk.models.onnx.whisper_graph import WhisperGraph
from deitalk.models.protocol import neutral_weights

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

    neutral: Tensor
    frequency: Tensor

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
        self.register_buffer("neutral", torch.from_numpy(neutral_weights(1)))
        size = model.frontend.output_size
        exponent = torch.arange(0, size, 2, dtype=torch.float32) / size
        self.register_buffer("frequency", 20 * math.pi * 10000.0**-exponent)

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
        speech = self.frontend(sound, emotion.shape[0], peak)
        intensity = self._intensity(speech)
        placed = speech
        if self.model.config.positions:
            angle = place[:, None] * self.frequency
            waves = torch.stack((angle.sin(), angle.cos()), dim=-1).flatten(-2)
            placed = speech + waves[:, : speech.shape[-1]]
        n_emotions = self.neutral.shape[1]
        plain = torch.cat((0 * emotion[:, :n_emotions] + self.neutral, emotion[:, n_emotions:]), 1)
        saliency, strength, guidance = intensity
        readings = self.model.decoder(
            placed.expand(2, -1, -1), torch.stack((plain, emotion)), guidance.expand(2, -1, -1)
        )
        if self.model.lips is not None:
            readings = self.model.lips.correct(readings, self.model.lips(speech)[0])
        rows = readings[1], readings[0], saliency[0], strength[0]
        effort = self.model.intensity.effort
        return rows if effort is None else (*rows, effort(speech)[0, :, 0])

    def _intensity(self, speech: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Saliency, strength (1, T) and guidance (1, T, E or 2 E), as `DynamicIntensity`."""
        module = self.model.intensity
        features = module.project(speech)
        saliency = self._saliency(features)
        strength = torch.sigmoid(4 * (F.softplus(module.slope) * saliency + module.offset))
        guidance = saliency.unsqueeze(-1) * features
        if module.kept is not None:
            before = module.kept(speech)
            kept = self._saliency(before).unsqueeze(-1) * before
            guidance = torch.cat((guidance, kept), dim=-1)
        return saliency, strength, guidance

    def _saliency(self, features: Tensor) -> Tensor:
        """Cosine of every frame with the largest values around it (1, T)."""
        frames = self.model.intensity.saliency_frames
        if frames is None:
            around = features.amax(dim=1, keepdim=True)
        else:
            around = local_maximum(features, frames)
        return (features * around).sum(dim=-1) / (_norm(features) * _norm(around))


def _norm(features: Tensor) -> Tensor:
    return features.square().sum(dim=-1).sqrt().clamp_min(1e-8)


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
