"""Emotion-guided decoder: speech, style and intensity to control curves (DEITalk §3.4, Eq. 7)."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from deitalk.models.temporal_conv import TemporalConv, receptive_margin


class RigDecoder(nn.Module):
    """Eight dilated convolutions; style and intensity join the features before each of them.

    Parameters
    ----------
    in_size : int
        Width of the speech features.
    style_size, guidance_size : int
        Width of the style embedding E_sty (16) and of the intensity E_in (128; 0 leaves it out).
    channels : int
        Filters of every layer (512).
    dilations : sequence of int
    kernel_size : int
    n_emotions : int
    rest : Tensor [shape=(C,)]
        Curves of the face at rest; the last layer starts there.
    dropout : float
    residual : bool
        Add a layer's input to its output, the first excepted (not in the paper).
    n_actors : int
        Actors whose styles are added to the emotional one; they begin at 0 (not in the paper).
    """

    def __init__(
        self,
        *,
        in_size: int,
        style_size: int,
        guidance_size: int,
        channels: int,
        dilations: Sequence[int],
        kernel_size: int,
        n_emotions: int,
        rest: Tensor,
        dropout: float = 0.0,
        residual: bool = False,
        n_actors: int = 0,
    ) -> None:
        super().__init__()
        self.residual = residual
        self.margin = receptive_margin(dilations, kernel_size)
        self.style = nn.Linear(n_emotions, style_size, bias=False)
        self.actors = nn.Linear(n_actors, style_size, bias=False) if n_actors else None
        extra = style_size + guidance_size
        widths = [in_size] + [channels] * len(dilations)
        self.layers = nn.ModuleList(
            TemporalConv(width + extra, channels, kernel_size, dilation, dropout)
            for width, dilation in zip(widths, dilations, strict=False)
        )
        self.output = nn.Linear(channels, len(rest))
        nn.init.normal_(self.output.weight, std=0.01)
        with torch.no_grad():
            self.output.bias.copy_(rest)
            if self.actors is not None:
                self.actors.weight.zero_()

    def forward(self, speech: Tensor, emotion: Tensor, guidance: Tensor | None) -> Tensor:
        """Decode one window or clip.

        Parameters
        ----------
        speech : Tensor [shape=(B, T, D)]
            With its positional encoding added.
        emotion : Tensor [shape=(B, 5 + A) or (B, T, 5 + A)]
            Weights of the emotional styles, of which the paper's is one-hot and constant, then of
            the actors; these may be left out.
        guidance : Tensor [shape=(B, T, E)] or None
            E_in; None if the decoder was made without.

        Returns
        -------
        Tensor [shape=(B, T, C)]
        """
        curves: Tensor = self.output(self.hidden(speech, emotion, guidance))
        return curves

    def hidden(self, speech: Tensor, emotion: Tensor, guidance: Tensor | None) -> Tensor:
        """Input of the last layer [shape=(B, T, channels)]; arguments as `forward`."""
        if emotion.dim() == 2:
            emotion = emotion.unsqueeze(1).expand(-1, speech.shape[1], -1)
        n_emotions = self.style.in_features
        style = self.style(emotion[..., :n_emotions])
        if self.actors is not None and emotion.shape[-1] > n_emotions:
            style = style + self.actors(emotion[..., n_emotions:])
        extra = style if guidance is None else torch.cat((style, guidance), dim=-1)
        extra = extra.transpose(1, 2)  # (B, style + E, T)
        x = speech.transpose(1, 2)  # (B, D, T)
        for i, layer in enumerate(self.layers):
            out = layer(torch.cat((x, extra), dim=1))
            x = (x + out) / 2**0.5 if self.residual and i else out
        return x.transpose(1, 2)
