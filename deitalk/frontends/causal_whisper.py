"""Whisper's first layers on a voice that has not ended: bounded past, three frames of look-ahead.

Not in the papers, whose encoders need the whole clip. The weights are those of
`deitalk.frontends.whisper`, which were tuned to be read in this way too: a layer attends to
`PAST_FRAMES` before a frame and `LOOKAHEAD_FRAMES` after it, positions begin anew after `PERIOD`,
and in place of the loudest spectrum of the clip a fixed peak at a running level gives the floor.
Keys and values of the past are kept, so that every frame is computed once. State is explicit: a
clip in one piece and in any pieces gives the same features, to rounding.

With three layers the features of frame t depend on the sound until 135 ms after it: on the spectra
of three more frames, the last centred at 3 2/3 frames and reaching 12.5 ms further.

Letters: B streams, W samples of a spectrum, P spectra of a rig frame, G frames of a call, F mel
bins, D width.
"""

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
KEPT = PAST_FRAMES + LOOKAHEAD_FRAMES
"""Frames whose keys and values a layer keeps between two calls."""
PEAK = 1.0
"""Logarithm to base 10 of the loudest mel power of speech at the normal level; .5 to 1.6."""
PERIOD = 10 * FRAME_RATE
"""Frames after which the positions of a stream begin anew."""
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
    [shape=(B, heads, KEPT, D / heads)] of the past, as products of matrices take them."""

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
    n_states : int
        Tensors of a `CausalState`.
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
        self.n_states = 3 + 2 * depth + looking
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
        features, after = self.read(given, state)
        return features, after._replace(level=level)

    def read(self, windows: Tensor, state: CausalState) -> tuple[Tensor, CausalState]:
        """`advance` of windows at the usual level; the running level is not looked at."""
        spectra = scaled(self.mel.decades(windows), PEAK).transpose(1, 2)
        mel = torch.cat((state.mel, spectra), dim=1)
        # Few frames of many streams: products of matrices, where a convolution is one a stream.
        first, second = self.encoder.conv1, self.encoder.conv2
        taps = joined_taps(mel, first.kernel_size[0])
        x = F.gelu(F.linear(taps, self._flat(first.weight), first.bias))
        # The steps of the second one are its taps.
        x = x.reshape(x.shape[0], -1, self.spectra * x.shape[2])
        x = F.gelu(F.linear(x, self._flat_stem(second.weight), second.bias))
        times = state.place + torch.arange(x.shape[1], device=x.device)
        x = x + self.encoder.positions[(times % PERIOD).long()]
        queries, kept, depth = x, list[Tensor](), len(self.encoder.layers)
        past, behind = list(state.layers), 0
        # Which key each query attends to (G, KEPT + G), and the frames of the keys (KEPT + G,).
        keys_at = torch.arange(KEPT + x.shape[1], device=x.device) - KEPT
        for ahead, layer in zip(
            self.ahead, cast("list[Layer]", list(self.encoder.layers)), strict=True
        ):
            queries, queries_at = x, keys_at[KEPT:, None] - ahead
            if ahead:
                rows = torch.cat((past.pop(0), x), dim=1)
                queries = rows[:, :-ahead]
                kept.append(rows[:, -ahead:])
            after = keys_at - queries_at
            near = (after <= ahead) & (after >= -PAST_FRAMES)
            first = (state.place - behind).unsqueeze(2)  # frame of the first new row
            begun = near & ((keys_at + first >= 0) | (queries_at + first < 0))
            x, keys, values = _attended(layer, queries, x, (past.pop(0), past.pop(0)), begun)
            kept += [keys, values]
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

    `past` are keys and values of the rows before, as in `CausalState`; those to keep now are
    returned. `seen` (B, G, KEPT + G) tells which of the keys a query attends to.
    """
    attention, given = layer.self_attn, layer.self_attn_layer_norm(new)
    new_keys = attention.by_heads(attention.k_proj(given)).transpose(2, 3)
    keys = torch.cat((past[0], new_keys), dim=3)
    values = torch.cat((past[1], attention.by_heads(attention.v_proj(given))), dim=2)
    asked = attention.by_heads(attention.q_proj(layer.self_attn_layer_norm(queries)))
    scores = (asked * asked.shape[-1] ** -0.5) @ keys
    shares = scores.masked_fill(~seen.unsqueeze(1), UNSEEN).softmax(dim=-1)
    mixed = attention.out_proj((shares @ values).transpose(1, 2).flatten(2))
    return layer.after(queries + mixed), keys[..., -KEPT:], values[:, :, -KEPT:]
