"""Speech features of a voice that has not ended: mel spectra at a running level, a forward LSTM.

Not in the papers, whose encoders need the whole clip. One spectrum is gathered as in SDFA §3.2
(`deitalk.frontends.mel_bilstm.SpectralGathering`, which depends on no other spectrum); along time a
forward LSTM runs a few rig frames ahead of the frame that is read. State is explicit: a clip in
one piece and in any pieces gives the same features, to rounding.

Spectra come in groups, one a rig frame. With the default settings the features of frame t depend
on the sound until 133 ms after it::

    group          t        t+1       t+2       t+3
    spectra      2t 2t+1   .. 2t+3   .. 2t+5   .. 2t+7
                                        |         +- slopes of the last two
                                        +- the LSTM is read here

Letters: B streams, W samples of a spectrum, P spectra of a group, F mel bins, D features.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.mel import MelSpectrogram, derivative
from deitalk.config import CausalMelConfig
from deitalk.frontends.mel_bilstm import SpectralGathering

BLOCK_FRAMES = 256
"""Rig frames of a clip that are encoded at once."""
FEW_GROUPS = 4
"""Groups up to which the LSTM runs step by step."""
SLOPE_REACH = 2
"""Spectra on either side of one that its second derivative depends on."""


class CausalState(NamedTuple):
    """What a stream keeps between two calls."""

    level: Tensor
    """Running level and its weight [shape=(B, 2)]."""
    mel: Tensor
    """Last columns of the scaled spectrogram [shape=(B, F, K)]."""
    hidden: Tensor
    """Of the LSTM [shape=(B, layers, units)]."""
    cell: Tensor
    """Of the LSTM [shape=(B, layers, units)]."""


class CausalMelFrontend(nn.Module):
    """Waveform to speech features at 30 Hz, from the past and a bounded look-ahead.

    Parameters
    ----------
    config : CausalMelConfig

    Attributes
    ----------
    output_size : int
        Width D of a row.
    delay : int
        Groups that must come after a frame's own before its features are known.
    """

    def __init__(self, config: CausalMelConfig) -> None:
        super().__init__()
        self.config, self.output_size = config, config.time_hidden
        self.slope_groups = -(-SLOPE_REACH // config.frame_spectra)
        self.delay = config.lookahead_frames + self.slope_groups
        rate = float(FRAME_RATE * config.frame_spectra)
        self.mel = MelSpectrogram(config.window_seconds, rate, config.n_mels, config.tapers)
        self.spectral = SpectralGathering(
            config.n_mels, config.conv_channels, config.spec_hidden, config.spectral_size
        )
        self.recurrent = nn.LSTM(
            config.spectral_size,
            config.time_hidden,
            config.time_layers,
            batch_first=True,
            dropout=config.dropout if config.time_layers > 1 else 0.0,
        )
        self.project = nn.Linear(config.time_hidden, config.time_hidden)

    def forward(self, waveform: Tensor, n_frames: int) -> Tensor:
        """Map (B, S) at 16 kHz to (B, n_frames, D); row i describes time i / 30 s.

        Instead of samples, `gathered` spectra (B, G, P, C_spec) that were computed before are
        taken too; they end `lookahead_frames` after the last frame.
        """
        if waveform.dim() == 4:
            return self._run(waveform, self.first_state(len(waveform)))[0][:, -n_frames:]
        features = self._pieces(waveform, n_frames, lambda share: None)
        return features

    @torch.no_grad()
    def encode(
        self,
        waveform: Tensor,
        n_frames: int,
        *,
        progress: Callable[[float], None] = lambda share: None,
    ) -> Tensor:
        """Map a whole clip (S,) to (n_frames, D), block by block: memory does not grow.

        `progress` is called with the share done, 0 to 1.
        """
        return self._pieces(waveform.unsqueeze(0), n_frames, progress)[0]

    def first_state(self, batch: int) -> CausalState:
        """State of streams before their first sample."""
        config = self.config
        weight = self.project.weight
        columns = SLOPE_REACH + self.slope_groups * config.frame_spectra
        silence = self.mel.scaled(weight.new_zeros(batch, columns, config.n_mels))
        shape = batch, config.time_layers, config.time_hidden
        level = first_level(batch, weight)
        return CausalState(level, silence, weight.new_zeros(shape), weight.new_zeros(shape))

    def gathered(self, windows: Tensor, state: CausalState) -> tuple[Tensor, CausalState]:
        """Features of spectra, `slope_groups` groups later than the windows.

        Parameters
        ----------
        windows : Tensor [shape=(B, G P, W)]
            Samples of whole groups of spectra, any level.
        state : CausalState
            From `first_state`, or from the call before.

        Returns
        -------
        rows : Tensor [shape=(B, G, P, C_spec)]
        state : CausalState
            For the next call.
        """
        batch, count, _ = windows.shape
        spectra = self.config.frame_spectra
        power = self.mel.power(windows.to(self.project.weight.device))  # (B, G P, F)
        scale = 2 * self.mel.length / (self.mel.n_fft * self.mel.tapers.square().sum())
        loud = power.sum(dim=2).view(batch, -1, spectra).mean(dim=2) * scale
        level, kept = follow_level(loud, state.level)
        gain = (USUAL_POWER / level).repeat_interleave(spectra, dim=1).unsqueeze(2)
        mel = torch.cat((state.mel, self.mel.scaled(power * gain)), dim=2)
        slope = derivative(mel)
        inner = slice(SLOPE_REACH, SLOPE_REACH + count)
        image = torch.stack((mel, slope, derivative(slope)), dim=1)[..., inner]
        rows: Tensor = self.spectral(image)
        state = state._replace(level=kept, mel=mel[..., count:])
        return rows.view(batch, -1, spectra, rows.shape[2]), state

    def advance(self, windows: Tensor, state: CausalState) -> tuple[Tensor, CausalState]:
        """Speech features (B, G, D) of the frames that are `delay` groups before the windows.

        Parameters and the returned state are those of `gathered`.
        """
        rows, state = self.gathered(windows, state)
        return self._run(rows, state)

    def _run(self, rows: Tensor, state: CausalState) -> tuple[Tensor, CausalState]:
        batch, groups, spectra, size = rows.shape
        if groups <= FEW_GROUPS and not torch.is_grad_enabled():
            read, state = self._step(rows.reshape(batch, -1, size), state)
            return self.project(read.view(batch, groups, spectra, -1)[:, :, -1]), state
        before = tuple(part.transpose(0, 1).contiguous() for part in (state.hidden, state.cell))
        memory, (hidden, cell) = self.recurrent(rows.reshape(batch, -1, size), before)
        read = memory.view(batch, groups, spectra, -1)[:, :, -1]
        state = state._replace(hidden=hidden.transpose(0, 1), cell=cell.transpose(0, 1))
        return self.project(read), state

    def _step(self, rows: Tensor, state: CausalState) -> tuple[Tensor, CausalState]:
        """The LSTM on so few rows (B, L, C_spec) that its preparations cost more than its work."""
        hiddens, cells = [], []
        for k in range(self.config.time_layers):
            given, own, *biases = self.recurrent.all_weights[k]
            gates = F.linear(rows, given, biases[0] + biases[1])
            hidden, cell, outs = state.hidden[:, k], state.cell[:, k], []
            for row in gates.unbind(dim=1):
                into, keep, new, out = (row + F.linear(hidden, own)).chunk(4, dim=1)
                cell = keep.sigmoid() * cell + into.sigmoid() * new.tanh()
                hidden = out.sigmoid() * cell.tanh()
                outs.append(hidden)
            rows = torch.stack(outs, dim=1)
            hiddens.append(hidden)
            cells.append(cell)
        hidden, cell = torch.stack(hiddens, dim=1), torch.stack(cells, dim=1)
        return rows, state._replace(hidden=hidden, cell=cell)

    def _pieces(self, waveform: Tensor, n_frames: int, progress: Callable[[float], None]) -> Tensor:
        """Features of a clip from its beginning (B, n_frames, D)."""
        state, parts = self.first_state(len(waveform)), []
        total, spectra = n_frames + self.delay, self.config.frame_spectra
        for first in range(0, total, BLOCK_FRAMES):
            count = min(BLOCK_FRAMES, total - first)
            windows = self.mel.windows(waveform, count * spectra, first * spectra)
            features, state = self.advance(windows, state)
            parts.append(features)
            progress((first + count) / total)
        return torch.cat(parts, dim=1)[:, self.delay :]


# Running level of a voice that has not ended: the causal form of `normalise_level`.
#
# The level is a mean of the power of the frames so far that forgets, and counts a frame by how loud
# it is beside the mean. Pauses and quiet noise hardly change it. It begins with that of a quiet
# voice, with the weight of a few frames.
#
# Letters: B streams, T rig frames.


USUAL_POWER = 10**-2.3
"""Mean square of speech at the level of the training, -23 dB re full scale."""
FORGET_FRAMES = 240.0
"""Frames of speech that the mean remembers (8 s)."""
FIRST_POWER, FIRST_FRAMES = 10**-3.3, 4.0
"""Mean at the start, and its weight in frames: a quiet voice, which a loud one corrects at once."""
QUIET = 0.02
"""Power beside a mean of full weight, -17 dB, at which a frame counts half; less for a young mean,
which is to find quiet voices soon."""
SOFTEST, LOUDEST = 1e-7, 10.0
"""Limits of the mean square: -70 to 10 dB."""


def first_level(batch: int, like: Tensor) -> Tensor:
    """State before the first frame [shape=(B, 2)]: the mean and its weight in frames."""
    return like.new_tensor([FIRST_POWER, FIRST_FRAMES]).repeat(batch, 1)


def follow_level(power: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
    """Running level at each frame, of that frame and those before it.

    Parameters
    ----------
    power : Tensor [shape=(B, T)]
        Mean square of every frame's sound.
    state : Tensor [shape=(B, 2)]
        From `first_level`, or from the call before.

    Returns
    -------
    level : Tensor [shape=(B, T)]
        Mean square of the speech so far.
    state : Tensor [shape=(B, 2)]
        For the next call.
    """
    level, weight = state.unbind(dim=1)
    levels = []
    for now in power.unbind(dim=1):
        share = now / (now + QUIET * level * weight / FORGET_FRAMES)
        weight = weight * (1 - share / FORGET_FRAMES) + share
        level = level + (now - level) * (share / weight)
        level = level.clamp(SOFTEST, LOUDEST)
        levels.append(level)
    return torch.stack(levels, dim=1), torch.stack((level, weight), dim=1)
