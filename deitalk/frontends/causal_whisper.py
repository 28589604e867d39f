"""Whisper's first layers on a voice that has not ended: bounded past, three frames of look-ahead.

Not in the papers, whose encoders need the whole clip. The weights are those of
`deitalk.frontends.whisper`, which were tuned to be read in this way too: a layer attends to
`PAST_FRAMES` before a frame and `LOOKAHEAD_FRAMES` after it, positions begin anew after `PERIOD`,
and in place of the loudest spectrum of the clip a fixed peak at a running level gives the floor.
Keys and values of the past are kept, so that every frame is computed once: a call gives those of
its frames, which take the places of the oldest. State is explicit: a clip in one piece and in any
pieces gives the same features, to rounding.

With three layers the features of frame t depend on the sound until 135 ms after it: on the spectra
of three more frames, the last centred at 3 2/3 frames and reaching 12.5 ms further.

Letters: B streams, W samples of a spectrum, P spectra of a rig frame, G frames of a call, F mel
bins, D width.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor
from torch.nn import functional as F

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.log_mel import SILENCE
from deitalk.audio.running_level import first_level, levelled
from deitalk.config.frontends import CausalWhisperConfig
from deitalk.frontends.base import Frontend
from deitalk.frontends.flat_kernel import FlatKernel, joined_taps
from deitalk.frontends.whisper import Layer, WhisperFrontend, scaled

PAST_FRAMES, LOOKAHEAD_FRAMES = 90, 1
"""Rig frames around one that a layer attends to."""
PEAK = 1.0
"""Logarithm to base 10 of the loudest mel power of speech at the normal level; .5 to 1.6."""
PERIOD = 10 * FRAME_RATE
"""Frames after which the positions of a stream begin anew."""
KEPT = PERIOD // 3
"""Rows whose keys and values a layer keeps between two calls, at least `PAST_FRAMES` and
`LOOKAHEAD_FRAMES`: row n of a stream at place n mod `KEPT`."""
UNSEEN = -1e9
"""Score of a key that a query does not attend to."""
STEM_SPECTRA = 2
"""Spectra before a frame's own that the two convolutions need."""
BLOCK_FRAMES = 256
"""Rig frames of a clip that are encoded at once."""


class CausalState(NamedTuple):
    """State of a stream between two calls."""

    level: Tensor
    """Running level and its weight [shape=(B, 2)]."""
    mel: Tensor
    """Last spectra [shape=(B, STEM_SPECTRA, F)]."""
    place: Tensor
    """Frames so far [shape=(B, 1)]; less a multiple of `PERIOD` where they are many."""
    layers: tuple[Tensor, ...]
    """Of each layer in turn: if it looks ahead, input whose look-ahead is to come
    [shape=(B, LOOKAHEAD_FRAMES, D)]; keys [shape=(B, heads, D / heads, KEPT)] and values
    [shape=(B, heads, KEPT, D / heads)] of the past, as products of matrices take them. Of what
    `CausalWhisperFrontend.read` returns, those of the new rows in their order."""

    def tensors(self) -> tuple[Tensor, ...]:
        """All of them, in a row."""
        return (self.level, self.mel, self.place, *self.layers)

    @classmethod
    def of(cls, tensors: tuple[Tensor, ...]) -> "CausalState":
        """The state that `tensors` gave."""
        level, mel, place, *layers = tensors
        return cls(level, mel, place, tuple(layers))


class CausalWhisperFrontend(WhisperFrontend):
    """Waveform to speech features at 30 Hz, from the past and a bounded look-ahead.

    Parameters
    ----------
    config : CausalWhisperConfig

    Attributes
    ----------
    output_size : int
        Width D of a row.
    delay : int
        Frames that must come after a frame's own before its features are known.
    lead : int
        Spectra of a frame that lie before it.
    rules_ahead : int
        Frames after a frame that its contacts see.
    rings : tuple of int
        Of each tensor of a `CausalState`, its axis of `KEPT` places; 0 if it has none.
    """

    is_causal = True
    encode_together = Frontend.encode_together

    def __init__(self, config: CausalWhisperConfig) -> None:
        super().__init__(config)
        depth = len(self.encoder.layers)
        self.lead, self.rules_ahead = config.lead, config.rules_ahead
        looking = depth if config.ahead is None else min(config.ahead, depth)
        self.ahead = [LOOKAHEAD_FRAMES] * looking + [0] * (depth - looking)
        self.delay = sum(self.ahead)
        each = [(0, 3, 2) if ahead else (3, 2) for ahead in self.ahead]
        self.rings = (0, 0, 0, *itertools.chain(*each))
        self._flat, self._flat_stem = FlatKernel(), FlatKernel()

    def first_state(self, batch: int) -> CausalState:
        """State of streams before their first sample."""
        weight, width = self.encoder.conv1.weight, self.output_size
        silence = weight.new_full((batch, STEM_SPECTRA, self.config.n_mels), math.log10(SILENCE))
        heads = self.config.heads
        keys, values = (heads, width // heads, KEPT), (heads, KEPT, width // heads)
        sizes = [
            size
            for ahead in self.ahead
            for size in ([(ahead, width)] if ahead else []) + [keys, values]
        ]
        return CausalState(
            torch.from_numpy(first_level(batch)).to(weight),
            scaled(silence, PEAK).transpose(1, 2),
            weight.new_zeros(batch, 1),
            tuple(weight.new_zeros(batch, *size) for size in sizes),
        )

    def features(self, waveform: Tensor, context: Any = None) -> Tensor:
        """Features (B, K, D) of (B, S)."""
        return self._pieces(waveform, self.count(waveform.shape[1]))

    def forward(self, waveform: Tensor, n_frames: int) -> Tensor:
        """Map (B, S) at 16 kHz to (B, n_frames, D); row i describes time i / 30 s."""
        return self._pieces(waveform, n_frames)

    @torch.no_grad()
    def encode(
        self,
        waveform: Tensor,
        n_frames: int,
        chunk_seconds: float | None = None,
        overlap_seconds: float | None = None,
        *,
        progress: Callable[[float], None] = lambda share: None,
        gain: float = 1.0,
    ) -> Tensor:
        """Map a whole clip (S,) to (n_frames, D), block by block: memory does not grow.

        As `StridedFrontend.encode`; there are no chunks, and `gain` changes only the first frames.
        """
        return self._pieces(waveform.unsqueeze(0) * gain, n_frames, progress)[0]

    def advance(self, windows: Tensor, state: CausalState) -> tuple[Tensor, CausalState]:
        """Features (B, G, D) of the frames that are `delay` before the windows.

        Parameters
        ----------
        windows : Tensor [shape=(B, G P, W)]
            Samples of the spectra of whole frames, any level.
        state : CausalState
            From `first_state`, or from the call before.
        """
        given, level = levelled(windows.to(state.mel.device), self.spectra, state.level)
        features, new = self.read(given, state._replace(level=level))
        parts = zip(state.tensors(), new.tensors(), self.rings, strict=True)
        after = [
            _replaced(old, part, axis, state.place) if axis else part for old, part, axis in parts
        ]
        return features, CausalState.of(tuple(after))

    def read(self, windows: Tensor, state: CausalState) -> tuple[Tensor, CausalState]:
        """`advance` windows at the usual level; keys and values returned are the new rows' alone.

        The running level is not looked at.
        """
        spectra = scaled(self.mel.decades(windows), PEAK).transpose(1, 2)
        mel = torch.cat((state.mel, spectra), dim=1)
        # Few frames of many streams: products of matrices, where a convolution is one a stream.
        stem, second = self.encoder.conv1, self.encoder.conv2
        taps = joined_taps(mel, stem.kernel_size[0])
        x = F.gelu(F.linear(taps, self._flat(stem.weight), stem.bias))
        # The steps of the second one are its taps.
        x = x.reshape(x.shape[0], -1, self.spectra * x.shape[2])
        x = F.gelu(F.linear(x, self._flat_stem(second.weight), second.bias))
        times = state.place + torch.arange(x.shape[1], device=x.device)
        x = x + self.encoder.positions[(times % PERIOD).long()]
        queries, kept, depth = x, list[Tensor](), len(self.encoder.layers)
        past, behind = list(state.layers), 0
        # Numbers of the new rows (B, G), and of all that have keys (B, KEPT + G).
        last = state.place - 1
        old = last - torch.remainder(last - torch.arange(KEPT, device=x.device), KEPT)
        numbers = torch.cat((old, times), dim=1).unsqueeze(1)
        distance = numbers - times.unsqueeze(2)
        for ahead, layer in zip(
            self.ahead, cast("list[Layer]", list(self.encoder.layers)), strict=True
        ):
            queries = x
            if ahead:
                rows = torch.cat((past.pop(0), x), dim=1)
                queries = rows[:, :-ahead]
                kept.append(rows[:, -ahead:])
            # Which key each query attends to: the layer's rows are `behind` their numbers.
            near = (distance <= 0) & (distance >= -PAST_FRAMES - ahead)
            begun = (numbers >= behind) | (times.unsqueeze(2) < behind + ahead)
            x, *new = _attended(layer, queries, x, (past.pop(0), past.pop(0)), near & begun)
            kept += new
            behind += ahead
        states = {depth - 1: queries, depth: x}
        mixed = self.mixed({layer: states[layer].flatten(0, 1) for layer in self.layers})
        place = state.place + x.shape[1]
        place = torch.where(place >= 2 * PERIOD, place - PERIOD, place)
        return mixed.view_as(x), state._replace(
            mel=mel[:, -STEM_SPECTRA:], place=place, layers=tuple(kept)
        )

    def _pieces(
        self,
        waveform: Tensor,
        n_frames: int,
        progress: Callable[[float], None] = lambda share: None,
    ) -> Tensor:
        """Features of clips from their beginning (B, n_frames, D)."""
        state, parts = self.first_state(len(waveform)), []
        total = n_frames + self.delay
        for first in range(0, total, BLOCK_FRAMES):
            count = min(BLOCK_FRAMES, total - first)
            begin = first * self.spectra - self.lead
            windows = self.mel.windows(waveform, count * self.spectra, begin)
            features, state = self.advance(windows, state)
            parts.append(features)
            progress((first + count) / total)
        return torch.cat(parts, dim=1)[:, self.delay :]


def _attended(
    layer: Layer, queries: Tensor, new: Tensor, past: Sequence[Tensor], seen: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """A layer's output for queries (B, G, D), which are its new rows (B, G, D) or lie before them.

    `past` are keys and values of the rows before, as in `CausalState`; those of the new rows are
    returned. `seen` (B, G, KEPT + G) tells which of the keys a query attends to.
    """
    attention, given = layer.self_attn, layer.self_attn_layer_norm(new)
    keys = attention.by_heads(attention.k_proj(given)).transpose(2, 3)
    values = attention.by_heads(attention.v_proj(given))
    asked = attention.by_heads(attention.q_proj(layer.self_attn_layer_norm(queries)))
    asked = asked * asked.shape[-1] ** -0.5
    scores = torch.cat((asked @ past[0], asked @ keys), dim=3)  # that of the past is not copied
    shares = scores.masked_fill(~seen.unsqueeze(1), UNSEEN).softmax(dim=-1)
    mixed = shares[..., :KEPT] @ past[1] + shares[..., KEPT:] @ values
    mixed = attention.out_proj(mixed.transpose(1, 2).flatten(2))
    return layer.after(queries + mixed), keys, values


def _replaced(ring: Tensor, new: Tensor, axis: int, place: Tensor) -> Tensor:
    """A part of a `CausalState` with new rows, from number `place` (B, 1) on, in their places."""
    first = max(new.shape[axis] - KEPT, 0)
    rows = new.narrow(axis, first, new.shape[axis] - first)
    number = torch.remainder(torch.arange(KEPT, device=new.device) - place - first, KEPT).long()
    number = number.view(-1, *[KEPT if k == axis else 1 for k in range(1, new.dim())])
    is_new = number < rows.shape[axis]
    if rows.shape[axis] > 1:
        rows = rows.gather(axis, (number * is_new).expand_as(ring))
    return torch.where(is_new, rows, ring)
