"""The Whisper frontend of a whole clip in a graph: its pieces side by side.

`deitalk.frontends.strided.StridedFrontend.encode` takes pieces of 300 rig frames, 30 of them in
common with the one before: piece p begins with frame 270 p. A feature is a rig frame.

Letters: N pieces, W features of the longest, K features of all pieces together, D width.
"""

import math
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.log_mel import N_FFT, SILENCE, centres
from deitalk.errors import DeitalkError
from deitalk.frontends.whisper import Attention, WhisperFrontend, scaled
from deitalk.models.onnx.spectra import with_formulas

OVERLAP = round(WhisperFrontend.overlap_seconds * FRAME_RATE)
PIECE = round(WhisperFrontend.chunk_seconds * FRAME_RATE)
STEP = PIECE - OVERLAP
"""Rig frames: common to two pieces, of a piece, and between two."""
PARTS = 4050
"""Rig frames of a recording that are predicted at once: a whole number of pieces."""
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
    size: Tensor
    """Features of a piece [shape=(N,)]."""
    offset: Tensor
    """Features of the pieces before [shape=(N,)]."""
    is_inside: Tensor
    """Features that there are [shape=(N, W)]."""


class WhisperGraph(nn.Module):
    """`WhisperFrontend.encode` of a whole clip.

    Parameters
    ----------
    frontend : WhisperFrontend
        In evaluation mode.

    Raises
    ------
    DeitalkError
        If its features are not rig frames.
    """

    begins: Tensor

    def __init__(self, frontend: WhisperFrontend) -> None:
        super().__init__()
        if frontend.config.rate != FRAME_RATE:
            raise DeitalkError(
                f"model.frontend.rate={frontend.config.rate} has no ONNX graph; train with 30"
            )
        self.frontend = with_formulas(frontend)
        self.mel = self.frontend.mel
        begins = centres(0, PIECE * frontend.spectra, frontend.mel.rate) - N_FFT // 2
        self.register_buffer("begins", torch.from_numpy(begins))  # (3 · 300,)

    def forward(self, sound: Tensor, n_frames: int, peak: Tensor | None = None) -> Tensor:
        """Map a clip (S,) to (1, T, D).

        `peak` () is `deitalk.audio.log_mel.loudest` of the recording that it is a part of; without
        it the clip is whole.
        """
        pieces = _pieces(torch.as_tensor(n_frames))
        rows = self._encoded(self._mel(sound, pieces, peak), pieces)
        return _faded(rows, torch.arange(n_frames), pieces).unsqueeze(0)

    def _mel(self, sound: Tensor, pieces: Pieces, peak: Tensor | None) -> Tensor:
        """Log-mel spectra (N, F, 3 W) with zeros after a piece."""
        width, spectra = pieces.is_inside.shape[1], self.frontend.spectra
        begin = pieces.number[:, None] * (STEP * SAMPLE_RATE // FRAME_RATE)
        end = begin + (pieces.size[:, None] * SAMPLE_RATE + FRAME_RATE - 1) // FRAME_RATE
        length = (width * SAMPLE_RATE + FRAME_RATE - 1) // FRAME_RATE + N_FFT
        places = torch.arange(length) - N_FFT // 2 + begin
        is_inside = (places >= begin) & (places < end.clamp_max(sound.shape[0]))
        samples = sound[places.clamp_min(0).clamp_max(sound.shape[0] - 1)] * is_inside
        starts = self.begins[: spectra * width] + N_FFT // 2
        index = (starts[:, None] + torch.arange(N_FFT)).flatten()
        decades = self.mel.decades(
            samples[:, index].view(samples.shape[0], -1, N_FFT)
        )  # (N, 3 W, F)
        inside = pieces.is_inside.repeat_interleave(spectra, dim=1)
        if peak is None:
            whole = inside & self._is_uncut(pieces, spectra * width)
            peak = torch.where(whole[:, :, None], decades, math.log10(SILENCE)).amax()
        return scaled(decades, peak) * inside[:, None]

    def _is_uncut(self, pieces: Pieces, count: Any) -> Tensor:
        """Spectra (N, 3 W) that no end of a piece cuts but those of the clip."""
        place, last = torch.arange(count), pieces.number[-1:, None]
        reach = N_FFT // 2 * self.mel.rate // SAMPLE_RATE + 1
        first, number = pieces.number[:, None] == 0, pieces.number[:, None]
        stop = pieces.size[:, None] * self.frontend.spectra - reach + 1
        return (first | (place >= reach)) & ((number == last) | (place < stop))

    def _encoded(self, mel: Tensor, pieces: Pieces) -> Tensor:
        """Mixed features (K, D); only attention is computed piece by piece."""
        encoder = self.frontend.encoder
        x = F.gelu(encoder.conv2(F.gelu(encoder.conv1(mel)))).transpose(1, 2)  # (N, W, D)
        x = x + encoder.positions[: x.shape[1]]
        places = pieces.is_inside.flatten().nonzero().flatten()  # (K,)
        states = [x.reshape(-1, x.shape[-1])[places]]
        width = torch.arange(pieces.is_inside.shape[1])
        back = (pieces.offset[:, None] + width).clamp_max(places.shape[0] - 1)
        unseen = UNSEEN * (1 - pieces.is_inside.to(x.dtype))[:, None, None]
        for layer in cast(Any, encoder.layers):
            rows = layer.self_attn_layer_norm(states[-1])
            rows = states[-1] + _attended(layer.self_attn, rows, back, places, unseen)
            inner = F.gelu(layer.fc1(layer.final_layer_norm(rows)))
            states.append(rows + layer.fc2(inner))
        return self.frontend.mixed(states)


def _pieces(n_frames: Tensor) -> Pieces:
    count: Any = ((n_frames + STEP - OVERLAP - 1) // STEP).clamp_min(1)
    number = torch.arange(count)
    size = (n_frames - number * STEP).clamp_max(PIECE)
    longest: Any = size.amax()
    is_inside = torch.arange(longest) < size[:, None]
    return Pieces(number, size, size.cumsum(0) - size, is_inside)


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
    """Rows (T, D) of features (K, D), pieces faded into one another."""
    piece = (frames // STEP).clamp_max(pieces.number[-1])
    before, after = (
        rows[pieces.offset[p] + torch.minimum(frames - p * STEP, pieces.size[p] - 1)]
        for p in ((piece - 1).clamp_min(0), piece)
    )
    share = ((frames - piece * STEP + 1) / (OVERLAP + 1)).clamp_max(1)
    share = torch.where(piece > 0, share, 1.0)[:, None]
    return before + share * (after - before)
