"""Spectral gathering and temporal attention: the mel frontends (SDFA §3.1-3.3, Tables 1-2).

Deviation: convolutions and Spec-BiLSTM depend on one spectrum at a time, so they run once per
spectrum and windows are gathered afterwards; the result is the same. With ``recurrence: segment``
the Time-BiLSTM runs along the clip instead of once per window (some ten times less work).

N windows, W spectra of a window.
"""

from collections.abc import Callable, Sequence
from typing import Self

import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torch.nn.utils.parametrizations import weight_norm

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.mel import MelSpectrogram, nearest_spectra
from deitalk.config.frontends import MelConfig
from deitalk.frontends.base import Frontend

SEGMENT_FRAMES = 960
"""Rig frames whose windows are encoded at once on a clip, with ``recurrence: window`` (32 s)."""
CONTEXT_FRAMES = 256
"""Rig frames of context on either side of them, computed and not kept, for the rig's layers."""
TOGETHER_FRAMES = 375
"""Most rig frames of recordings that are read together (12.5 s)."""
ATTENDED_FRAMES = 128
"""Rig frames whose attention is applied at once: a matrix of so many rows, banded."""
ONE_BATCH_FRAMES = 600
"""Longest clips (20 s) that are encoded as one batch."""


class FrequencyConv(nn.Conv1d):
    """Convolution along frequency of many spectra side by side (B, C, F, L): a 3x1 kernel."""

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, C, F, L) to (B, C', F, L)."""
        padding = (int(self.padding[0]), 0)
        return F.conv2d(x, self.weight.unsqueeze(-1), self.bias, padding=padding)


class SpectralGathering(nn.Module):
    """Formant analysis, one spectrum at a time (SDFA §3.2, Table 1).

    Parameters
    ----------
    n_mels : int
    conv_channels : (int, int, int)
        Filters of the two 3x1 convolutions and of the 1x1 convolution.
    hidden : int
        Spec-BiLSTM units per direction.
    out_size : int
    """

    def __init__(
        self, n_mels: int, conv_channels: tuple[int, int, int], hidden: int, out_size: int
    ) -> None:
        super().__init__()
        first, second, third = conv_channels
        self.convolve = nn.Sequential(
            FrequencyConv(3, first, 3, padding=1),
            nn.BatchNorm2d(first),
            nn.MaxPool2d((2, 1)),  # before the activation, which rises: the same, with half of it
            nn.LeakyReLU(0.2),
            FrequencyConv(first, second, 3, padding=1),
            nn.BatchNorm2d(second),
            nn.MaxPool2d((2, 1)),
            nn.LeakyReLU(0.2),
            FrequencyConv(second, third, 1),
            nn.BatchNorm2d(third),
            nn.LeakyReLU(0.2),
        )
        self.gather = nn.LSTM(third, hidden, batch_first=True, bidirectional=True)
        self.project = nn.Linear(2 * hidden * (n_mels // 4), out_size)

    def forward(self, mel: Tensor) -> Tensor:
        """Map (B, 3, F, L) to (B, L, out_size)."""
        batch, _, _, length = mel.shape
        # One image a clip, channels last: less work than a batch of single spectra.
        x = self.convolve(mel.contiguous(memory_format=torch.channels_last))
        x = x.permute(0, 3, 2, 1).flatten(0, 1)  # (B L, F / 4, third)
        x, _ = self.gather(x)
        out: Tensor = self.project(x.flatten(1)).view(batch, length, -1)
        return out


class TemporalAttention(nn.Module):
    """Additive attention over a window; its central frames are the query (SDFA §3.3, Fig. 2).

    Parameters
    ----------
    size : int
        Width of the memory (C_time).
    attention_size : int
        C_att.
    query_frames : int
        K_qry, odd.
    """

    def __init__(self, size: int, attention_size: int, query_frames: int) -> None:
        super().__init__()
        self.query_frames = query_frames
        self.query = nn.Conv1d(size, size, query_frames)
        self.query_project = nn.Linear(size, attention_size)
        self.key_project = nn.Linear(size, attention_size)
        self.score = nn.Linear(attention_size, 1, bias=False)

    def windows(self, memory: Tensor, query: Tensor) -> tuple[Tensor, Tensor]:
        """Attend within windows.

        Parameters
        ----------
        memory : Tensor [shape=(N, L, size)]
            Time-BiLSTM states m of a window.
        query : Tensor [shape=(N, query_frames, size)]
            Its central frames.

        Returns
        -------
        attended : Tensor [shape=(N, size)]
        weights : Tensor [shape=(N, L)], sum 1
        """
        projected = self.query_project(self.query(query.transpose(1, 2)).squeeze(-1))
        keys = self.key_project(memory)
        scores = self.score(torch.tanh(keys + projected.unsqueeze(1))).squeeze(-1)
        weights = scores.softmax(dim=-1)
        return torch.einsum("nl,nld->nd", weights, memory), weights

    def joined_query(self) -> tuple[Tensor, Tensor]:
        """Query convolution and its projection as one convolution: a twelfth of the products."""
        project, query = self.query_project, self.query
        assert query.bias is not None
        weight = torch.einsum("ac,cdk->adk", project.weight, query.weight)
        return weight, project.weight @ query.bias + project.bias

    def along(self, memory: Tensor, centres: Tensor, window: int) -> Tensor:
        """Attend around given places of the memory of a whole clip.

        Parameters
        ----------
        memory : Tensor [shape=(B, L, size)]
            Time-BiLSTM states along a clip.
        centres : Tensor [shape=(T,)]
            Index of the window's centre for every output frame.
        window : int
            Spectra in a window; those outside the memory get no weight.

        Returns
        -------
        Tensor [shape=(B, T, size)]
        """
        batch, length, _ = memory.shape
        half = self.query_frames // 2
        padded = F.pad(memory.transpose(1, 2), (half, half))
        if torch.is_grad_enabled():
            projected = self.query_project(self.query(padded).transpose(1, 2)[:, centres])
        else:
            projected = F.conv1d(padded, *self.joined_query()).transpose(1, 2)[:, centres]
        keys = self.key_project(memory)  # (B, L, C_att)
        around = torch.arange(window, device=memory.device) - window // 2
        rows = []
        for part in torch.split(torch.arange(len(centres), device=centres.device), ATTENDED_FRAMES):
            index = centres[part].unsqueeze(1) + around
            outside = (index < 0) | (index >= length)
            places = index.clamp(0, length - 1)
            query = projected[:, part].unsqueeze(2)
            scores = self.score(torch.tanh(keys[:, places] + query)).squeeze(-1)
            weights = scores.masked_fill(outside, -torch.inf).softmax(dim=-1)  # (B, T, window)
            first, last = int(places.min()), int(places.max()) + 1
            spread = weights.new_zeros(batch, len(places), last - first)
            spread.scatter_add_(2, (places - first).expand(batch, -1, -1), weights)
            rows.append(spread.to(memory.dtype) @ memory[:, first:last])
        return torch.cat(rows, dim=1)


class RigBiLSTM(nn.Module):
    """Residual BiLSTM along rig frames: x + W BiLSTM(x).

    Not in the papers; meant for noise, where a sound must be inferred from its neighbours. W starts
    at 0, so that the weights of a model without such layers can start one with them
    (`deitalk.training.curve_losses`).

    Parameters
    ----------
    size : int
        Width of a row, even.
    dropout : float
        On the BiLSTM's output.
    """

    def __init__(self, size: int, dropout: float) -> None:
        super().__init__()
        self.recurrent = nn.LSTM(size, size // 2, batch_first=True, bidirectional=True)
        self.dropout = nn.Dropout(dropout)
        self.project = nn.Linear(size, size)
        nn.init.zeros_(self.project.weight)
        nn.init.zeros_(self.project.bias)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, T, size) to the same shape."""
        context, _ = self.recurrent(x)
        out: Tensor = x + self.project(self.dropout(context))
        return out


class MelFrontend(Frontend):
    """Waveform to speech features at 30 Hz.

    Parameters
    ----------
    config : MelConfig

    Attributes
    ----------
    output_size : int
        Width D of a row: twice the Time-BiLSTM's units.
    """

    def __init__(self, config: MelConfig) -> None:
        super().__init__()
        self.config = config
        self.output_size = 2 * config.time_hidden
        self.mel = MelSpectrogram(
            config.window_seconds, config.frame_rate, config.n_mels, config.tapers
        )
        self.spectral = SpectralGathering(
            config.n_mels, config.conv_channels, config.spec_hidden, config.spectral_size
        )
        self.recurrent = nn.LSTM(
            config.spectral_size * config.time_stack,
            config.time_hidden,
            config.time_layers,
            batch_first=True,
            bidirectional=True,
            dropout=config.dropout if config.time_layers > 1 else 0.0,
        )
        self.attention = TemporalAttention(
            self.output_size, config.attention_size, config.query_frames
        )
        # Deviation: attention alone keeps a closure of two frames only once its weights are
        # sharp; with the centre added it is kept from the start. The norm puts features on the
        # scale of the positional encoding that is added to them.
        self.normalise = nn.LayerNorm(self.output_size) if config.centre else None
        if config.weight_norm:
            normalise_weights(self)
        self.rig = nn.Sequential(  # after weight normalisation, undefined for 0
            *(RigBiLSTM(self.output_size, config.dropout) for _ in range(config.rig_layers))
        )

    @classmethod
    def build(cls, config: MelConfig, *, pretrained: bool = True) -> Self:
        """Make the frontend of a configuration; there are no weights to read."""
        return cls(config)

    def forward(self, waveform: Tensor, n_frames: int) -> Tensor:
        """Map (B, S) at 16 kHz to (B, n_frames, D); row i describes time i / 30 s."""
        return self._frames(waveform, 0, n_frames)

    @torch.no_grad()
    def encode(
        self,
        waveform: Tensor,
        n_frames: int,
        *,
        progress: Callable[[float], None] = lambda share: None,
        gain: float = 1.0,
    ) -> Tensor:
        """Map a whole clip (S,) times `gain` to (n_frames, D).

        With ``recurrence: window`` in segments with context; else each layer along the whole clip,
        since the memory of the Time-BiLSTM reaches over minutes. `progress` is called with the
        share done, 0 to 1.
        """
        waveform = (waveform * gain).unsqueeze(0)
        segment = SEGMENT_FRAMES if self.config.recurrence == "window" else n_frames
        rows = waveform.new_empty(n_frames, self.output_size)
        for start in range(0, n_frames, segment):
            stop = min(start + segment, n_frames)
            first, last = max(start - CONTEXT_FRAMES, 0), min(stop + CONTEXT_FRAMES, n_frames)
            rows[start:stop] = self._frames(waveform, first, last)[0, start - first : stop - first]
            progress(stop / n_frames)
        return rows

    @torch.no_grad()
    def encode_together(self, waveforms: Sequence[Tensor], counts: Sequence[int]) -> list[Tensor]:
        """Map clips (S,) to rows (T, D) of each, as `encode` of each, to rounding.

        Clips of one number of frames, up to 20 s, are one batch if ``recurrence: segment``.
        """
        if self.config.recurrence != "segment":
            return super().encode_together(waveforms, counts)
        rows: dict[int, Tensor] = {}
        for count in set(counts):
            places = [place for place, other in enumerate(counts) if other == count]
            clips = [waveforms[place] for place in places]
            if count <= ONE_BATCH_FRAMES:
                found = list(
                    self._frames(nn.utils.rnn.pad_sequence(clips, batch_first=True), 0, count)
                )
            else:
                found = super().encode_together(clips, [count] * len(clips))
            rows.update(zip(places, found, strict=True))
        return [rows[place] for place in range(len(counts))]

    def _frames(self, waveform: Tensor, first: int, last: int) -> Tensor:
        """Rows first..last; the mel window may reach outside them, the recurrence may not."""
        config = self.config
        if config.recurrence == "window":
            return self._frames_by_window(waveform, first, last)
        centres = nearest_spectra(last, config.frame_rate, config.time_stack)[first:]
        begin = int(centres[0])
        n_spectra = (int(centres[-1]) - begin + 1) * config.time_stack
        mel = self.mel(waveform, n_spectra, begin * config.time_stack)
        return self._from_spectral(self.spectral(mel), centres - begin)

    def _from_spectral(self, spectral: Tensor, places: Tensor) -> Tensor:
        """Features (B, T, D) of rows (B, L, C_spec), at T of their states."""
        config = self.config
        batch = spectral.shape[0]
        memory, _ = self.recurrent(spectral.reshape(batch, -1, self.recurrent.input_size))
        window = config.window_frames // config.time_stack
        places = places.to(memory.device)
        attended = self.attention.along(memory, places, window)
        out: Tensor = self.rig(self.centred(attended, memory[:, places]))
        return out

    def _frames_by_window(self, waveform: Tensor, first: int, last: int) -> Tensor:
        """As printed: for every rig frame a window of spectra, a Time-BiLSTM, an attention."""
        config = self.config
        half = config.window_frames // 2
        centres = nearest_spectra(last, config.frame_rate)[first:] + half  # padded by half a window
        begin = int(centres[0]) - half
        padded = F.pad(waveform, (round(half * SAMPLE_RATE / self.config.frame_rate), 0))
        n_spectra = int(centres[-1]) - half - begin + config.window_frames
        spectral = self.spectral(self.mel(padded, n_spectra, begin))  # (B, L, C_spec)
        index = (centres - half - begin).unsqueeze(1) + torch.arange(config.window_frames)
        batch, frames = spectral.shape[0], last - first
        windows = spectral[:, index.to(spectral.device)].flatten(0, 1)  # (B T, window, size)
        memory, _ = self.recurrent(windows)
        middle = half - config.query_frames // 2
        query = memory[:, middle : middle + config.query_frames]
        attended, _ = self.attention.windows(memory, query)
        attended = self.centred(attended, memory[:, half])
        out: Tensor = self.rig(attended.view(batch, frames, -1))
        return out

    def centred(self, attended: Tensor, centre: Tensor) -> Tensor:
        """Attended rows with the states at their centres added, on the scale of positions."""
        if self.normalise is None:
            return attended
        out: Tensor = self.normalise(attended + centre)
        return out


def normalise_weights(module: nn.Module) -> None:
    """Weight normalisation on every weight (SDFA §4.4)."""
    for child in module.modules():
        if isinstance(child, nn.Conv1d | nn.Linear):
            weight_norm(child)
        elif isinstance(child, nn.LSTM):
            for name in [name for name, _ in child.named_parameters() if name.startswith("weight")]:
                weight_norm(child, name)
