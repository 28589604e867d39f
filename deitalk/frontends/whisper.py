"""The first layers of Whisper's speech encoder, 50 Hz brought to the rig's 30 Hz.

DEITalk §3.2 takes wav2vec 2.0. Deviation: Whisper (Radford et al., "Robust Speech Recognition via
Large-Scale Weak Supervision", 2022; MIT), whose training heard more voices, rooms and languages
than any here; scores are in MODEL_CARD.md.

The encoder is written anew because importing ``transformers`` takes three times as long as torch;
the names and numbers of its weights are those of ``transformers``' ``WhisperEncoder``.

B batch, S samples, M mel frames at 100 Hz, K = M / 2 features at 50 Hz, D width.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.log_mel import (
    DYNAMIC_RANGE,
    HOP,
    N_FFT,
    SILENCE,
    frames_of,
    hann_window,
    log_mel_filters,
    loudest,
)
from deitalk.config import WhisperConfig
from deitalk.errors import CheckpointError
from deitalk.frontends.strided import StridedFrontend


class LogMel(nn.Module):
    """Whisper's log-mel spectrogram, for a clip of any length and for its pieces.

    Deviation: outside the recording there is silence, where Whisper mirrors the sound.

    Parameters
    ----------
    n_mels : int
    """

    filters: Tensor
    window: Tensor

    def __init__(self, n_mels: int) -> None:
        super().__init__()
        filters = torch.from_numpy(log_mel_filters(n_mels).T.copy())
        self.register_buffer("filters", filters, persistent=False)
        self.register_buffer("window", torch.from_numpy(hann_window()), persistent=False)

    def decades(self, waveform: Tensor) -> Tensor:
        """Logarithm to base 10 (B, M, F) of the mel power of (B, S); frame j is at sample 160 j."""
        n_frames = frames_of(waveform.shape[1])
        after = (n_frames - 1) * HOP + N_FFT // 2 - waveform.shape[1]
        padded = F.pad(waveform, (N_FFT // 2, max(after, 0)))
        pieces = padded.unfold(1, N_FFT, HOP)[:, :n_frames]  # (B, M, 400)
        spectra = torch.fft.rfft(pieces * self.window)
        power = torch.view_as_real(spectra).square().sum(dim=-1) @ self.filters
        return power.clamp(min=SILENCE).log10()

    def forward(self, waveform: Tensor, peak: float | None = None) -> Tensor:
        """Spectrogram (B, F, M) of (B, S).

        Parameters
        ----------
        waveform : Tensor [shape=(B, S)]
            16 kHz.
        peak : float or None
            `loudest` of the whole clip; None: each row is a whole clip.
        """
        decades = self.decades(waveform)
        if peak is None:
            decades = torch.maximum(decades, decades.amax(dim=(1, 2), keepdim=True) - DYNAMIC_RANGE)
        else:
            decades = decades.clamp(min=peak - DYNAMIC_RANGE)
        return ((decades + 4) / 4).transpose(1, 2)


def _gelu(x: Tensor) -> Tensor:
    """GELU, in the memory of its argument where no gradient needs it."""
    if torch.is_grad_enabled():
        return F.gelu(x)
    out: Tensor = torch.ops.aten.gelu_(x)
    return out


class Attention(nn.Module):
    """Self-attention of a `Layer`; every feature attends to all others of its piece."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.q_proj = nn.Linear(width, width)
        self.k_proj = nn.Linear(width, width, bias=False)
        self.v_proj = nn.Linear(width, width)
        self.out_proj = nn.Linear(width, width)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, K, D) to (B, K, D)."""
        q, k, v = (
            layer(x).unflatten(-1, (self.heads, -1)).transpose(1, 2)
            for layer in (self.q_proj, self.k_proj, self.v_proj)
        )
        mixed = F.scaled_dot_product_attention(q, k, v)  # (B, heads, K, D / heads)
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

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, K, D) to (B, K, D)."""
        x = self.self_attn(self.self_attn_layer_norm(x)).add_(x)
        out: Tensor = self.fc2(_gelu(self.fc1(self.final_layer_norm(x)))).add_(x)
        return out


class WhisperEncoder(nn.Module):
    """Two convolutions, fixed positions and the first layers of the encoder.

    Parameters
    ----------
    config : WhisperConfig
    """

    def __init__(self, config: WhisperConfig) -> None:
        super().__init__()
        width = config.width
        self.conv1 = nn.Conv1d(config.n_mels, width, 3, padding=1)
        self.conv2 = nn.Conv1d(width, width, 3, stride=2, padding=1)
        self.embed_positions = nn.Embedding(config.positions, width)
        self.layers = nn.ModuleList(
            Layer(width, config.heads, config.intermediate) for _ in range(max(config.layers))
        )

    def forward(self, mel: Tensor) -> list[Tensor]:
        """States (B, K, D) before the layers and after each, of a spectrogram (B, F, M).

        Not normalised at the end, as ``transformers`` does after its last layer. Positions are
        counted from the first frame; there must be at most `WhisperConfig.positions`.
        """
        x = _gelu(self.conv1(mel))
        x = _gelu(self.conv2(x)).transpose(1, 2)
        states = [x + self.embed_positions.weight[: x.shape[1]]]
        for layer in self.layers:
            states.append(layer(states[-1]))
        return states


class WhisperFrontend(StridedFrontend):
    """States of some layers, standardised and mixed, with one row per rig frame.

    Feature k describes sample 320 k. A clip is encoded in pieces of ten seconds: Whisper's own
    padding to 30 s is left out, which changes these layers by a correlation of .99.

    Parameters
    ----------
    config : WhisperConfig
    """

    stride, centre, margin = 2 * HOP, 0.0, 2 * HOP
    chunk_seconds, overlap_seconds = 10.0, 1.0

    def __init__(self, config: WhisperConfig) -> None:
        super().__init__()
        self.config = config
        self.mel = LogMel(config.n_mels)
        self.encoder = WhisperEncoder(config)
        self.output_size = config.width
        self.mix_layers(config.layers, config.width)
        if config.learns == "nothing":
            self.encoder.requires_grad_(False)

    @classmethod
    def build(cls, config: WhisperConfig, *, pretrained: bool = True) -> "WhisperFrontend":
        """Make the frontend of a configuration.

        Parameters
        ----------
        config : WhisperConfig
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

    def survey(self, waveform: Tensor, gain: float) -> float:
        """Loudest mel power of the whole clip, from which the floor of every piece follows."""
        return loudest(waveform.cpu().numpy(), self.config.n_mels) + 2 * math.log10(gain)

    def features(self, waveform: Tensor, context: float | None = None) -> Tensor:
        """Features (B, K, D) at 50 Hz of (B, S), at most 30 s."""
        states = self.encoder(self.mel(waveform, context))
        return self.mixed([state.flatten(0, 1) for state in states]).view_as(states[0])

    @torch.no_grad()
    def encode_together(self, waveforms: Sequence[Tensor], n_frames: int) -> Tensor:
        """Rows (B, n_frames, D) of clips (S,) of one piece, as `encode` of each, to rounding.

        Those with equally many features are one batch.
        """
        sizes = [frames_of(len(waveform)) * HOP for waveform in waveforms]
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
