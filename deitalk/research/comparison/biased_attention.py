"""Attention that is biased towards the recent past (FaceFormer, §3.2).

Letters: B batch, T frames, W width, H heads.
"""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F

KeysAndValues = tuple[Tensor, Tensor]
"""Keys and values of the frames so far, each (B, H, frames, W / H)."""


def periodic_positions(n_frames: int, size: int, period: int) -> Tensor:
    """Sines and cosines of a frame's place in its period (FaceFormer's periodic encoding).

    ``sin((t mod p) / 10000^(2i/d))`` in the even columns, the cosine in the odd ones: longer clips
    than those of the training have no new positions.

    Returns
    -------
    Tensor [shape=(n_frames, size), range -1 to 1]
    """
    place = (torch.arange(n_frames) % period).to(torch.float32)
    frequency = 10000.0 ** (-torch.arange(0, size, 2, dtype=torch.float32) / size)
    angle = place.unsqueeze(-1) * frequency
    return torch.stack((angle.sin(), angle.cos()), dim=-1).flatten(-2)[:, :size]


def head_slopes(heads: int) -> Tensor:
    """Weight of the bias in every head: 2^(-8 h / H), h = 1 to H (ALiBi, Press et al. 2022)."""
    return 2.0 ** (-8 * torch.arange(1, heads + 1) / heads)


def causal_bias(n_frames: int, heads: int, period: int) -> Tensor:
    """Bias of frame i's attention to frame j: minus the slope for each whole period between them.

    ``-slope floor((i - j) / p)`` for j up to i, minus infinity for later frames.

    Returns
    -------
    Tensor [shape=(H, n_frames, n_frames)]
    """
    frame = torch.arange(n_frames)
    age = frame.unsqueeze(1) - frame
    bias = -head_slopes(heads).view(-1, 1, 1) * (age // period)
    return bias.masked_fill(age < 0, -math.inf)


class BiasedLayer(nn.Module):
    """A transformer decoder's layer with `causal_bias`, all frames at once or one after another.

    Self-attention, attention to the aligned features, feed-forward layer; after each the sum with
    its input is normalised. Frame t may attend to the aligned features of frame t only (both
    papers' alignment bias where sound and curves have one rate), so that softmax over one key is 1
    and this attention is the linear map of its values.

    Parameters
    ----------
    width : int
        Features W of a frame; a multiple of `heads`.
    aligned_size : int
        Width of the aligned features.
    heads : int
    period : int
        Frames p.
    dropout : float
    """

    def __init__(
        self, width: int, aligned_size: int, heads: int, period: int, dropout: float
    ) -> None:
        super().__init__()
        self.heads, self.period = heads, period
        self.project = nn.Linear(width, 3 * width)
        self.join = nn.Linear(width, width)
        self.aligned = nn.Linear(aligned_size, width)
        self.feed = nn.Sequential(
            nn.Linear(width, 2 * width), nn.ReLU(), nn.Dropout(dropout), nn.Linear(2 * width, width)
        )
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(3))
        self.dropout = nn.Dropout(dropout)
        self.register_buffer("slopes", head_slopes(heads), persistent=False)

    slopes: Tensor

    def forward(self, x: Tensor, aligned: Tensor) -> Tensor:
        """Map (B, T, W) and aligned features (B, T, aligned_size) to (B, T, W)."""
        query, key, value = (self._heads(part) for part in self.project(x).chunk(3, dim=-1))
        bias = causal_bias(x.shape[1], self.heads, self.period).to(query)
        attended = F.scaled_dot_product_attention(query, key, value, attn_mask=bias)
        return self._after(x, attended.transpose(1, 2).flatten(2), self.aligned(aligned))

    def step(
        self, x: Tensor, seen: Tensor, past: KeysAndValues | None
    ) -> tuple[Tensor, KeysAndValues]:
        """Map the next frame (B, W); return it and what its successor is given as `past`.

        Parameters
        ----------
        x : Tensor [shape=(B, W)]
            Input of the frame.
        seen : Tensor [shape=(B, W)]
            ``self.aligned`` of the frame's aligned features.
        past : tuple of Tensor, or None
            Of the frames before it; None for the first.
        """
        query, key, value = (self._heads(part) for part in self.project(x[:, None]).chunk(3, -1))
        if past is not None:
            key, value = torch.cat((past[0], key), dim=2), torch.cat((past[1], value), dim=2)
        age = torch.arange(key.shape[2] - 1, -1, -1, device=x.device) // self.period
        bias = (-self.slopes.unsqueeze(-1) * age).unsqueeze(1).to(query)
        attended = F.scaled_dot_product_attention(query, key, value, attn_mask=bias)
        return self._after(x, attended.flatten(1), seen), (key, value)

    def _heads(self, x: Tensor) -> Tensor:
        """(B, T, W) to (B, H, T, W / H)."""
        return x.view(*x.shape[:2], self.heads, -1).transpose(1, 2)

    def _after(self, x: Tensor, attended: Tensor, seen: Tensor) -> Tensor:
        for norm, part in zip(self.norms, (self.join(attended), seen, None), strict=True):
            x = norm(x + self.dropout(self.feed(x) if part is None else part))
        return x
