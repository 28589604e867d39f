"""The first layers of Whisper's speech encoder, read at the rig's 30 Hz.

DEITalk §3.2 takes wav2vec 2.0. Deviation: Whisper (Radford et al., "Robust Speech Recognition via
Large-Scale Weak Supervision", 2022; MIT), whose training heard more voices, rooms and languages
than any here; scores are in MODEL_CARD.md.

Deviation: the published encoder gives 50 features a second, of two spectra each. Here a feature is
a rig frame: of three spectra, 90 a second. Nothing is resampled, and attention and linear maps cost
three fifths. The weights are those of the published encoder, tuned to this rate and to noise
(`deitalk.research.training.encoder_noise`); ``rate: 50`` is the published encoder itself.

The encoder is written anew because importing ``transformers`` takes three times as long as torch;
the names and numbers of its weights are those of ``transformers``' ``WhisperEncoder``.

B batch, S samples, M mel frames, K features, D width.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.log_mel import (
    DYNAMIC_RANGE,
    N_FFT,
    PUBLISHED_RATE,
    SILENCE,
    centres,
    hann_window,
    log_mel_filters,
    loudest,
)
from deitalk.config import WhisperShape
from deitalk.errors import CheckpointError
from deitalk.frontends.strided import StridedFrontend

SPECTRA = {30: 3, 50: 2}
"""Mel frames of a feature, by the features a second."""
PUBLISHED_FEATURES = 50
"""Features a second of the published models, by which positions are counted."""
MOST_SECONDS = 30
"""Longest sound that is encoded at once; the published models know no position beyond."""


class LogMel(nn.Module):
    """Whisper's log-mel spectrogram, for a clip of any length and for its pieces.

    Deviation: outside the recording there is silence, where Whisper mirrors the sound.

    Parameters
    ----------
    n_mels : int
    rate : int
        Mel frames a second.
    """

    filters: Tensor
    window: Tensor

    def __init__(self, n_mels: int, rate: int = PUBLISHED_RATE) -> None:
        super().__init__()
        self.rate = rate
        filters = torch.from_numpy(log_mel_filters(n_mels).T.copy())
        self.register_buffer("filters", filters, persistent=False)
        self.register_buffer("window", torch.from_numpy(hann_window()), persistent=False)

    def windows(self, waveform: Tensor, n_frames: int, first: int = 0) -> Tensor:
        """Samples (B, M, 400) of mel frames `first` … `first` + `n_frames` - 1 of (B, S)."""
        starts = centres(first, n_frames, self.rate) - N_FFT // 2
        begin, end = int(starts[0]), int(starts[-1]) + N_FFT
        piece = waveform[:, max(begin, 0) : max(end, 0)]
        before = max(-begin, 0)
        padded = F.pad(piece, (before, end - begin - before - piece.shape[1]))
        return padded.unfold(1, N_FFT, 1)[:, torch.from_numpy(starts - begin).to(waveform.device)]

    def decades(self, windows: Tensor) -> Tensor:
        """Logarithm to base 10 (B, M, F) of the mel power of windows (B, M, 400)."""
        spectra = torch.fft.rfft(windows * self.window)
        power = torch.view_as_real(spectra).square().sum(dim=-1) @ self.filters
        return power.clamp(min=SILENCE).log10()

    def forward(self, waveform: Tensor, n_frames: int, peak: float | None = None) -> Tensor:
        """Spectrogram (B, F, M) of (B, S).

        Parameters
        ----------
        waveform : Tensor [shape=(B, S)]
            16 kHz.
        n_frames : int
            M; frame j is at j / rate s.
        peak : float or None
            `loudest` of the whole clip; None: each row is a whole clip.
        """
        decades = self.decades(self.windows(waveform, n_frames))
        if peak is None:
            return scaled(decades, decades.amax(dim=(1, 2), keepdim=True))
        return scaled(decades, peak)


def scaled(decades: Tensor, peak: Tensor | float) -> Tensor:
    """The spectrogram (B, F, M) of `LogMel.decades` (B, M, F), at most 8 decades below the peak."""
    floor = torch.as_tensor(peak, device=decades.device) - DYNAMIC_RANGE
    return ((torch.maximum(decades, floor) + 4) / 4).transpose(1, 2)


def _gelu(x: Tensor) -> Tensor:
    """GELU, in the memory of its argument where no gradient needs it."""
    if torch.is_grad_enabled():
        return F.gelu(x)
    out: Tensor = torch.ops.aten.gelu_(x)
    return out


class Attention(nn.Module):
    """Self-attention of a `Layer`."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.q_proj = nn.Linear(width, width)
        self.k_proj = nn.Linear(width, width, bias=False)
        self.v_proj = nn.Linear(width, width)
        self.out_proj = nn.Linear(width, width)

    def forward(self, x: Tensor, mask: Tensor | None = None) -> Tensor:
        """Map (B, K, D) to (B, K, D); `mask` is that of `WhisperEncoder.forward`."""
        return self.mixed(x, self.k_proj(x), self.v_proj(x), mask)

    def mixed(self, x: Tensor, keys: Tensor, values: Tensor, mask: Tensor | None) -> Tensor:
        """Map rows (B, Q, D) to (B, Q, D), from keys and values (B, K, D)."""
        q, k, v = (
            rows.unflatten(-1, (self.heads, -1)).transpose(1, 2)
            for rows in (self.q_proj(x), keys, values)
        )
        mixed = F.scaled_dot_product_attention(q, k, v, mask)  # (B, heads, Q, D / heads)
        out: Tensor = self.out_proj(mixed.transpose(1, 2).flatten(2))
        return out


class Layer(nn.Module):
    """One layer of the encoder: attention, then two linear maps, each after a LayerNorm."""

    def __init__(self, width: int, heads: int, inner: int) -> None:
        super().__init__()
        self.self_attn = Attention(width, heads)
        self.self_attn_layer_norm = nn.LayerNorm(width)
        self.fc1 = nn.Linear(width, inner)
        self.fc2 = nn.Linear(inner, width)
        self.final_layer_norm = nn.LayerNorm(width)

    def forward(self, x: Tensor, mask: Tensor | None = None) -> Tensor:
        """Map (B, K, D) to (B, K, D); `mask` is that of `WhisperEncoder.forward`."""
        return self.after(self.self_attn(self.self_attn_layer_norm(x), mask).add_(x))

    def after(self, x: Tensor) -> Tensor:
        """What follows attention, (B, K, D) to (B, K, D)."""
        out: Tensor = self.fc2(_gelu(self.fc1(self.final_layer_norm(x)))).add_(x)
        return out


class WhisperEncoder(nn.Module):
    """Two convolutions, fixed positions and the first layers of the encoder.

    Parameters
    ----------
    config : WhisperShape
    """

    positions: Tensor

    def __init__(self, config: WhisperShape) -> None:
        super().__init__()
        width = config.width
        self.conv1 = nn.Conv1d(config.n_mels, width, 3, padding=1)
        self.conv2 = nn.Conv1d(width, width, 3, stride=SPECTRA[config.rate], padding=1)
        positions = sinusoids(config.rate * MOST_SECONDS, PUBLISHED_FEATURES / config.rate, width)
        self.register_buffer("positions", positions, persistent=False)
        self.layers = nn.ModuleList(
            Layer(width, config.heads, config.intermediate) for _ in range(max(config.layers))
        )

    def forward(
        self, mel: Tensor, mask: Tensor | None = None, places: Tensor | None = None
    ) -> list[Tensor]:
        """States (B, K, D) before the layers and after each; the last is not normalised.

        Parameters
        ----------
        mel : Tensor [shape=(B, F, M)]
            Of at most 30 s.
        mask : Tensor [shape=(K, K) or (B, 1, K, K), dtype=bool] or None
            Which feature (row) attends to which; None: each to all.
        places : Tensor [shape=(B, K), dtype=int64] or None
            Places in the table of positions; None: 0 to K - 1.
        """
        x = _gelu(self.conv1(mel))
        x = _gelu(self.conv2(x)).transpose(1, 2)
        positions = self.positions[: x.shape[1]] if places is None else self.positions[places]
        states = [x + positions]
        for layer in self.layers:
            states.append(layer(states[-1], mask))
        return states


def sinusoids(count: int, step: float, width: int) -> Tensor:
    """Sines and cosines (count, width) of the positions 0, step, 2 step … (Vaswani et al. 2017).

    In single precision, as the published tables were made.
    """
    half = width // 2
    waves = torch.exp(-math.log(10_000) / (half - 1) * torch.arange(half, device="cpu"))
    angles = step * torch.arange(count, device="cpu").unsqueeze(1) * waves
    return torch.cat((angles.sin(), angles.cos()), dim=1)


class WhisperFrontend(StridedFrontend):
    """States of some layers, standardised and mixed, with one row per rig frame.

    Feature k describes the time k / rate s. A clip is encoded in pieces of ten seconds: Whisper's
    own padding to 30 s is left out, which changes these layers by a correlation of .99.

    Parameters
    ----------
    config : WhisperShape
    """

    centre = 0.0
    chunk_seconds, overlap_seconds = 10.0, 1.0
    most_together = 120

    def __init__(self, config: WhisperShape) -> None:
        super().__init__()
        self.config, self.spectra = config, SPECTRA[config.rate]
        self.stride = SAMPLE_RATE / config.rate
        self.margin = 0 if config.rate == FRAME_RATE else round(self.stride)
        self.mel = LogMel(config.n_mels, config.rate * self.spectra)
        self.encoder = WhisperEncoder(config)
        self.output_size = config.width
        self.mix_layers(config.layers, config.width)
        if config.learns == "nothing":
            self.encoder.requires_grad_(False)

    @classmethod
    def build(cls, config: WhisperShape, *, pretrained: bool = True) -> Self:
        """Make the frontend of a configuration.

        Parameters
        ----------
        config : WhisperShape
            With a checkpoint, its weights are read.
        pretrained : bool
            False leaves the weights random, because they follow.
        """
        frontend = cls(config)
        if pretrained and config.checkpoint is not None:
            frontend.encoder.load_state_dict(
                encoder_weights(config.checkpoint, frontend.encoder.state_dict())
            )
        return frontend

    def described(self, config: WhisperShape) -> WhisperShape:
        """The configuration without its checkpoint."""
        return config.model_copy(update={"checkpoint": None})

    def is_fixed(self, name: str) -> bool:
        """Whether a weight is of the encoder, and that does not learn."""
        return name.startswith("encoder.") and self.config.learns == "nothing"

    def count(self, n_samples: int) -> int:
        """Features of a sound."""
        return -(-n_samples * self.config.rate // SAMPLE_RATE)

    def survey(self, waveform: Tensor, gain: float) -> float:
        """Loudest mel power of the whole clip, from which the floor of every piece follows."""
        n_frames = self.count(len(waveform)) * self.spectra
        found = loudest(waveform.cpu().numpy(), self.config.n_mels, n_frames, self.mel.rate)
        return found + 2 * math.log10(gain)

    def features(self, waveform: Tensor, context: float | None = None) -> Tensor:
        """Features (B, K, D) of (B, S), at most 30 s."""
        mel = self.mel(waveform, self.count(waveform.shape[1]) * self.spectra, context)
        states = self.encoder(mel)
        return self.mixed([state.flatten(0, 1) for state in states]).view_as(states[0])

    @torch.no_grad()
    def encode_together(self, waveforms: Sequence[Tensor], n_frames: int) -> Tensor:
        """Rows (B, n_frames, D) of clips (S,) of one piece, as `encode` of each, to rounding.

        Those with equally many features are one batch.
        """
        sizes = [
            self.count(len(waveform)) * SAMPLE_RATE // self.config.rate for waveform in waveforms
        ]
        rows = waveforms[0].new_empty(len(waveforms), n_frames, self.output_size)
        for size in set(sizes):
            places = [place for place, other in enumerate(sizes) if other == size]
            padded = [F.pad(waveforms[p], (0, size - len(waveforms[p]))) for p in places]
            rows[places] = self(torch.stack(padded), n_frames)
        return rows


def encoder_weights(name: str, wanted: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Weights of the first layers of a Whisper checkpoint.

    Parameters
    ----------
    name : str
        Name on the Hugging Face hub, or a folder with ``model.safetensors``: of a whole Whisper
        model or of its encoder.
    wanted : mapping of str to Tensor
        Names and shapes of the weights.

    Raises
    ------
    CheckpointError
        Not there, not reachable, without safetensors, or of another shape.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    path = Path(name) / "model.safetensors"
    if not path.is_file():
        from transformers.utils.hub import cached_file

        try:
            path = Path(str(cached_file(name, "model.safetensors")))
        except (OSError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise CheckpointError(
                f"{name}: no Whisper checkpoint ({reason}); name a folder or a model of the hub"
            ) from None
    try:
        given = load_file(path)
    except SafetensorError as error:
        raise CheckpointError(f"{path}: damaged ({error}); fetch or save it again") from None
    found = {}
    for key, value in wanted.items():
        names = (key, f"encoder.{key}", f"model.encoder.{key}")
        weights = next((given[n] for n in names if n in given), None)
        if weights is None or weights.shape != value.shape:
            raise CheckpointError(
                f"{name}: {key} is {None if weights is None else tuple(weights.shape)}, not "
                f"{tuple(value.shape)}; set width, heads and intermediate as in its config.json"
            )
        found[key] = weights.float()
    return found
