"""Waveform to speech features: the encoder of each configuration.

`Frontend` gives one row per frame at 30 Hz, for DEITalk; `deitalk.frontends.windows.Encoder` gives
rows at any moments, for SDFA and its comparison models.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from torch import Tensor

from deitalk.config import (
    CausalWhisperConfig,
    KarrasConfig,
    MelConfig,
    SDFAMelConfig,
    VocaConfig,
    Wav2VecConfig,
    WhisperConfig,
)
from deitalk.installed import research

if TYPE_CHECKING:
    from deitalk.frontends.windows import Encoder


class Frontend(Protocol):
    """A speech encoder of one row per frame at 30 Hz."""

    output_size: int

    def __call__(self, waveform: Tensor, n_frames: int) -> Tensor:
        """Map (B, S) at 16 kHz to (B, n_frames, output_size); row i is time i / 30 s."""

    def encode(
        self, waveform: Tensor, n_frames: int, *, progress: Callable[[float], None] = ...
    ) -> Tensor:
        """Map a whole clip (S,) to (n_frames, output_size) in bounded memory, no gradient.

        `progress` is called with the share done, 0 to 1.
        """


def build_frontend(
    config: MelConfig | CausalWhisperConfig | Wav2VecConfig | WhisperConfig, pretrained: bool = True
) -> Frontend:
    """Build the 30 Hz encoder of a configuration.

    Parameters
    ----------
    config : MelConfig, CausalWhisperConfig, Wav2VecConfig or WhisperConfig
        Its class chooses the frontend.
    pretrained : bool
        Read the weights of a checkpoint; False reads its sizes only.
    """
    if isinstance(config, MelConfig):
        from deitalk.frontends.mel_bilstm import MelFrontend

        return MelFrontend(config)
    if isinstance(config, CausalWhisperConfig):
        from deitalk.frontends.causal_whisper import CausalWhisperFrontend

        return CausalWhisperFrontend.build(config, pretrained=pretrained)
    if isinstance(config, WhisperConfig):
        from deitalk.frontends.whisper import WhisperFrontend

        return WhisperFrontend.build(config, pretrained=pretrained)
    from deitalk.frontends.wav2vec import Wav2VecFrontend

    return Wav2VecFrontend.build(config, pretrained=pretrained)


def build_encoder(config: SDFAMelConfig | KarrasConfig | VocaConfig) -> "Encoder":
    """Build the encoder of a mesh model, by the class of its configuration."""
    if isinstance(config, SDFAMelConfig):
        from deitalk.frontends.sdfa import SDFAEncoder

        return SDFAEncoder(config)
    if isinstance(config, KarrasConfig):
        karras: Encoder = research("comparison.karras", "frontend karras").KarrasEncoder(config)
        return karras
    voca: Encoder = research("comparison.voca", "frontend voca").VocaEncoder(config)
    return voca
