"""Emotion-guided decoder: speech, style and intensity to control curves (DEITalk §3.4, Eq. 7)."""

import itertools
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from typing import Any, ClassVar, Literal, cast

import torch
from torch import Tensor, nn

from deitalk.config.curves import ModelConfig
from deitalk.emotions import EMOTIONS
from deitalk.errors import CheckpointError
from deitalk.models.joined import JoinedClips
from deitalk.models.temporal_conv import JoinedRows, TemporalConv, receptive_margin
from deitalk.models.tuned_parts import ActorLayers, BaseChange
from rig import ControlSet
from rig.errors import quoted


class Decoder(nn.Module):
    """What every decoder of curves has, whatever its layers.

    Attributes
    ----------
    margin : int
        Frames on either side that a frame's curves depend on.
    style : nn.Linear or None
        Embedding of the emotional styles; None if the decoder is not given the emotion.
    actors : nn.Linear or None
        Embedding of the actors, added to it.
    output : nn.Linear
        Last layer: `hidden` to curves.
    joins : bool
        Whether it reads several recordings in one pass: `readings` with `JoinedClips`.
    """

    joins = False
    margin: int
    style: nn.Linear | None
    actors: nn.Linear | None
    output: nn.Linear

    def forward(self, speech: Tensor, emotion: Tensor, guidance: Tensor | None) -> Tensor:
        """Map a window or clip to curves (B, T, C); arguments as `RigDecoder.forward`."""
        curves: Tensor = self.output(self.hidden(speech, emotion, guidance))
        return curves

    def hidden(self, speech: Tensor, emotion: Tensor, guidance: Tensor | None) -> Tensor:
        """Input of the last layer (B, T, channels); arguments as `RigDecoder.forward`."""
        raise NotImplementedError

    @torch.no_grad()
    def hidden_readings(
        self,
        speech: Tensor,
        emotions: Tensor,
        guidance: Tensor | None,
        clips: JoinedClips | None = None,
    ) -> Tensor:
        """Input of the last layer for several readings of one speech, without gradients.

        Parameters
        ----------
        speech : Tensor [shape=(1, T, D)]
            With its positional encoding added.
        emotions : Tensor [shape=(R, T, 5 + A)]
            Of each reading, as for `RigDecoder.forward`.
        guidance : Tensor [shape=(1, T, E)] or None
            As for `RigDecoder.forward`.
        clips : JoinedClips or None
            The recordings that the frames are of, where it `joins` them.

        Returns
        -------
        Tensor [shape=(R, T, channels)]
        """
        size = len(emotions), -1, -1
        shared = None if guidance is None else guidance.expand(size)
        return self.hidden(speech.expand(size), emotions, shared)

    @torch.no_grad()
    def readings(self, speech: Tensor, emotions: Tensor, guidance: Tensor | None) -> Tensor:
        """Curves (R, T, C) of several readings of one speech; arguments as `hidden_readings`."""
        curves: Tensor = self.output(self.hidden_readings(speech, emotions, guidance))
        return curves

    def styles(self, emotion: Tensor, n_frames: int) -> Tensor:
        """Style embedding of every frame (B, T, style) from weights (B, 5 + A) or (B, T, 5 + A)."""
        assert self.style is not None
        if emotion.dim() == 2:
            emotion = emotion.unsqueeze(1).expand(-1, n_frames, -1)
        n_emotions = self.style.in_features
        style: Tensor = self.style(emotion[..., :n_emotions])
        if self.actors is not None and emotion.shape[-1] > n_emotions:
            style = style + self.actors(emotion[..., n_emotions:])
        return style


class RigDecoder(Decoder):
    """Eight dilated convolutions; style and intensity join the features before each of them.

    A class of it with another `hidden` is an own decoder, see docs/finetuning.md.

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
    kept : Tensor [shape=(C,)] or None
        True where another decoder of the same shape gives the curves, that of the model before its
        fine-tuning: what captures do not show stays exactly as it was (not in the paper).
    captured : sequence of bool
        Emotions that captures show, for `BaseChange`, whose decoder is that one too; empty: the
        decoder gives all emotions.
    n_base : int or None
        Controls of the model before the fine-tuning, where they are another rig's; 0: nothing is
        known of it, and emotions that captures lack pass as the first captured one.
    direct : bool
        The last layer has the speech features of its frame too, and so can be any linear map of
        them (not in the paper).
    actor_layers : bool or "offsets"
        Add `ActorLayers`, or offsets alone.
    """

    joins = True
    is_kept: Tensor | None
    style: nn.Linear
    own: ClassVar[dict[str, "type[RigDecoder]"]] = {}
    """Classes of it that were imported, by ``module:Class``."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        RigDecoder.own[f"{cls.__module__}:{cls.__qualname__}"] = cls
        if "hidden" in vars(cls) and "hidden_readings" not in vars(cls):
            cls.hidden_readings = Decoder.hidden_readings  # type: ignore[method-assign]
            cls.joins = False

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
        kept: Tensor | None = None,
        captured: Sequence[bool] = (),
        n_base: int | None = None,
        direct: bool = False,
        actor_layers: bool | Literal["offsets"] = False,
    ) -> None:
        super().__init__()
        self.residual, self.guidance_size, self.direct = residual, guidance_size, direct
        self.register_buffer("is_kept", kept, persistent=False)
        self.kept: RigDecoder | None = None
        base_rest = rest if n_base is None else rest.new_zeros(n_base)
        self.change = BaseChange(captured, len(rest), len(base_rest)) if any(captured) else None
        if kept is not None or (self.change is not None and len(base_rest)):
            self.kept = RigDecoder(
                in_size=in_size,
                style_size=style_size,
                guidance_size=guidance_size,
                channels=channels,
                dilations=dilations,
                kernel_size=kernel_size,
                n_emotions=n_emotions,
                rest=base_rest,
                residual=residual,
                causal=causal,
                direct=direct,
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
        size = channels + (in_size if direct else 0)
        own = 0 if actor_layers == "offsets" else size
        self.actor_layers = ActorLayers(n_actors, len(rest), own) if actor_layers else None
        self.output = nn.Linear(size, len(rest))
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
        guidance : Tensor [shape=(B, T, E) or (B, T, 2 E)] or None
            E_in, and that of the kept decoder if it is another; None if the decoder was made
            without.

        Returns
        -------
        Tensor [shape=(B, T, C)]
        """
        kept, theirs = self.kept, self._of_kept(guidance)
        return self._combined(
            emotion,
            lambda styles: self.curves(self.hidden(speech, styles, guidance), styles),
            None if kept is None else lambda styles: kept(speech, styles, theirs),
        )

    @torch.no_grad()
    def readings(
        self,
        speech: Tensor,
        emotions: Tensor,
        guidance: Tensor | None,
        clips: JoinedClips | None = None,
    ) -> Tensor:
        """Curves (R, T, C) of several readings of one speech; arguments as `hidden_readings`."""
        kept, theirs = self.kept, self._of_kept(guidance)

        def own(styles: Tensor) -> Tensor:
            return self.curves(self.hidden_readings(speech, styles, guidance, clips), styles)

        return self._combined(
            emotions,
            _EachOnce(own),
            None
            if kept is None
            else _EachOnce(lambda styles: kept.readings(speech, styles, theirs, clips)),
        )

    def _combined(
        self,
        emotion: Tensor,
        own: Callable[[Tensor], Tensor],
        kept: Callable[[Tensor], Tensor] | None,
    ) -> Tensor:
        """Curves from those of the own layers and those of the kept decoder for some styles."""
        change = self.change
        if change is None or kept is None:
            curves = own(emotion if change is None else change.captured(emotion))
            if self.is_kept is None or kept is None:
                return curves
            return torch.where(self.is_kept, kept(emotion), curves)
        base = kept(emotion)
        shown = change.captured(emotion)
        curves = own(shown) + change(base - kept(shown), emotion, shown)
        if not change.is_whole:
            plain = change.plain(emotion)
            others = own(plain) + change(base - kept(plain), emotion, plain)
            curves = others + change.share(shown) * (curves - others)
        return curves if self.is_kept is None else torch.where(self.is_kept, base, curves)

    def curves(self, hidden: Tensor, emotion: Tensor) -> Tensor:
        """The last layer, and those of the actors."""
        curves: Tensor = self.output(hidden)
        return curves if self.actor_layers is None else curves + self.actor_layers(hidden, emotion)

    def _of_kept(self, guidance: Tensor | None) -> Tensor | None:
        """Guidance of the kept decoder."""
        return guidance if guidance is None else guidance[..., -self.guidance_size :]

    def hidden(self, speech: Tensor, emotion: Tensor, guidance: Tensor | None) -> Tensor:
        """Input of the last layer [shape=(B, T, channels)]; arguments as `forward`."""
        x, extra = self.inputs(speech, emotion, guidance)
        for i, layer in enumerate(self.layers):
            x = self._joined(i, x, layer(torch.cat((x, extra), dim=1)))
        return self.with_speech(x.transpose(1, 2), speech)

    def with_speech(self, hidden: Tensor, speech: Tensor) -> Tensor:
        """Input of the last layer from what is before it (B, T, channels)."""
        if not self.direct:
            return hidden
        return torch.cat((hidden, speech.expand(*hidden.shape[:-1], -1)), dim=-1)

    @torch.no_grad()
    def hidden_readings(
        self,
        speech: Tensor,
        emotions: Tensor,
        guidance: Tensor | None,
        clips: JoinedClips | None = None,
    ) -> Tensor:
        """Input of the last layer for several readings of one speech, by products of matrices.

        What they share, speech and in each layer intensity, is computed once. Arguments as
        `Decoder.hidden_readings`; with `clips` the frames are those of several, none of which
        depends on another.
        """
        layers = cast("list[TemporalConv]", list(self.layers))
        gap, spoken, gaps = max(layer.reach for layer in layers), speech, None
        styles = self.styles(emotions, speech.shape[1])
        if clips is not None:
            gaps = clips.gaps(gap)
            speech, styles = (clips.spread(rows, gap) for rows in (speech, styles))
            guidance = None if guidance is None else clips.spread(guidance, gap)
        (_, length, width), channels = speech.shape, layers[0].conv.out_channels
        size = channels + self.style.out_features
        given = JoinedRows(1, length, width + self.guidance_size, gap, speech)
        given.rows[..., :width] = speech
        if guidance is not None:
            given.rows[..., width:] = guidance[..., : self.guidance_size]
        shared = JoinedRows(1, length, channels, gap, speech)
        x, out = (JoinedRows(len(emotions), length, size, gap, speech) for _ in range(2))
        x.rows[..., channels:] = out.rows[..., channels:] = styles
        # Columns: x has those of the layer before, then the style; a layer's weights have guidance
        # after them. Nothing comes before the first layer but speech.
        for i, layer in enumerate(layers):
            before = channels if i else width
            style = before + self.style.out_features
            assert layer.conv.bias is not None
            shared.inner()[:] = layer.conv.bias
            if not i:
                layer.add_products(shared.inner(), given, slice(width), slice(width))
            layer.add_products(shared.inner(), given, slice(width, None), slice(style, None))
            out.rows[..., :channels] = shared.rows
            rows = out.inner()[:, :channels]
            own = slice(None) if i else slice(channels, None)
            layer.add_products(rows, x, own, slice(0 if i else before, style))
            rows.relu_()
            rows.copy_(self._joined(i, x.inner()[:, :channels], rows))
            out.gaps[..., :channels] = 0
            if gaps is not None:
                out.rows[..., :channels].index_fill_(1, gaps, 0)
            x, out = out, x
        hidden = x.rows[..., :channels]
        return self.with_speech(hidden if clips is None else clips.taken(hidden, gap), spoken)

    def first_past(self, batch: int) -> tuple[Tensor, ...]:
        """What each causal layer was given before the first frame: zeros (B, span, channels).

        With a kept decoder, those of every evaluation of both, in the order of `_combined`.
        """
        layers = cast("list[TemporalConv]", list(self.layers))
        own = tuple(
            layer.conv.weight.new_zeros(batch, layer.span, layer.conv.in_channels)
            for layer in layers
        )
        if self.kept is None:
            return own
        count = 1 if self.change is None else 2 if self.change.is_whole else 3
        return (own * max(count - 1, 1)) + self.kept.first_past(batch) * count

    def advance(
        self, speech: Tensor, emotion: Tensor, guidance: Tensor | None, past: tuple[Tensor, ...]
    ) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Decode the next frames of streams with causal layers.

        Parameters
        ----------
        speech, emotion, guidance
            As for `forward`, with any axes before the frames.
        past : tuple of Tensor
            From `first_past` [shape=(..., span, channels)], or from the call before.

        Returns
        -------
        curves : Tensor [shape=(..., T, C)]
        past : tuple of Tensor
            For the next call.
        """
        size, kept = len(self.layers), self.kept
        # Evaluations of the own layers among all: 1 of 2, 1 of 3, 2 of 5.
        split = len(past) if kept is None else size * max((len(past) // size) // 2, 1)
        pasts = [iter(part) for part in (past[:split], past[split:])]
        after: tuple[list[Tensor], list[Tensor]] = ([], [])

        def evaluate(decoder: RigDecoder, styles: Tensor, place: int) -> Tensor:
            before = tuple(itertools.islice(pasts[place], size))
            given = guidance if place == 0 else self._of_kept(guidance)
            curves, new = decoder._advance(speech, styles, given, before)
            after[place].extend(new)
            return curves

        curves = self._combined(
            emotion,
            lambda styles: evaluate(self, styles, 0),
            None if kept is None else lambda styles: evaluate(kept, styles, 1),
        )
        return curves, (*after[0], *after[1])

    def _advance(
        self, speech: Tensor, emotion: Tensor, guidance: Tensor | None, past: tuple[Tensor, ...]
    ) -> tuple[Tensor, tuple[Tensor, ...]]:
        """`advance` of the own layers alone."""
        x, extra, new = speech, self._extra(speech, emotion, guidance), []
        for i, layer in enumerate(cast("list[TemporalConv]", list(self.layers))):
            out, after = layer.advance(torch.cat((x, extra), dim=-1), past[i])
            x = self._joined(i, x, out)
            new.append(after)
        return self.curves(self.with_speech(x, speech), emotion), tuple(new)

    def _joined(self, i: int, x: Tensor, out: Tensor) -> Tensor:
        return (x + out) / 2**0.5 if self.residual and i else out

    def inputs(
        self, speech: Tensor, emotion: Tensor, guidance: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """Speech (B, D, T), and what joins it before each layer (B, style + E, T)."""
        return speech.transpose(1, 2), self._extra(speech, emotion, guidance).transpose(1, 2)

    def _extra(self, speech: Tensor, emotion: Tensor, guidance: Tensor | None) -> Tensor:
        """Style and intensity, which join the input of each layer (B, T, style + E)."""
        extra = self.styles(emotion, speech.shape[1])
        if guidance is None:
            return extra
        return torch.cat((extra, guidance[..., : self.guidance_size]), dim=-1)


class _EachOnce:
    """Curves of readings (R, T, C) by their styles (R, T, 5 + A), of equal styles computed once.

    On another device all are computed: to compare them would wait for it.
    """

    def __init__(self, curves: Callable[[Tensor], Tensor]) -> None:
        self.curves = curves
        self.styles: list[Tensor] = []
        self.found: list[Tensor] = []

    def __call__(self, emotions: Tensor) -> Tensor:
        if emotions.device.type != "cpu":
            return self.curves(emotions)
        known, places = len(self.styles), list[int]()
        for row in emotions:
            equal = (k for k, style in enumerate(self.styles) if torch.equal(style, row))
            places.append(next(equal, len(self.styles)))
            if places[-1] == len(self.styles):
                self.styles.append(row)
        if new := self.styles[known:]:
            self.found += self.curves(torch.stack(new)).unbind()
        return torch.stack([self.found[place] for place in places])


OWN_DECODERS = "deitalk.decoders"
"""Group of entry points by which an installed package makes its decoders known."""


def decoder_class(name: str | None) -> type[RigDecoder]:
    """The decoder's class; an own one that was imported, or that an entry point names.

    No other module is imported: a model folder does not choose what is executed.

    Raises
    ------
    CheckpointError
        If neither is so.
    """
    if name is None:
        return RigDecoder
    if name not in RigDecoder.own:
        for entry in entry_points(group=OWN_DECODERS):
            if entry.value == name:
                entry.load()
    if name not in RigDecoder.own:
        raise CheckpointError(
            f"own decoder {quoted(name)} is not known; import its module before the model is read, "
            f"or install a package that names it as an entry point of the group {OWN_DECODERS}"
        )
    return RigDecoder.own[name]


def build_decoder(
    config: ModelConfig, in_size: int, controls: ControlSet, *, causal: bool = False
) -> RigDecoder:
    """Build the decoder of a configuration.

    Parameters
    ----------
    config : ModelConfig
        The network's.
    in_size : int
        Width of the speech features.
    controls : ControlSet
        The rig.
    causal : bool
        As for `RigDecoder`.

    Raises
    ------
    CheckpointError
        If its own decoder is not known.
    """
    rest = torch.tensor(controls.rest)
    return decoder_class(config.own_decoder)(
        in_size=in_size,
        style_size=config.style_size,
        guidance_size=config.emotion_size if config.intensity else 0,
        channels=config.decoder_channels,
        dilations=config.decoder_dilations,
        kernel_size=config.kernel_size,
        n_emotions=len(EMOTIONS),
        n_actors=len(config.actors),
        rest=rest,
        dropout=config.dropout,
        residual=config.decoder_residual,
        causal=causal,
        kept=_mask(config.kept_controls, controls),
        captured=[emotion in config.captured_emotions for emotion in EMOTIONS],
        n_base=config.base_controls,
        direct=config.decoder_direct,
        actor_layers=config.actor_layers,
    )


def _mask(names: Sequence[str], controls: ControlSet) -> Tensor | None:
    """True at the places of some controls [shape=(C,)]; None without any."""
    if not names:
        return None
    return torch.tensor([name in names for name in controls.names])
