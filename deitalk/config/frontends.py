"""Settings of the speech frontends, one class each."""

from typing import Annotated, Any, Literal

from pydantic import (
    Field,
    ValidationInfo,
    field_validator,
)

from deitalk.config.section import (
    Dropout,
    MelBins,
    Odd,
    Recurrent,
    Section,
    SpectraRate,
    SpectrumSeconds,
    Tapers,
    Width,
    Window,
    check_encoder,
)
from rig import limits


class MelConfig(Section):
    """Mel spectrogram, Spec-BiLSTM, Time-BiLSTM and temporal attention (SDFA §3.1-3.3, §4.4)."""

    kind: Literal["mel"] = "mel"
    window_seconds: SpectrumSeconds = 0.064
    """Length of one spectrum (FFT_win)."""
    frame_rate: SpectraRate = 125.0
    """Spectra per second; 1 / FFT_hop."""
    tapers: Tapers = 1
    n_mels: MelBins = 128
    """Mel bins (F)."""
    conv_channels: tuple[Width, Width, Width] = (32, 64, 64)
    spec_hidden: Width = 32
    """Spec-BiLSTM units per direction."""
    spectral_size: Width = 256
    """Features of one spectrum (C_spec)."""
    time_stack: Window = 1
    """Spectra joined before the Time-BiLSTM."""
    time_hidden: Width = 256
    """Time-BiLSTM units per direction."""
    time_layers: Recurrent = 2
    window_frames: Window = 64
    """Spectra of the attention (L)."""
    query_frames: Odd = 7
    """K_qry; Paper silent."""
    attention_size: Width = 128
    """C_att; Paper silent."""
    recurrence: Literal["window", "segment"] = "window"
    """Time-BiLSTM once per window (the paper) or along the clip."""
    weight_norm: bool = True
    """Weight normalisation on every weight (§4.4)."""
    centre: bool = False
    """Add the window's own centre to what it attends to, and normalise."""
    rig_layers: int = Field(default=0, ge=0, le=limits.RECURRENT_LAYERS)
    """BiLSTMs along rig frames behind the attention; not in SDFA."""
    dropout: Dropout = 0.0

    @field_validator("recurrence")
    @classmethod
    def _stack_fits(cls, value: str, info: ValidationInfo) -> str:
        if value == "window" and info.data.get("time_stack", 1) > 1:
            raise ValueError("'window' takes no time_stack; use recurrence: segment")
        return value

    @field_validator("query_frames")
    @classmethod
    def _query_fits(cls, value: int, info: ValidationInfo) -> int:
        if value > info.data.get("window_frames", value):
            raise ValueError("must not be longer than window_frames")
        return value


class Wav2VecConfig(Section):
    """wav2vec 2.0 (DEITalk §3.2) or its kin: a published checkpoint or an encoder of a given shape.

    Deviation: also HuBERT, WavLM and data2vec-audio, by the ``model_type`` of the checkpoint.
    """

    kind: Literal["wav2vec"] = "wav2vec"
    checkpoint: str | None = "facebook/wav2vec2-base-960h"
    """Hub name or folder; null builds `encoder`."""
    encoder: dict[str, Any] = Field(default_factory=dict)
    """Keys of transformers' configuration, of the model_type among them; a saved model has those of
    its checkpoint."""
    normalise: bool = True
    """Speech to unit variance, as published models expect; with `encoder`."""
    freeze_stem: bool = True
    """Keep the convolutional stem fixed (§4.1)."""
    layers: tuple[Annotated[int, Field(ge=0, le=limits.LAYERS)], ...] = Field(
        default=(), max_length=limits.LAYERS
    )
    """Layers whose states are mixed, 0 is the input of the first; none: the output."""
    learns: Literal["nothing", "everything"] = "everything"
    """What of the encoder is trained, but for a fixed stem."""

    @field_validator("encoder")
    @classmethod
    def _shape_fits(cls, value: dict[str, Any]) -> dict[str, Any]:
        check_encoder(value)
        return value


class WhisperShape(Section):
    """Shape of the first layers of Whisper's encoder; the numbers are those of Whisper base."""

    checkpoint: str | None = "openai/whisper-base"
    """Hub name or folder, read before training; null: random weights."""
    n_mels: MelBins = 80
    """Mel bins (F)."""
    width: Width = 512
    heads: Width = 8
    intermediate: Width = 2048
    """Width within a layer."""
    rate: Literal[30, 50] = 30
    """Features a second: the rig's own, or 50 as the encoder had them."""
    layers: tuple[Annotated[int, Field(ge=0, le=limits.LAYERS)], ...] = Field(
        default=(2, 3), min_length=1, max_length=limits.LAYERS
    )
    """Layers whose states are mixed; 0 is the input of the first."""
    learns: Literal["nothing", "everything"] = "nothing"
    """What of the encoder is trained."""

    @field_validator("heads")
    @classmethod
    def _heads_divide(cls, value: int, info: ValidationInfo) -> int:
        if info.data.get("width", value) % value:
            raise ValueError("width must be a multiple of heads")
        return value


class WhisperConfig(WhisperShape):
    """The first layers of Whisper's encoder, on a whole clip."""

    kind: Literal["whisper"] = "whisper"


class CausalWhisperConfig(WhisperShape):
    """Whisper's first layers on the past and a bounded look-ahead, for live voices."""

    kind: Literal["causal_whisper"] = "causal_whisper"
    ahead: int | None = Field(default=None, ge=1, le=limits.LAYERS)
    """First layers that attend to one frame after their own; null: all."""
    rules_ahead: int = Field(default=2, ge=0, le=2)
    """Frames after a frame that its contacts see in a voice that has not ended."""
    lead: int = Field(default=0, ge=0, le=1)
    """Spectra of a feature that lie before its frame, of three: 11 ms less of look-ahead."""

    @field_validator("rate")
    @classmethod
    def _rig_frames(cls, value: int) -> int:
        if value != 30:
            raise ValueError("must be 30: a feature is a rig frame")
        return value

    @field_validator("layers")
    @classmethod
    def _last_layers(cls, value: tuple[int, ...]) -> tuple[int, ...]:
        if value not in ((max(value) - 1, max(value)), (max(value),)) or max(value) < 1:
            raise ValueError("must be one layer, or one and the next, such as [2, 3]")
        return value


class SDFAMelConfig(MelConfig):
    """SDFA's encoder (SDFA §3.2-3.3)."""

    @property
    def encoder(self) -> str:
        """Module and class of the encoder."""
        return "deitalk.frontends.sdfa_encoder:SDFAEncoder"

    @field_validator("time_stack")
    @classmethod
    def _every_spectrum(cls, value: int) -> int:
        if value != 1:
            raise ValueError("SDFA uses every spectrum; leave it at 1")
        return value

    @field_validator("rig_layers")
    @classmethod
    def _no_rig(cls, value: int) -> int:
        if value != 0:
            raise ValueError("SDFA has no BiLSTM along rig frames; leave it at 0")
        return value


class DEITalkFeaturesConfig(Section):
    """Features of speech and emotion of a trained DEITalk model, whose weights are frozen."""

    kind: Literal["deitalk"] = "deitalk"
    model: str = "mel"
    """Name or folder of the DEITalk model."""
