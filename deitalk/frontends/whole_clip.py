"""The mel frontend over a clip of any length, exact and in bounded memory.

A bidirectional LSTM depends on the whole clip, and the memory of the default weights reaches over
minutes: segments with context differ by tenths of a control's range from the whole. So the layers
are evaluated one after the other over the pieces of the clip, forward with the state of the piece
before, backward with that of the piece after. However a clip is divided, the result is that of one
call, to rounding.

Letters: K states of the Time-BiLSTM, n of a piece, H units per direction.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import count
from typing import Any, NamedTuple, Protocol, cast

import torch
from torch import Tensor, nn

from deitalk.audio.mel import MelSpectrogram, nearest_spectra
from deitalk.config.frontends import MelConfig

PIECE_FRAMES = 240
"""Rig frames of a piece (8 s); what a piece needs beside the sequence grows with it."""
ONE_PIECE_FRAMES = 600
"""Clips up to this length (20 s) are encoded in one piece, which takes a tenth less time."""
EXACT_FRAMES = 18_000
"""Longer clips (10 minutes) keep what lies between the layers in half precision: an hour of it is
250 MB then. Curves change by less than 0.002 of a range."""

State = tuple[Tensor, Tensor]


class MelLayers(Protocol):
    """What is needed of `deitalk.frontends.mel_bilstm.MelFrontend`."""

    config: MelConfig
    shifts: list[int]
    mel: MelSpectrogram
    spectral: Any
    recurrent: nn.LSTM
    attention: Any
    rig: nn.Sequential

    def encode_together(self, waveforms: Sequence[Tensor], counts: Sequence[int]) -> list[Tensor]:
        """Features (T, D) of clips (S,)."""

    def centred(self, attended: Tensor, centre: Tensor) -> Tensor:
        """Attended states with their own centre."""


def encode_whole(
    frontend: MelLayers,
    waveform: Tensor,
    n_frames: int,
    progress: Callable[[float], None],
    gain: float = 1.0,
) -> Tensor:
    """Features of a clip: the mean over the frontend's phases.

    Parameters
    ----------
    frontend : MelLayers
        With ``recurrence: segment``, in evaluation mode.
    waveform : Tensor [shape=(S,)]
        16 kHz.
    n_frames : int
        Rig frames T.
    progress : callable
        Called with the share done, 0 to 1.
    gain : float
        Factor that normalises the waveform's level.

    Returns
    -------
    Tensor [shape=(T, D)]
        In float16 if the clip is longer than `EXACT_FRAMES`, else in float32.
    """
    if n_frames <= ONE_PIECE_FRAMES:
        features = frontend.encode_together([waveform * gain], [n_frames])[0]
        progress(1.0)
        return features
    phases = len(frontend.shifts)
    store = torch.float32 if n_frames <= EXACT_FRAMES else torch.float16
    stages = 2 + frontend.recurrent.num_layers + len(frontend.rig)
    done, calls = count(1), phases * stages * -(-n_frames // PIECE_FRAMES)

    def tick() -> None:
        progress(min(next(done) / calls, 1.0))

    rows: Tensor | None = None
    for shift in frontend.shifts:
        sound = _Sound(waveform.unsqueeze(0), gain, shift)
        features = _features(frontend, sound, n_frames, store, tick)
        if rows is None:
            rows = features / phases
        else:
            for start, stop in _pieces(n_frames, PIECE_FRAMES):
                rows[start:stop] += features[start:stop] / phases
        del features  # its memory is for the next phase
    assert rows is not None
    return rows


class _Sound(NamedTuple):
    """A waveform (1, S), the factor on it, and the samples by which its spectra are late."""

    waveform: Tensor
    gain: float
    shift: int


def _features(
    frontend: MelLayers,
    sound: _Sound,
    n_frames: int,
    store: torch.dtype,
    tick: Callable[[], None],
) -> Tensor:
    """Features (n_frames, D) of one phase; `tick` is called per piece and stage."""
    block, centres = _memory(frontend, sound, n_frames, store, tick)
    memory = block[: int(centres[-1]) + 1]
    rows = block if _can_overwrite(frontend, centres) else torch.empty_like(block[:n_frames])
    for start, stop in _pieces(n_frames, PIECE_FRAMES):
        rows[start:stop] = _attended(frontend, memory, centres[start:stop])
        tick()
    rows, context = rows[:n_frames], block[n_frames : 2 * n_frames]
    for rig in frontend.rig:
        layer_output(cast(Any, rig).recurrent, 0, rows, tick, output=context)
        for start, stop in _pieces(n_frames, PIECE_FRAMES):
            rows[start:stop] += cast(Any, rig).project(context[start:stop].float())
    return rows


def _can_overwrite(frontend: MelLayers, centres: Tensor) -> bool:
    """Whether the rows of a piece lie before all states that the next pieces need."""
    stops, reach = range(PIECE_FRAMES, len(centres), PIECE_FRAMES), _reach(frontend)
    return all(int(centres[stop]) - reach >= stop for stop in stops)


def _memory(
    frontend: MelLayers,
    sound: _Sound,
    n_frames: int,
    store: torch.dtype,
    tick: Callable[[], None],
) -> tuple[Tensor, Tensor]:
    """States of the Time-BiLSTM (K or more, 2 H), and the one of each frame.

    The block has room for two rows of a frame.
    """
    centres = nearest_spectra(n_frames, frontend.config.frame_rate, frontend.config.time_stack)
    length, lstm = int(centres[-1]) + 1, frontend.recurrent
    width, device = 2 * lstm.hidden_size, frontend.mel.tapers.device
    # One block of memory for input and outputs: pieces of it would not go back to the system.
    shape = max(length, 2 * n_frames), max(lstm.input_size, width)
    block = torch.empty(shape, dtype=store, device=device)
    sequence = block[:length, -lstm.input_size :]
    for first, last in _pieces(length, 2 * PIECE_FRAMES):
        sequence[first:last] = _spectral(frontend, sound, first, last, length)
        tick()
    for layer in range(lstm.num_layers):
        output, covers = block[:, :width], sequence.shape[1] > lstm.hidden_size
        if covers and store != torch.float16:  # of a short clip: memory for time
            output, covers = torch.empty_like(output), False
        sequence = layer_output(lstm, layer, sequence, tick, output=output[:length], covers=covers)
    return output, centres


def _pieces(length: int, size: int) -> Iterator[tuple[int, int]]:
    """Ranges of at most `size` that cover a sequence."""
    for first in range(0, length, size):
        yield first, min(first + size, length)


def _spectral(frontend: MelLayers, sound: _Sound, first: int, last: int, length: int) -> Tensor:
    """Input (n, C) of the Time-BiLSTM, states `first` to `last - 1` of `length`."""
    stack = frontend.config.time_stack
    # Derivatives reach two spectra further; at the ends of the clip they repeat.
    before, after = min(2, first * stack), min(2, (length - last) * stack)
    begin, n_spectra = first * stack - before, (last - first) * stack + before + after
    mel = frontend.mel(sound.waveform, n_spectra, begin, sound.shift, sound.gain)
    mel = mel[..., before : n_spectra - after]
    spectral: Tensor = frontend.spectral(mel)
    return spectral.reshape(last - first, -1)


def layer_output(
    lstm: nn.LSTM,
    layer: int,
    sequence: Tensor,
    tick: Callable[[], None] = lambda: None,
    *,
    output: Tensor,
    covers: bool = False,
) -> Tensor:
    """Output (K, 2 H) of one bidirectional layer.

    Parameters
    ----------
    lstm : nn.LSTM
        Bidirectional, batch first.
    layer : int
        Number of the layer.
    sequence : Tensor [shape=(K, C)]
        Input, in float32 or float16; so is the output.
    tick : callable
        Called for every 480 rows or fewer.
    output : Tensor [shape=(K, 2 H)]
        Where the output is written.
    covers : bool
        The output lies over the input. The forward direction is computed twice then: from the
        first piece to the last for its states, and with the backward direction for its rows.

    Returns
    -------
    Tensor
        `output`.
    """
    size = lstm.hidden_size
    pieces = list(_pieces(len(sequence), 2 * PIECE_FRAMES))
    states: list[State | None] = [None]
    for first, last in pieces:
        rows, state = _direction(lstm, layer, "", sequence[first:last].float(), states[-1])
        states.append(state)
        if not covers:
            output[first:last, :size] = rows
    behind: State | None = None
    for (first, last), before in zip(reversed(pieces), reversed(states[:-1]), strict=True):
        piece = sequence[first:last].float().clone()
        if covers:
            output[first:last, :size] = _direction(lstm, layer, "", piece, before)[0]
        rows, behind = _direction(lstm, layer, "_reverse", piece.flip(0), behind)
        output[first:last, size:] = rows.flip(0)
        tick()
    return output


def _direction(
    lstm: nn.LSTM, layer: int, suffix: str, piece: Tensor, state: State | None
) -> tuple[Tensor, State]:
    """Output (n, H) of one direction of one layer over a piece (n, C), and its last state."""
    parts = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
    weights = [getattr(lstm, f"{part}_l{layer}{suffix}") for part in parts]
    if state is None:
        zeros = weights[0].new_zeros(1, 1, lstm.hidden_size)
        state = zeros, zeros
    output, hidden, cell = torch.lstm(
        piece.unsqueeze(0), state, weights, True, 1, 0.0, False, False, True
    )
    return output[0], (hidden, cell)


def _reach(frontend: MelLayers) -> int:
    """States on either side of a frame's own that its attention depends on, or more."""
    config = frontend.config
    return config.window_frames // config.time_stack + config.query_frames


def _attended(frontend: MelLayers, memory: Tensor, centres: Tensor) -> Tensor:
    """Rows (n, D) around some states of the memory."""
    config, attention = frontend.config, frontend.attention
    window, reach = config.window_frames // config.time_stack, _reach(frontend)
    first, last = max(int(centres[0]) - reach, 0), int(centres[-1]) + reach + 1
    near = memory[first:last].float().unsqueeze(0)
    places = (centres - first).to(near.device)
    rows: Tensor = frontend.centred(attention.along(near, places, window), near[:, places])
    return rows[0]
