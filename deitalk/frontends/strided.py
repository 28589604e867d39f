"""Frontends whose encoder gives features at a regular stride, brought to the rig's 30 Hz.

K features of the encoder, T rig frames, D width.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.errors import ConfigError
from deitalk.frontends.base import Frontend
from rig.arrays import Float32, Int64

MOMENTUM = 0.01
"""Of the running mean and variance, where the encoder learns."""
LARGEST = 6.0
"""Standardised features are limited to this: a few dimensions have rare, huge values."""


class Piece(NamedTuple):
    """Rows `start` to `stop` of a clip, those to `done` shared with the piece before."""

    start: int
    done: int
    stop: int
    first: int
    """First sample, and the one after the last."""
    last: int


class StridedFrontend(Frontend):
    """An encoder of 16 kHz sound with one row per rig frame.

    Row i describes the time i/30 s. Feature k of the encoder describes the sample
    `centre` + k `stride`, and row i is interpolated linearly between the two features around it
    (the ends are held).

    Deviation: DEITalk's "linear interpolation layer" is, in the code of its predecessors, a
    resize of K rows to T with the corners aligned. That puts feature 0 (12.5 ms) at 0 ms and the
    last one, up to 32 ms before the clip's end, at its last frame: rows drift against the audio
    by up to a frame, and by how much depends on the length. Here every row is exact in time.

    Attributes
    ----------
    stride, centre, margin : int or float
        Samples between features, sample of feature 0, and samples around a row's own that its
        features need.
    """

    stride: float
    centre: float
    margin: int
    chunk_seconds, overlap_seconds = 24.0, 2.0
    norms: nn.ModuleList
    mix: nn.Parameter

    def mix_layers(self, layers: Sequence[int], width: int) -> None:
        """Prepare `mixed` of these layers; 0 is the input of the first."""
        self.layers = tuple(layers)
        # Running mean and variance of speech: a few dimensions vary a hundred times as much.
        self.norms = nn.ModuleList(
            nn.BatchNorm1d(width, affine=False, momentum=MOMENTUM) for _ in layers
        )
        self.mix = nn.Parameter(torch.zeros(len(layers)))

    def mixed(self, states: Sequence[Tensor] | Mapping[int, Tensor]) -> Tensor:
        """Standardised and mixed features (N, D) from the states (N, D) of the layers."""
        scaled = [
            weight * _standardised(states[layer], norm).clamp(-LARGEST, LARGEST)
            for weight, norm, layer in zip(
                self.mix.softmax(dim=0), self.norms, self.layers, strict=True
            )
        ]
        return torch.stack(scaled).sum(dim=0)

    @torch.no_grad()
    def measure(self, sounds: Sequence[Float32]) -> None:
        """Take mean and variance of the states from recordings at the normal level [shape=(S,)]."""
        norms = [norm for norm in self.norms if isinstance(norm, nn.BatchNorm1d)]
        for norm in norms:
            norm.reset_running_stats()
            norm.momentum = None  # the mean of all
        self.norms.train()
        for sound in sounds:
            self.features(torch.from_numpy(sound[: 10 * SAMPLE_RATE]).unsqueeze(0))
        for norm in norms:
            norm.momentum = MOMENTUM
        self.norms.eval()

    def features(self, waveform: Tensor, context: Any = None) -> Tensor:
        """Features (B, K, D) of (B, S), before interpolation; `context` is that of `survey`."""
        raise NotImplementedError

    def survey(self, waveform: Tensor, gain: float) -> Any:
        """What a piece's features need to know of the whole clip (S,) times `gain`, if anything."""
        return None

    def forward(self, waveform: Tensor, n_frames: int) -> Tensor:
        """Encode a batch of speech at 30 Hz.

        Parameters
        ----------
        waveform : Tensor [shape=(B, S)]
            float32, 16 kHz, speech at -23 dBFS.
        n_frames : int
            T.

        Returns
        -------
        Tensor [shape=(B, T, D)]
            Row i is time i/30 s.
        """
        return self.rows(self.features(waveform), 0, n_frames, first_sample=0)

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
        """Encode a whole clip in chunks of bounded memory, in evaluation mode.

        Neighbouring chunks overlap and are cross-faded there, so that the frames at a chunk's
        edge, which lack context, count least. A clip of up to one chunk is encoded at once and
        equals `forward`. On longer ones attention spans a chunk instead of the whole clip: the
        difference is more than rounding, but small wherever attention is local. Chunks start on the
        encoder's own grid.

        Parameters
        ----------
        waveform : Tensor [shape=(S,)]
            As for `forward`; it may lie on the CPU, chunks are moved to the encoder.
        n_frames : int
            T.
        chunk_seconds, overlap_seconds : float or None
            A chunk is at least two overlaps long; None: the frontend's own.
        progress : callable
            Called with the share done, 0 to 1.
        gain : float
            Factor that brings the speech to -23 dBFS, if that is not done.

        Returns
        -------
        Tensor [shape=(T, D)]
        """
        seconds = self.chunk_seconds if chunk_seconds is None else chunk_seconds
        overlap_seconds = self.overlap_seconds if overlap_seconds is None else overlap_seconds
        chunk, overlap = round(seconds * FRAME_RATE), round(overlap_seconds * FRAME_RATE)
        if overlap < 0 or chunk < max(2 * overlap, 1):
            raise ConfigError(
                f"chunk_seconds={seconds:g} must be at least twice "
                f"overlap_seconds={overlap_seconds:g}; lengthen the chunks"
            )
        device = next(self.parameters()).device
        context = self.survey(waveform, gain) if n_frames > chunk else None
        rows = torch.empty(n_frames, self.output_size, device=device)
        for piece in self._pieces_of(n_frames, chunk, overlap):
            sound = waveform[piece.first : piece.last].unsqueeze(0).to(device) * gain
            self._add(rows, piece, self.features(sound, context))
            progress(piece.stop / n_frames)
        return rows

    def _pieces_of(self, n_frames: int, chunk: int, overlap: int) -> Iterator["Piece"]:
        """Pieces of a clip of `n_frames` rows, of `chunk` rows each."""
        done = 0
        while done < n_frames:
            start = done - overlap if done else 0
            stop = min(start + chunk, n_frames)
            # Samples [first, last) that the rows start … stop - 1 are interpolated from.
            first = start * SAMPLE_RATE // FRAME_RATE - self.margin
            last = -(-stop * SAMPLE_RATE // FRAME_RATE) + self.margin
            grid = Fraction(self.stride).limit_denominator(FRAME_RATE)
            step = grid.numerator  # the least number of samples that is whole in strides
            yield Piece(start, done, stop, *(max(0, first // step * step), last))
            done = stop

    def _add(self, rows: Tensor, piece: "Piece", features: Tensor) -> None:
        """Write a piece's features (1, K, D) into the rows (T, D) of its clip."""
        start, done, stop, first, _ = piece
        new = self.rows(features, start, stop, first_sample=first)[0]
        fade = torch.arange(1, done - start + 1, device=rows.device).unsqueeze(1)
        rows[start:done].lerp_(new[: done - start], fade / (done - start + 1))
        rows[done:stop] = new[done - start :]

    def rows(self, features: Tensor, start: int, stop: int, *, first_sample: int) -> Tensor:
        """Interpolate features (B, K, D), begun at `first_sample`, at the times of rows (B, n, D).

        With stride 320 and centre 199.5, rows 0, 1, 2, 3 (samples 0, 533.3, 1066.7, 1600) lie at
        the feature positions -0.62 (held at 0), 1.04, 2.71 and 4.38.
        """
        below, above, part = (
            torch.from_numpy(row).to(features.device)
            for row in self._places(start, stop, first_sample, features.shape[1])
        )
        return torch.lerp(
            features[:, below], features[:, above], part.to(features.dtype).unsqueeze(-1)
        )

    def _places(
        self, start: int, stop: int, first_sample: int, size: int
    ) -> tuple[Int64, Int64, Float32]:
        """Features before and after each row of `rows`, and how far it lies between them."""
        position = np.arange(start, stop) * (SAMPLE_RATE / FRAME_RATE) - (
            first_sample + self.centre
        )
        position = (position / self.stride).clip(0, size - 1)
        below = position.astype(np.int64)
        return below, (below + 1).clip(max=size - 1), (position - below).astype(np.float32)


def _standardised(rows: Tensor, norm: nn.Module) -> Tensor:
    """Rows (N, D) of mean 0 and deviation 1; in training those of the batch."""
    assert isinstance(norm, nn.BatchNorm1d)
    mean, variance = norm.running_mean, norm.running_var
    if norm.training or mean is None or variance is None:
        out: Tensor = norm(rows)
        return out
    return (rows - mean) * (variance + norm.eps).rsqrt()
