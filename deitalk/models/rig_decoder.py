"""Emotion-guided decoder: speech, style and intensity to control curves (DEITalk §3.4, Eq. 7)."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from deitalk.errors import ConfigError
from deitalk.models.temporal_conv import TemporalConv, receptive_margin
from rig import ControlSet
from rig.errors import quoted

DECISION_SLOPE = 8.0
"""Logits per unit of the last layer where it decides a contact; one half stays one half."""


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
    causal : bool
        Deviation: a frame depends on earlier ones only, for a voice that has not ended.
    contacts : Tensor [shape=(C,)] or None
        True for lip contacts. Their outputs pass a logistic function, because lips meet or do not:
        a linear layer that is torn between both gives lips that almost meet (not in the paper).
    kept : Tensor [shape=(C,)] or None
        True where another decoder of the same shape gives the curves, that of the model before its
        fine-tuning: what captures do not show stays exactly as it was (not in the paper).
    """

    is_kept: Tensor | None
    is_contact: Tensor | None

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
        causal: bool = False,
        contacts: Tensor | None = None,
        kept: Tensor | None = None,
    ) -> None:
        super().__init__()
        self.residual = residual
        self.register_buffer("is_kept", kept, persistent=False)
        self.register_buffer("is_contact", contacts, persistent=False)
        self.kept: RigDecoder | None = None
        if kept is not None:
            self.kept = RigDecoder(
                in_size=in_size,
                style_size=style_size,
                guidance_size=guidance_size,
                channels=channels,
                dilations=dilations,
                kernel_size=kernel_size,
                n_emotions=n_emotions,
                rest=rest,
                residual=residual,
                contacts=contacts,
            )
        self.margin = receptive_margin(dilations, kernel_size, causal=causal)
        self.style = nn.Linear(n_emotions, style_size, bias=False)
        self.actors = nn.Linear(n_actors, style_size, bias=False) if n_actors else None
        extra = style_size + guidance_size
        widths = [in_size] + [channels] * len(dilations)
        self.layers = nn.ModuleList(
            TemporalConv(width + extra, channels, kernel_size, dilation, dropout, causal=causal)
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
        curves = self.curves(self.hidden(speech, emotion, guidance))
        if self.kept is None or self.is_kept is None:
            return curves
        return torch.where(self.is_kept, self.kept(speech, emotion, guidance), curves)

    def hidden(self, speech: Tensor, emotion: Tensor, guidance: Tensor | None) -> Tensor:
        """Input of the last layer [shape=(B, T, channels)]; arguments as `forward`."""
        x, extra = self._inputs(speech, emotion, guidance)
        for i, layer in enumerate(self.layers):
            x = self._joined(i, x, layer(torch.cat((x, extra), dim=1)))
        return x.transpose(1, 2)

    def curves(self, hidden: Tensor) -> Tensor:
        """Curves (..., C) of the rows (..., channels) that `hidden` gives."""
        curves: Tensor = self.output(hidden)
        if self.is_contact is None:
            return curves
        decided = torch.sigmoid(DECISION_SLOPE * (curves - 0.5))
        return torch.where(self.is_contact, decided, curves)

    def first_past(self, batch: int) -> tuple[Tensor, ...]:
        """What each causal layer was given before the first frame: zeros (B, channels, span)."""
        layers = [layer for layer in self.layers if isinstance(layer, TemporalConv)]
        return tuple(
            layer.conv.weight.new_zeros(batch, layer.conv.in_channels, layer.span)
            for layer in layers
        )

    def advance(
        self, speech: Tensor, emotion: Tensor, guidance: Tensor | None, past: tuple[Tensor, ...]
    ) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Decode the next frames of streams with causal layers.

        Parameters
        ----------
        speech, emotion, guidance
            As for `forward`.
        past : tuple of Tensor
            From `first_past`, or from the call before.

        Returns
        -------
        curves : Tensor [shape=(B, T, C)]
        past : tuple of Tensor
            For the next call.
        """
        x, extra = self._inputs(speech, emotion, guidance)
        kept = []
        for i, layer in enumerate(self.layers):
            given = torch.cat((x, extra), dim=1)
            kept.append(torch.cat((past[i], given), dim=2)[..., given.shape[2] :])
            x = self._joined(i, x, layer(given, past[i]))
        return self.curves(x.transpose(1, 2)), tuple(kept)

    def _joined(self, i: int, x: Tensor, out: Tensor) -> Tensor:
        return (x + out) / 2**0.5 if self.residual and i else out

    def _inputs(
        self, speech: Tensor, emotion: Tensor, guidance: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """Speech (B, D, T), and what joins it before each layer (B, style + E, T)."""
        if emotion.dim() == 2:
            emotion = emotion.unsqueeze(1).expand(-1, speech.shape[1], -1)
        n_emotions = self.style.in_features
        style = self.style(emotion[..., :n_emotions])
        if self.actors is not None and emotion.shape[-1] > n_emotions:
            style = style + self.actors(emotion[..., n_emotions:])
        extra = style if guidance is None else torch.cat((style, guidance), dim=-1)
        return speech.transpose(1, 2), extra.transpose(1, 2)


def control_mask(setting: str, names: Sequence[str], controls: ControlSet) -> Tensor | None:
    """True at the places of the controls that a setting of the model names [shape=(C,)].

    None if it names none.

    Raises
    ------
    ConfigError
        If a name is no control of the rig.
    """
    unknown = [name for name in names if name not in controls.names]
    if unknown:
        raise ConfigError(f"model.{setting}: {quoted(unknown[0])} is no control of the rig")
    if not names:
        return None
    return torch.tensor([name in names for name in controls.names])
