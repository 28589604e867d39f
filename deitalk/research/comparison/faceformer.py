"""FaceFormer's decoder: every frame from the speech and the frames before it (Fan et al. 2022).

Deviations: the style is the emotion (and the actor), not a speaker of the training; curves minus
those of the face at rest take the place of vertices minus a template; speech features and curves
have one rate.
"""

import torch
from torch import Tensor, nn

from deitalk.emotions import EMOTIONS
from deitalk.models.rig_decoder import Decoder
from deitalk.research.comparison.biased_attention import (
    BiasedLayer,
    KeysAndValues,
    periodic_positions,
)
from deitalk.research.config import ComparedModelConfig

CONTEXT_FRAMES = 300
"""Frames that are decoded before a piece of a long clip."""


class FaceFormerDecoder(Decoder):
    """An autoregressive transformer decoder of one layer.

    Frame t begins as the projection of the curves of frame t - 1 plus the style, the first frame
    as the style alone; the periodic position is added; the layer attends to the frames before, then
    to the speech of frame t. In training too the frames before are its own predictions, not the
    captured ones (the paper's scheme).

    Deviation: clips of more than 34 s are decoded in pieces of 34 s, each after `CONTEXT_FRAMES`.

    Parameters
    ----------
    config : ComparedModelConfig
        Its ``decoder_channels``, ``decoder_heads`` and ``decoder_period``.
    in_size : int
        Width of the speech features.
    rest : Tensor [shape=(C,)]
        Curves of the face at rest; the last layer starts there.
    """

    rest: Tensor
    style: nn.Linear

    def __init__(self, config: ComparedModelConfig, in_size: int, rest: Tensor) -> None:
        super().__init__()
        width = config.decoder_channels
        self.margin = CONTEXT_FRAMES
        self.style, self.actors = style_layers(config, width)
        self.speech = nn.Linear(in_size, width)
        self.motion = nn.Linear(len(rest), width)
        self.layer = BiasedLayer(
            width, width, config.decoder_heads, config.decoder_period, config.dropout
        )
        self.output = output_layer(width, rest)
        self.register_buffer("rest", rest, persistent=False)

    def hidden(self, speech: Tensor, emotion: Tensor, guidance: Tensor | None) -> Tensor:
        """Input of the last layer [shape=(B, T, decoder_channels)]; no guidance is used."""
        n_frames, width = speech.shape[1], self.motion.out_features
        style = self.styles(emotion, n_frames)
        known = style + periodic_positions(n_frames, width, self.layer.period).to(style)
        seen = self.layer.aligned(self.speech(speech))
        # From a frame's hidden row to the next one's input: the last layer and the projection.
        across = self.motion.weight @ self.output.weight
        offset = self.motion.weight @ (self.output.bias - self.rest) + self.motion.bias
        past: KeysAndValues | None = None
        rows: list[Tensor] = []
        for x, frame in zip(known.unbind(dim=1), seen.unbind(dim=1), strict=True):
            before = rows[-1] @ across.T + offset if rows else 0
            row, past = self.layer.step(x + before, frame, past)
            rows.append(row)
        return torch.stack(rows, dim=1)


def style_layers(config: ComparedModelConfig, width: int) -> tuple[nn.Linear, nn.Linear | None]:
    """Embeddings of the emotional styles, and of the actors, which begin at 0."""
    style = nn.Linear(len(EMOTIONS), width, bias=False)
    if not config.actors:
        return style, None
    actors = nn.Linear(len(config.actors), width, bias=False)
    nn.init.zeros_(actors.weight)
    return style, actors


def output_layer(width: int, rest: Tensor) -> nn.Linear:
    """Last layer, which begins with curves near those of the face at rest."""
    layer = nn.Linear(width, len(rest))
    nn.init.normal_(layer.weight, std=0.01)
    with torch.no_grad():
        layer.bias.copy_(rest)
    return layer
