"""The Whisper frontend of a whole clip in a graph: its pieces side by side.

`deitalk.frontends.strided.StridedFrontend.encode` takes pieces of 300 rig frames, 30 of them in
common with the one before. On their grid every number is whole: piece p begins with frame 270 p,
frame i lies at feature 5 i / 3, and all but the first begin one feature early.

Letters: N pieces, W features of the longest, K features of all pieces together, D width.
"""

import math
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.log_mel import DYNAMIC_RANGE, HOP, N_FFT, SILENCE
from deitalk.frontends.whisper import Attention, WhisperFrontend

OVERLAP = round(WhisperFrontend.overlap_seconds * FRAME_RATE)
PIECE = round(WhisperFrontend.chunk_seconds * FRAME_RATE)
STEP = PIECE - OVERLAP
"""Rig frames: common to two pieces, of a piece, and between two."""
STRIDE = 2 * HOP
STEP_FEATURES = STEP * SAMPLE_RATE // FRAME_RATE // STRIDE
PARTS = 4050
"""Rig frames of a recording that are predicted at once: a whole number of pieces."""
WHOLE = math.log10(SILENCE)
"""Peak that stands for the own one of the sound."""
UNSEEN = -1e9
"""Added to the scores of what gets no attention."""


class Parts(NamedTuple):
    """How a long recording is divided: frames predicted at once, and context on either side."""

    frames: int
    before: int
    after: int


def parts_of(around: int) -> Parts:
    """Parts that equal the whole, of a model whose curves depend on features `around` a frame.

    The first and last piece of a part differ from those of the whole, which know what is outside.
    """
    before = -(-(PIECE + around) // STEP) * STEP
    return Parts(PARTS, before, -(-around // STEP) * STEP + PIECE)


class Pieces(NamedTuple):
    """Where the features of the pieces lie."""

    number: Tensor
    """0 to N - 1 [shape=(N,)]."""
    first: Tensor
    """Feature of the clip with which a piece begins [shape=(N,)]."""
    size: Tensor
    """Its features [shape=(N,)]."""
    offset: Tensor
    """Features of the pieces before [shape=(N,)]."""
    last_sample: Tensor
    """Sample of the clip before which a piece ends [shape=(N,)]."""
    is_inside: Tensor
    """Features that there are [shape=(N, W)]."""


class WhisperGraph(nn.Module):
    """`WhisperFrontend.encode` of a whole clip.

    Parameters
    ----------
    frontend : WhisperFrontend
        In evaluation mode.
    """

    transform: Tensor

    def __init__(self, frontend: WhisperFrontend) -> None:
        super().__init__()
        self.frontend = frontend
        angle = 2 * math.pi / N_FFT * torch.arange(N_FFT // 2 + 1, dtype=torch.float64)
        angle = torch.arange(N_FFT, dtype=torch.float64)[:, None] * angle
        window = frontend.mel.window.double()[:, None]
        waves = torch.cat((window * angle.cos(), window * angle.sin()), dim=1)
        self.register_buffer("transform", waves.float())  # (400, 402)

    def forward(self, sound: Tensor, n_frames: int, peak: Tensor) -> Tensor:
        """Map a clip (S,) to (1, T, D).

        `peak` () is `deitalk.audio.log_mel.loudest` of the recording that it is a part of; -10 or
        less: it is the whole recording.
        """
        pieces = _pieces(torch.as_tensor(n_frames), torch.as_tensor(sound.shape[0]))
        rows = self._encoded(self._mel(sound, pieces, peak), pieces)
        return _faded(rows, torch.arange(n_frames), pieces).unsqueeze(0)

    def _mel(self, sound: Tensor, pieces: Pieces, peak: Tensor) -> Tensor:
        """Log-mel spectra (N, F, 2 W) with zeros after a piece."""
        width = pieces.is_inside.shape[1]
        begin = pieces.first[:, None] * STRIDE
        places = torch.arange(width * STRIDE + N_FFT) - N_FFT // 2 + begin
        is_inside = (places >= begin) & (places < pieces.last_sample[:, None])
        samples = sound[places.clamp_min(0).clamp_max(sound.shape[0] - 1)] * is_inside
        frames = torch.arange(2 * width)[:, None] * HOP + torch.arange(N_FFT)
        windows = samples[:, frames.flatten()].reshape(-1, N_FFT)  # (N 2 W, 400)
        bands = self.frontend.mel.filters.repeat(2, 1)
        power = (windows @ self.transform).square() @ bands
        decades = power.clamp_min(SILENCE).log10().reshape(-1, 2 * width, bands.shape[1])
        frame = torch.arange(2 * width)
        after = 2 * pieces.size[:, None]
        is_last = pieces.number[:, None] == pieces.number[-1]
        is_whole = (frame < after - torch.where(is_last, 0, 1)) & (frame + 2 * begin >= 2)
        own = torch.where(is_whole[..., None], decades, WHOLE).amax()
        known = torch.where(peak > WHOLE, peak, own)
        mel = (torch.maximum(decades, known - DYNAMIC_RANGE) + 4) / 4
        return (mel * (frame < after)[..., None]).transpose(1, 2)

    def _encoded(self, mel: Tensor, pieces: Pieces) -> Tensor:
        """Mixed features (K, D); only attention is computed piece by piece."""
        encoder = self.frontend.encoder
        x = F.gelu(encoder.conv2(F.gelu(encoder.conv1(mel)))).transpose(1, 2)  # (N, W, D)
        width = torch.arange(pieces.is_inside.shape[1])
        x = x + encoder.embed_positions(width)
        places = pieces.is_inside.flatten().nonzero().flatten()  # (K,)
        states = [x.reshape(-1, x.shape[-1])[places]]
        back = (pieces.offset[:, None] + width).clamp_max(places.shape[0] - 1)
        unseen = UNSEEN * (1 - pieces.is_inside.to(x.dtype))[:, None, None]
        for layer in cast(Any, encoder.layers):
            rows = layer.self_attn_layer_norm(states[-1])
            rows = states[-1] + _attended(layer.self_attn, rows, back, places, unseen)
            inner = F.gelu(layer.fc1(layer.final_layer_norm(rows)))
            states.append(rows + layer.fc2(inner))
        return self.frontend.mixed(states)


def _pieces(n_frames: Tensor, n_samples: Tensor) -> Pieces:
    count: Any = ((n_frames + STEP - OVERLAP - 1) // STEP).clamp_min(1)
    number = torch.arange(count)
    first = (number * STEP_FEATURES - 1).clamp_min(0)
    stop = (number * STEP + PIECE).clamp_max(n_frames)
    last_sample = ((stop * SAMPLE_RATE + FRAME_RATE - 1) // FRAME_RATE + STRIDE).clamp_max(
        n_samples
    )
    size = (last_sample - first * STRIDE + STRIDE - 1) // STRIDE
    longest: Any = size.amax()
    is_inside = torch.arange(longest) < size[:, None]
    return Pieces(number, first, size, size.cumsum(0) - size, last_sample, is_inside)


def _attended(
    attention: Attention, rows: Tensor, back: Tensor, places: Tensor, unseen: Tensor
) -> Tensor:
    """Self-attention of rows (K, D) within their pieces; `back` (N, W) are places in K."""
    query, key, value = (
        linear(rows)[back].unflatten(-1, (attention.heads, -1)).transpose(1, 2)
        for linear in (attention.q_proj, attention.k_proj, attention.v_proj)
    )
    scores = (query * query.shape[-1] ** -0.5) @ key.transpose(2, 3) + unseen
    mixed = (scores.softmax(dim=-1) @ value).transpose(1, 2)  # (N, W, heads, D / heads)
    out: Tensor = attention.out_proj(mixed.reshape(-1, rows.shape[-1])[places])
    return out


def _faded(rows: Tensor, frames: Tensor, pieces: Pieces) -> Tensor:
    """Rows at 30 Hz (T, D) of features (K, D), pieces faded into one another."""
    piece = (frames // STEP).clamp_max(pieces.number[-1])
    before, after = (_at(rows, frames, p, pieces) for p in ((piece - 1).clamp_min(0), piece))
    share = ((frames - piece * STEP + 1) / (OVERLAP + 1)).clamp_max(1)
    share = torch.where(piece > 0, share, 1.0)[:, None]
    return before + share * (after - before)


def _at(rows: Tensor, frames: Tensor, piece: Tensor, pieces: Pieces) -> Tensor:
    """Features of a piece (T,) interpolated at rig frames (T,)."""
    thirds = 5 * frames - 3 * pieces.first[piece]
    last = pieces.size[piece] - 1
    below = torch.minimum(thirds // 3, last)
    above = torch.minimum(below + 1, last)
    offset = pieces.offset[piece]
    low, high = rows[offset + below], rows[offset + above]
    return low + ((thirds % 3) / 3)[:, None] * (high - low)
