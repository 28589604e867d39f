"""Waveform to speech features: the encoder that a configuration's ``kind`` names.

A `Frontend` gives one row per frame at 30 Hz, for DEITalk; an `Encoder` gives rows at any moments,
for SDFA and its comparison models.
"""

from deitalk.config.frontends import (
    CausalWhisperConfig,
    MelConfig,
    SDFAMelConfig,
    Wav2VecConfig,
    WhisperConfig,
)
from deitalk.frontends.base import Encoder, Frontend
from deitalk.installed import imported

FRONTENDS = {
    "mel": "mel_bilstm:MelFrontend",
    "wav2vec": "wav2vec:Wav2VecFrontend",
    "whisper": "whisper:WhisperFrontend",
    "causal_whisper": "causal_whisper:CausalWhisperFrontend",
}
"""Module and class of each kind; a module is imported when its frontend is built."""


def build_frontend(
    config: MelConfig | CausalWhisperConfig | Wav2VecConfig | WhisperConfig, pretrained: bool = True
) -> Frontend:
    """Build the 30 Hz encoder of a configuration.

    Parameters
    ----------
    config : MelConfig, CausalWhisperConfig, Wav2VecConfig or WhisperConfig
        Its kind chooses the frontend.
    pretrained : bool
        Read the weights of a checkpoint; False reads its sizes only.
    """
    kind = imported(f"deitalk.frontends.{FRONTENDS[config.kind]}")
    frontend: Frontend = kind.build(config, pretrained=pretrained)
    return frontend


def build_encoder(config: SDFAMelConfig) -> Encoder:
    """Build the encoder of a mesh model."""
    encoder: Encoder = imported(config.encoder)(config)
    return encoder
