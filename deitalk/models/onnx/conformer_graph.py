"""The conformer frontend of a whole clip in a graph: all segments side by side.

`deitalk.frontends.chunking.encode_in_segments` computes 64 frames with 32 of context on either
side, fewer at the ends of the clip. Here every segment has 128 frames; those outside the clip are
zeros for the convolutions, get no attention, and positions count from the first one inside.

Letters: N segments, T their frames, L their spectra.
"""

from typing import Any, cast

import torch
from torch import Tensor, nn

from deitalk.audio.mel import derivative
from deitalk.frontends.conformer import (
    CONTEXT_FRAMES,
    SEGMENT_FRAMES,
    SPECTRA,
    ConformerFrontend,
)
from deitalk.models.onnx.mel_graph import MelGraph

WIDTH = SEGMENT_FRAMES + 2 * CONTEXT_FRAMES


class ConformerGraph(nn.Module):
    """`ConformerFrontend` of a whole clip, averaged over its phases."""

    def __init__(self, frontend: ConformerFrontend) -> None:
        super().__init__()
        self.frontend = frontend
        self.mel = MelGraph(frontend.mel, frontend.shifts)

    def forward(self, sound: Tensor, n_frames: int) -> Tensor:
        """Map (S,) to (1, T, D)."""
        count = (n_frames + SEGMENT_FRAMES - 1) // SEGMENT_FRAMES
        first = torch.arange(count)[:, None] * SEGMENT_FRAMES - CONTEXT_FRAMES  # (N, 1)
        frames = torch.arange(WIDTH) + first
        inside = (frames >= 0) & (frames < n_frames)
        positions = frames - first.clamp_min(0)
        spectra = self._spectra(self.mel.scaled(sound, SPECTRA * n_frames), first, n_frames)
        phases = self.mel.phases
        rows = self._encoded(spectra, inside.repeat(phases, 1), positions.repeat(phases, 1))
        kept = rows[:, CONTEXT_FRAMES : CONTEXT_FRAMES + SEGMENT_FRAMES]
        whole = kept.reshape(phases, -1, kept.shape[-1])[:, :n_frames]
        return whole.mean(dim=0, keepdim=True)

    def _spectra(self, mel: Tensor, first: Tensor, n_frames: int) -> Tensor:
        """Spectra (phases N, 3 F, L) of the segments; outside the clip those at its end repeat."""
        stop = torch.minimum(first + WIDTH, torch.ones_like(first) * n_frames)
        low, high = SPECTRA * first.clamp_min(0), SPECTRA * stop - 1
        index = torch.arange(SPECTRA * WIDTH) + SPECTRA * first
        index = torch.minimum(torch.maximum(index, low), high)  # (N, L)
        parts = mel[:, :, index.flatten()].reshape(mel.shape[0], mel.shape[1], -1, index.shape[1])
        parts = parts.permute(0, 2, 1, 3).flatten(0, 1)  # (phases N, F, L)
        within = (index - SPECTRA * first).repeat(mel.shape[0], 1)[:, None]
        within = within.expand(-1, parts.shape[1], -1)
        slope = torch.gather(derivative(parts), 2, within)
        return torch.cat((parts, slope, torch.gather(derivative(slope), 2, within)), dim=1)

    def _encoded(self, spectra: Tensor, inside: Tensor, positions: Tensor) -> Tensor:
        """Rows (N, T, D); `inside` and `positions` of the frames (N, T)."""
        mask = inside.to(spectra.dtype)
        frontend = self.frontend
        first, act, second, last = cast(Any, frontend.stem)
        doubled = mask.repeat_interleave(SPECTRA, dim=1)[:, None]
        stemmed = last(second(doubled * act(first(doubled * spectra)))).transpose(1, 2)
        x = frontend.project(stemmed)
        encoder = cast(Any, frontend.encoder)
        angles = positions[..., None] * encoder.embed_positions.inv_freq
        angles = torch.cat((angles, angles), dim=-1)[:, :, None]  # (N, T, 1, head)
        unseen = ((1 - mask) * -1e9)[:, None, None]  # (N, 1, 1, T)
        for layer in encoder.layers:
            x = _layer(layer, x, mask, unseen, angles)
        out: Tensor = encoder.layer_norm(x)
        return out


def _layer(layer: Any, x: Tensor, mask: Tensor, unseen: Tensor, angles: Tensor) -> Tensor:
    """A conformer block, as `Wav2Vec2ConformerEncoderLayer`."""
    x = 0.5 * layer.ffn1(layer.ffn1_layer_norm(x)) + x
    x = _attended(layer.self_attn, layer.self_attn_layer_norm(x), unseen, angles) + x
    x = x + _convolved(layer.conv_module, x, mask)
    x = 0.5 * layer.ffn2(layer.ffn2_layer_norm(x)) + x
    out: Tensor = layer.final_layer_norm(x)
    return out


def _attended(attention: Any, x: Tensor, unseen: Tensor, angles: Tensor) -> Tensor:
    shape = (x.shape[0], WIDTH, attention.num_heads, attention.head_size)
    heads = x.view(shape)
    half = attention.head_size // 2
    turned = torch.cat((-heads[..., half:], heads[..., :half]), dim=-1)
    placed = (heads * angles.cos() + turned * angles.sin()).flatten(2)
    query, key, value = (
        linear(given).view(shape).transpose(1, 2)
        for linear, given in (
            (attention.linear_q, placed),
            (attention.linear_k, placed),
            (attention.linear_v, x),
        )
    )
    scores = query @ key.transpose(2, 3) * attention.scaling + unseen
    out: Tensor = attention.linear_out((scores.softmax(dim=-1) @ value).transpose(1, 2).flatten(2))
    return out


def _convolved(module: Any, x: Tensor, mask: Tensor) -> Tensor:
    rows = module.pointwise_conv1(module.layer_norm(x).transpose(1, 2))
    value, gate = rows.chunk(2, dim=1)
    rows = module.depthwise_conv(value * gate.sigmoid() * mask[:, None])
    out: Tensor = module.pointwise_conv2(module.activation(module.batch_norm(rows)))
    return out.transpose(1, 2)
