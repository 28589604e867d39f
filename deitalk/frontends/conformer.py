"""Conformer encoder over a mel spectrogram (not in the papers).

A mel spectrogram takes the place of wav2vec 2.0's convolutional stem, which needs thousands of
hours of audio to learn its filters; the blocks of its conformer variant (Gulati et al. 2020) take
the place of its transformer: their convolutions are local by construction.
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.mel import MelSpectrogram
from deitalk.config import ConformerConfig
from deitalk.errors import ConfigError
from deitalk.frontends.chunking import encode_in_segments, phase_shifts

SEGMENT_FRAMES = 64
"""Rig frames of a clip that are encoded at once."""
CONTEXT_FRAMES = 32
"""Rig frames of context on either side of a segment, computed and not kept. Segment and context are
as long as a training window, 128 frames."""
SPECTRA = 2
"""Spectra per rig frame, joined by the stem."""


class ConformerFrontend(nn.Module):
    """Waveform to speech features at 30 Hz.

    Spectra lie on the rig's own grid, so no row is interpolated.

    Parameters
    ----------
    config : ConformerConfig

    Attributes
    ----------
    output_size : int
        Width D of a row.

    Raises
    ------
    ConfigError
        If the width cannot be shared among the heads.
    """

    def __init__(self, config: ConformerConfig) -> None:
        super().__init__()
        self.output_size = config.hidden_size
        self.mel = MelSpectrogram(config.window_seconds, SPECTRA * FRAME_RATE, config.n_mels)
        self.shifts = phase_shifts(config.phases, SPECTRA * FRAME_RATE)
        self.stem = nn.Sequential(
            nn.Conv1d(3 * config.n_mels, config.stem_channels, 3, padding=1),
            nn.GELU(),
            nn.Conv1d(config.stem_channels, config.stem_channels, 5, stride=SPECTRA, padding=2),
            nn.GELU(),
        )
        self.project = nn.Sequential(
            nn.LayerNorm(config.stem_channels),
            nn.Linear(config.stem_channels, config.hidden_size),
            nn.Dropout(config.dropout),
        )
        self.encoder = _blocks(config)

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
    ) -> Tensor:
        """Map a whole clip (S,) to (n_frames, D), segment by segment: memory does not grow.

        `progress` is called with the share done, 0 to 1.
        """
        rows = waveform.new_empty(n_frames, self.output_size)
        return encode_in_segments(
            self._frames, waveform, rows, SEGMENT_FRAMES, CONTEXT_FRAMES, self.shifts, progress
        )

    def _frames(self, waveform: Tensor, first: int, last: int, shift: int = 0) -> Tensor:
        n_spectra = SPECTRA * (last - first)
        spectra = self.mel(waveform, n_spectra, SPECTRA * first, shift)  # (B, 3, F, L)
        stemmed = self.stem(spectra.flatten(1, 2)).transpose(1, 2)  # (B, T, stem_channels)
        out: Tensor = self.encoder(self.project(stemmed)).last_hidden_state
        return out


def _blocks(config: ConformerConfig) -> nn.Module:
    from transformers import Wav2Vec2ConformerConfig
    from transformers.models.wav2vec2_conformer.modeling_wav2vec2_conformer import (
        Wav2Vec2ConformerEncoder,
    )

    if config.hidden_size % (2 * config.heads):
        raise ConfigError(
            f"model.frontend.hidden_size={config.hidden_size} must be a multiple of twice "
            f"model.frontend.heads={config.heads} (positions turn pairs of numbers); change either"
        )
    settings: Any = Wav2Vec2ConformerConfig(
        hidden_size=config.hidden_size,
        num_hidden_layers=config.layers,
        num_attention_heads=config.heads,
        intermediate_size=config.intermediate_size,
        hidden_act="silu",
        position_embeddings_type="rotary",
        conv_depthwise_kernel_size=config.kernel_size,
        hidden_dropout=config.dropout,
        activation_dropout=0.0,
        attention_dropout=0.0,
        conformer_conv_dropout=0.0,
        layerdrop=0.0,
        attn_implementation="eager",  # type: ignore[call-arg]
    )
    encoder: Any = Wav2Vec2ConformerEncoder(settings)  # type: ignore[no-untyped-call]
    encoder.pos_conv_embed = nn.Identity()  # built by transformers, not used
    blocks: nn.Module = encoder
    return blocks
