"""Three ways from waveform to speech features at 30 Hz, behind one interface."""

from collections.abc import Callable
from typing import Protocol

from torch import Tensor

from deitalk.config import ConformerConfig, MelConfig, Wav2VecConfig


class Frontend(Protocol):
    """A module that describes speech, one row per rig frame."""

    output_size: int

    def __call__(self, waveform: Tensor, n_frames: int) -> Tensor:
        """Map (B, S) at 16 kHz to (B, n_frames, output_size); row i is time i / 30 s."""

    def encode(
        self, waveform: Tensor, n_frames: int, *, progress: Callable[[float], None] = ...
    ) -> Tensor:
        """Map a whole clip (S,) to (n_frames, output_size) in bounded memory, no gradient.

        `progress` is told the share that is done, 0 to 1.
        """


def build_frontend(
    config: MelConfig | Wav2VecConfig | ConformerConfig, pretrained: bool = True
) -> Frontend:
    """Make the frontend a configuration names.

    Parameters
    ----------
    config : MelConfig, Wav2VecConfig or ConformerConfig
        Its class chooses the frontend.
    pretrained : bool
        Read a wav2vec 2.0 checkpoint's weights; False only takes its shape (weights follow).
    """
    if isinstance(config, MelConfig):
        from deitalk.frontends.mel_bilstm import MelFrontend

        return MelFrontend(config)
    if isinstance(config, ConformerConfig):
        from deitalk.frontends.conformer import ConformerFrontend

        return ConformerFrontend(config)
    from deitalk.frontends.wav2vec import Wav2VecFrontend

    return Wav2VecFrontend.build(config, pretrained=pretrained)
