"""The mel frontend over a clip of any length, exact and in bounded memory.

A bidirectional LSTM depends on the whole clip, and the memory of the default weights reaches over
minutes: segments with context differ by tenths of a control's range from the whole. So the layers
are evaluated one after the other over the pieces of the clip, forward with the state of the piece
before, backward with that of the piece after. However a clip is divided, the result is that of one
call, to rounding.

Letters: K states of the Time-BiLSTM, n of a piece, H units per direction.
"""

from collections.abc import Callable, Iterator
from itertools import count
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from deitalk.audio.mel import nearest_spectra

if TYPE_CHECKING:
    from deitalk.frontends.mel_bilstm import MelFrontend

PIECE_FRAMES = 960
"""Rig frames of a piece (32 s)."""
EXACT_FRAMES = 18_000
"""Longer clips (10 minutes) keep what lies between the layers in half precision: an hour of it is
250 MB then. Curves change by less than 0.002 of a range."""

State = tuple[Tensor, Tensor]


def encode_whole(
    frontend: "MelFrontend",
    waveform: Tensor,
    n_frames: int,
    progress: Callable[[float], None],
) -> Tensor:
    """Features of a clip: the mean over the frontend's phases.

    Parameters
    ----------
    frontend : MelFrontend
        With ``recurrence: segment``, in evaluation mode.
    waveform : Tensor [shape=(S,)]
        16 kHz, level-normalised.
    n_frames : int
        Rig frames T.
    progress : callable
        Called with the share done, 0 to 1.

    Returns
    -------
    Tensor [shape=(T, D)]
    """
    rows = torch.zeros(n_frames, frontend.output_size, device=frontend.mel.window.device)
    stages = 2 + frontend.recurrent.num_layers + len(frontend.rig)
    n_pieces = -(-n_frames // PIECE_FRAMES)
    done = count(1)

    def tick() -> None:
        progress(min(next(done) / (len(frontend.shifts) * stages * n_pieces), 1.0))

    for shift in frontend.shifts:
        for start, piece in _features(frontend, waveform.unsqueeze(0), n_frames, shift, tick):
            rows[start : start + piece.shape[1]] += piece[0] / len(frontend.shifts)
    return rows


def _features(
    frontend: "MelFrontend", waveform: Tensor, n_frames: int, shift: int, tick: Callable[[], None]
) -> Iterator[tuple[int, Tensor]]:
    """First frame and features (1, n, D) of every piece; `tick` is called per piece and stage."""
    store = torch.float32 if n_frames <= EXACT_FRAMES else torch.float16
    centres = nearest_spectra(n_frames, frontend.config.frame_rate, frontend.config.time_stack)
    starts = list(range(0, n_frames, PIECE_FRAMES))
    memory = []
    for first in range(0, length := int(centres[-1]) + 1, 2 * PIECE_FRAMES):
        part = first, min(2 * PIECE_FRAMES, length - first), length
        memory.append(_spectral(frontend, waveform, *part, shift).to(store))
        tick()
    for layer in range(frontend.recurrent.num_layers):
        for i, output in layer_outputs(frontend.recurrent, layer, memory):
            memory[i] = output.to(store)
            tick()
    rows = []
    for start in starts:
        rows.append(_attended(frontend, memory, centres[start : start + PIECE_FRAMES]).to(store))
        tick()
    memory.clear()
    for rig in frontend.rig:
        for i, output in layer_outputs(rig.recurrent, 0, rows):
            rows[i] = (rows[i] + rig.project(output)).to(store)
            tick()
    while rows:
        yield starts[len(rows) - 1], rows.pop().float()


def _spectral(
    frontend: "MelFrontend", waveform: Tensor, first: int, n: int, length: int, shift: int
) -> Tensor:
    """Input (1, n, C) of the Time-BiLSTM, from state `first` of `length`."""
    stack = frontend.config.time_stack
    # Derivatives reach two spectra further; at the ends of the clip they repeat.
    before, after = min(2, first * stack), min(2, (length - first - n) * stack)
    begin, n_spectra = first * stack - before, n * stack + before + after
    mel = frontend.mel(waveform, n_spectra, begin, shift)[..., before : n_spectra - after]
    return frontend.spectral(mel).reshape(1, n, -1)


def layer_outputs(lstm: nn.LSTM, layer: int, pieces: list[Tensor]) -> Iterator[tuple[int, Tensor]]:
    """Output of one bidirectional layer for every piece of its input, the last piece first.

    Parameters
    ----------
    lstm : nn.LSTM
        Bidirectional, batch first.
    layer : int
        Number of the layer.
    pieces : list of Tensor [shape=(1, n, C)]
        Input; an item may be replaced once its output was given.

    Yields
    ------
    tuple of int and Tensor [shape=(1, n, 2 H)]
        Number of the piece, and its output.
    """
    ahead: list[Tensor] = []
    state: State | None = None
    for piece in pieces:
        output, state = _direction(lstm, layer, "", piece, state)
        ahead.append(output.to(piece.dtype))
    state = None
    for i in reversed(range(len(pieces))):
        output, state = _direction(lstm, layer, "_reverse", pieces[i].flip(1), state)
        yield i, torch.cat((ahead.pop().float(), output.flip(1)), dim=-1)


def _direction(
    lstm: nn.LSTM, layer: int, suffix: str, piece: Tensor, state: State | None
) -> tuple[Tensor, State]:
    """One direction of one layer over a piece."""
    parts = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
    weights = [getattr(lstm, f"{part}_l{layer}{suffix}") for part in parts]
    if state is None:
        zeros = weights[0].new_zeros(1, 1, lstm.hidden_size)
        state = zeros, zeros
    output, hidden, cell = torch.lstm(
        piece.float(), state, weights, True, 1, 0.0, False, False, True
    )
    return output, (hidden, cell)


def _attended(frontend: "MelFrontend", memory: list[Tensor], centres: Tensor) -> Tensor:
    """Rows (1, n, D) around some states of the memory."""
    config, attention = frontend.config, frontend.attention
    window = config.window_frames // config.time_stack
    reach = window + attention.query_frames
    length = sum(piece.shape[1] for piece in memory)
    first, last = max(int(centres[0]) - reach, 0), min(int(centres[-1]) + reach + 1, length)
    near = _between(memory, first, last)
    places = (centres - first).to(near.device)
    return frontend.centred(attention.along(near, places, window), near[:, places])


def _between(pieces: list[Tensor], first: int, last: int) -> Tensor:
    """Rows `first` to `last - 1` of a sequence in pieces."""
    parts, begin = [], 0
    for piece in pieces:
        end = begin + piece.shape[1]
        if end > first and begin < last:
            parts.append(piece[:, max(first - begin, 0) : last - begin])
        begin = end
    return torch.cat(parts, dim=1).float()
