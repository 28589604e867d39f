"""The first layers of Whisper's speech encoder, read at the rig's 30 Hz.

DEITalk §3.2 takes wav2vec 2.0. Deviation: Whisper (Radford et al., "Robust Speech Recognition via
Large-Scale Weak Supervision", 2022; MIT), whose training data have more voices, rooms and languages
than any here; scores are in MODEL_CARD.md.

Deviation: the published encoder gives 50 features a second, of two spectra each. Here a feature is
a rig frame: of three spectra, 90 a second. Nothing is resampled, and attention and linear maps cost
three fifths. The weights are those of the published encoder, tuned to this rate and to noise;
``rate: 50`` is the published encoder itself.

The encoder is written anew because importing ``transformers`` takes three times as long as torch;
the names and numbers of its weights are those of ``transformers``' ``WhisperEncoder``.

B batch, S samples, M mel frames, K features, D width.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
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
)
from deitalk.config.frontends import WhisperShape
from deitalk.errors import CheckpointError
from deitalk.frontends.strided import Piece, StridedFrontend
from rig.arrays import Float32, Int64

BATCH = 128
"""Pieces that are encoded in one pass."""
SURVEYED = 5400
"""Most spectra of a piece that is surveyed, a minute: they begin at whole samples."""
TOGETHER_SAMPLES = 1 << 21
"""Samples that are surveyed at once."""
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
        """Logarithm to base 10 (B, M, F) of the mel power of windows (B, M, 400).

        In float32 also where the network computes in another precision.
        """
        with torch.autocast("cuda" if windows.is_cuda else "cpu", enabled=False):
            spectra = torch.fft.rfft(windows * self.window)
            power = torch.view_as_real(spectra).square().sum(dim=-1) @ self.filters
            return power.clamp(min=SILENCE).log10()

    def forward(self, waveform: Tensor, n_frames: int, peak: Tensor | None = None) -> Tensor:
        """Spectrogram (B, F, M) of (B, S).

        Parameters
        ----------
        waveform : Tensor [shape=(B, S)]
            16 kHz.
        n_frames : int
            M; frame j is at j / rate s.
        peak : Tensor or None
            `survey` of the whole clip; None: each row is a whole clip.
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
        q, k, v = (self.by_heads(f(x)) for f in (self.q_proj, self.k_proj, self.v_proj))
        mixed = F.scaled_dot_product_attention(q, k, v, mask)  # (B, heads, K, D / heads)
        out: Tensor = self.out_proj(mixed.transpose(1, 2).flatten(2))
        return out

    def by_heads(self, rows: Tensor) -> Tensor:
        """Rows (B, K, D) as (B, heads, K, D / heads)."""
        split: Tensor = rows.unflatten(-1, (self.heads, -1))  # type: ignore[no-untyped-call]
        return split.transpose(1, 2)


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

    def joined(self, rows: Tensor, places: Tensor, width: int, mask: Tensor | None) -> Tensor:
        """Map rows (K, D) of pieces that attend to themselves alone.

        `places` (K,) are theirs among pieces of `width` rows, of which `mask` (N, 1, 1, W) says
        which there are.
        """
        attention, x = self.self_attn, self.self_attn_layer_norm(rows)
        given = torch.cat([f(x) for f in (attention.q_proj, attention.k_proj, attention.v_proj)], 1)
        if mask is not None:
            count = len(mask) * width
            given = given.new_zeros(count, given.shape[1]).index_copy_(0, places, given)
        heads = given.view(-1, width, 3, attention.heads, rows.shape[1] // attention.heads)
        q, k, v = heads.permute(2, 0, 3, 1, 4)
        mixed = F.scaled_dot_product_attention(q, k, v, mask).transpose(1, 2).flatten(2)
        return self.after(attention.out_proj(mixed.flatten(0, 1)[places]).add_(rows))

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
        mask : Tensor [shape=(K, K), (B, 1, K, K) or (B, 1, 1, K), dtype=bool] or None
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

    def survey(self, waveform: Tensor, gain: float) -> Tensor:
        """Loudest mel power of the whole clip, from which the floor of every piece follows."""
        return self.surveys([waveform.cpu().numpy()])[0] + 2 * math.log10(gain)

    def surveys(self, sounds: Sequence[Float32]) -> Tensor:
        """Logarithm to base 10 (N,) of the loudest mel power of each of N clips (S,)."""
        pieces: list[tuple[int, int, int]] = []  # spectra, clip, first sample
        for clip, sound in enumerate(sounds):
            n_frames = self.count(len(sound)) * self.spectra
            for first in range(0, n_frames, SURVEYED):
                begin = int(centres(first, 1, self.mel.rate)[0]) - N_FFT // 2
                pieces.append((min(SURVEYED, n_frames - first), clip, begin))
        pieces.sort(reverse=True)
        found = self.mel.window.new_full((len(sounds),), math.log10(SILENCE))
        while pieces:
            starts = centres(0, pieces[0][0], self.mel.rate)
            length = int(starts[-1]) + N_FFT
            taken = max(TOGETHER_SAMPLES // length, 1)
            group, pieces = pieces[:taken], pieces[taken:]
            counts, owners, _ = torch.tensor(group).T
            padded = np.zeros((len(group), length), np.float32)
            for row, (_, clip, begin) in zip(padded, group, strict=True):
                piece = sounds[clip][max(begin, 0) : begin + length]
                row[max(-begin, 0) :][: len(piece)] = piece
            places = torch.from_numpy(starts).to(found.device)
            windows = torch.from_numpy(padded).to(found.device).unfold(1, N_FFT, 1)[:, places]
            own = (torch.arange(len(starts)) < counts[:, None]).to(found.device)
            power = self.mel.decades(windows).amax(dim=2).where(own, math.log10(SILENCE))
            found.scatter_reduce_(0, owners.to(found.device), power.amax(dim=1), "amax")
        return found

    def features(self, waveform: Tensor, context: Tensor | None = None) -> Tensor:
        """Features (B, K, D) of (B, S), at most 30 s."""
        return self._features(self._log_mel(waveform, context))

    def _log_mel(self, waveform: Tensor, context: Tensor | None) -> Tensor:
        out: Tensor = self.mel(waveform, self.count(waveform.shape[1]) * self.spectra, context)
        return out

    def _features(self, mel: Tensor, mask: Tensor | None = None) -> Tensor:
        states: list[Tensor] = self.encoder(mel, mask)
        return self.mixed([state.flatten(0, 1) for state in states]).view_as(states[0])

    @torch.no_grad()
    def encode_together(self, waveforms: Sequence[Tensor], counts: Sequence[int]) -> list[Tensor]:
        """Rows (T, D) of clips (S,), as `encode` of each, to rounding.

        Pieces of all clips are encoded in batches of `BATCH`.
        """
        chunk, overlap = (
            round(seconds * FRAME_RATE) for seconds in (self.chunk_seconds, self.overlap_seconds)
        )
        pieces: list[tuple[Piece, Float32]] = []
        owners: list[int] = []
        sounds = [waveform.cpu().numpy() for waveform in waveforms]
        for clip, (samples, count) in enumerate(zip(sounds, counts, strict=True)):
            cut = self._pieces_of(count, chunk, overlap)
            pieces += [(piece, samples[piece.first : piece.last]) for piece in cut]
            owners += [clip] * (len(pieces) - len(owners))
        # The floor of a piece follows from its whole clip; NaN: the piece is that.
        peaks = self.mel.window.new_full((len(sounds),), math.nan)
        if cut_ones := [clip for clip, count in enumerate(counts) if count > chunk]:
            peaks[cut_ones] = self.surveys([sounds[clip] for clip in cut_ones])
        peaks = peaks[owners]
        order = sorted(range(len(pieces)), key=lambda place: -len(pieces[place][1]))
        sizes = np.array([self.count(len(sound)) for _, sound in pieces])
        begins, found = np.zeros_like(sizes), list[Tensor]()
        begins[order] = np.cumsum(sizes[order]) - sizes[order]
        for first in range(0, len(order), BATCH):
            batch = order[first : first + BATCH]
            _, parts = zip(*(pieces[place] for place in batch), strict=True)
            found.append(self._encoded(parts, peaks[batch], sizes[batch]))
        rows = self._laid([piece for piece, _ in pieces], begins, sizes, torch.cat(found))
        return list(torch.split(rows, list(counts)))

    def _encoded(self, sounds: Sequence[Float32], peaks: Tensor, sizes: Int64) -> Tensor:
        """Features (K, D) of sounds (S,), one after the other; attention alone is padded.

        Peaks are those of their recordings; NaN of those that are whole.
        """
        encoder, device = self.encoder, self.mel.window.device
        width = int(sizes.max())
        padded = np.zeros((len(sounds), max(map(len, sounds))), np.float32)
        for row, samples in zip(padded, sounds, strict=True):
            row[: len(samples)] = samples
        sound = torch.from_numpy(padded).to(device)
        inside = (
            torch.arange(width * self.spectra) < torch.from_numpy(sizes)[:, None] * self.spectra
        )
        is_sound = inside[..., None].to(device)
        decades = self.mel.decades(self.mel.windows(sound, width * self.spectra))
        known = peaks[:, None, None]
        own = torch.where(is_sound, decades, math.log10(SILENCE)).amax(dim=(1, 2), keepdim=True)
        peak = torch.where(known.isnan(), own, known)
        # Zeros after the end are what the first convolution reads there; the second reads nothing
        # there.
        mel = scaled(decades, peak) * is_sound.transpose(1, 2)  # (N, F, M)
        x = _gelu(encoder.conv2(_gelu(encoder.conv1(mel)))).transpose(1, 2)  # (N, W, D)
        inside = inside[:, :: self.spectra]
        places = inside.flatten().nonzero().flatten().to(device)  # (K,)
        mask = None if bool(inside.all()) else inside[:, None, None].to(device)
        states = [(x + encoder.positions[:width]).flatten(0, 1)[places]]
        for layer in encoder.layers:
            states.append(layer.joined(states[-1], places, width, mask))  # type: ignore[operator]
        return self.mixed(states)

    def _laid(
        self, pieces: Sequence[Piece], begins: Int64, sizes: Int64, features: Tensor
    ) -> Tensor:
        """Rows (T, D) of all clips from features (K, D) of their pieces, as `_add` lays them."""
        between, laid, count = list[Any](), list[Any]([np.zeros((3, 0))]), 0
        for (start, done, stop, sample, _), begin, size in zip(pieces, begins, sizes, strict=True):
            below, above, part = self._places(start, stop, sample, int(size))
            between.append(np.stack((below + begin, above + begin, part)))
            entries, both = np.arange(count, count + stop - start), done - start
            if both:  # (before, after, share of the latter)
                laid[-1][1, -both:] = entries[:both]
                laid[-1][2, -both:] = np.arange(1, both + 1) / (both + 1)
            laid.append(np.stack((entries, entries, np.zeros(len(entries))))[:, both:])
            count += len(entries)
        for lines in (between, laid):
            first, second, share = np.concatenate(lines, axis=1)
            if share.any():
                places = (torch.from_numpy(ends.astype(np.int64)) for ends in (first, second))
                weight = torch.from_numpy(share.astype(np.float32)).to(features.device)
                low, high = (features[place.to(features.device)] for place in places)
                features = torch.lerp(low, high, weight[:, None])
            else:
                features = features[torch.from_numpy(first.astype(np.int64)).to(features.device)]
        return features


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
