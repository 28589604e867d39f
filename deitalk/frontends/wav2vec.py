"""wav2vec 2.0 speech features, 50 Hz brought to the rig's 30 Hz (DEITalk §3.2, §4.1).

Deviation: its kin of the same interface too, see `ENCODERS`.

K features at 50 Hz.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from torch import Tensor, nn

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.config.frontends import Wav2VecConfig
from deitalk.config.hub import hub_metadata
from deitalk.config.section import check_encoder
from deitalk.errors import CheckpointError, ConfigError
from deitalk.frontends.strided import StridedFrontend
from rig.errors import quoted

if TYPE_CHECKING:
    from transformers import PretrainedConfig, PreTrainedModel

PUBLISHED = "facebook/wav2vec2-base-960h"
"""The encoder of the paper; transformers' defaults are its shape."""

ENCODERS = {
    "wav2vec2": "Wav2Vec2",
    "hubert": "Hubert",
    "wavlm": "WavLM",
    "data2vec-audio": "Data2VecAudio",
}
"""Encoders by their ``model_type``: beginnings of the names of transformers' classes."""

COMPACT: Mapping[str, Any] = {
    "conv_dim": (256,) * 7,
    "feat_extract_norm": "layer",
    "conv_bias": True,
    "hidden_size": 256,
    "num_hidden_layers": 6,
    "num_attention_heads": 4,
    "intermediate_size": 1024,
    "num_conv_pos_embeddings": 64,
    "num_conv_pos_embedding_groups": 8,
    "do_stable_layer_norm": True,
}
"""A small encoder to train from scratch. Its norms act on one moment at a time, unlike the group
norm of the published base model, so that a chunk's features do not depend on where it ends."""

_ABOUT = ("_name_or_path", "architectures", "dtype", "torch_dtype", "transformers_version")
"""Keys of a checkpoint's configuration that are no shape."""

SPEECH_SCALE = 10 ** (23 / 20)
"""Scales speech at -23 dBFS to unit variance, as the published models expect (``do_normalize``).

Deviation: they divide by the deviation of the whole input, pauses included. The level of the speech
is known here, so that one factor serves windows of a training and whole clips alike."""


class Wav2VecFrontend(StridedFrontend):
    """A wav2vec 2.0 encoder, or one of its kin, with one row per rig frame.

    Feature k describes the samples 320 k … 320 k + 399, so its centre is 320 k + 199.5.

    Parameters
    ----------
    encoder : transformers.PreTrainedModel
        One of `ENCODERS`.
    freeze_stem : bool
        Keep the convolutional stem fixed: "the TCN parameters in Wav2Vec2.0 are fixed" (§4.1).
    input_scale : float
        Factor on the waveform.
    layers : sequence of int
        Layers whose states are mixed; none: the output.
    learns : bool
        Whether the encoder is trained, but for a fixed stem.

    Raises
    ------
    ConfigError
        If the encoder has not so many layers.
    """

    def __init__(
        self,
        encoder: nn.Module,
        *,
        freeze_stem: bool = True,
        input_scale: float = SPEECH_SCALE,
        layers: Sequence[int] = (),
        learns: bool = True,
    ) -> None:
        super().__init__()
        self.encoder = encoder
        self.input_scale = input_scale
        config: Any = encoder.config
        self.output_size: int = config.hidden_size
        # Samples under one feature, samples between features: (400, 320) for the base model.
        field, jump = 1, 1
        for kernel, stride in zip(config.conv_kernel, config.conv_stride, strict=True):
            field += (kernel - 1) * jump
            jump *= stride
        self.margin, self.stride = field, jump
        self.centre = (self.margin - 1) / 2
        if freeze_stem:
            stem: Any = encoder.feature_extractor
            stem._freeze_parameters()
        if hasattr(encoder, "masked_spec_embed"):  # never used: apply_spec_augment is off
            encoder.masked_spec_embed.requires_grad_(False)
        if layers:
            if max(layers) > config.num_hidden_layers:
                raise ConfigError(
                    f"layers={list(layers)}: the encoder has {config.num_hidden_layers}; name those"
                )
            self.mix_layers(layers, config.hidden_size)
        self.learns = learns
        if not learns:
            encoder.requires_grad_(False)

    def train(self, mode: bool = True) -> Self:
        """Set the mode; an encoder that does not learn stays in evaluation."""
        super().train(mode)
        if not self.learns:
            self.encoder.eval()
        return self

    @classmethod
    def build(cls, config: Wav2VecConfig, *, pretrained: bool = True) -> Self:
        """Make the frontend of a configuration.

        Parameters
        ----------
        config : Wav2VecConfig
            With a checkpoint its weights are read; without one, `COMPACT` with the changes in
            ``config.encoder`` is made anew. Deviation: such a stem is never frozen, for a fixed
            random stem carries little information.
        pretrained : bool
            False takes the checkpoint's shape alone, because the weights follow. The shape is
            ``config.encoder`` if given; that of the published base model needs no download.
        """
        mixing: dict[str, Any] = {
            "layers": config.layers,
            "learns": config.learns == "everything",
        }
        if config.checkpoint is None:
            return cls.from_config(config.encoder, **mixing)
        if pretrained:
            return cls.from_pretrained(config.checkpoint, freeze_stem=config.freeze_stem, **mixing)
        shape: Mapping[str, Any]
        if config.encoder or config.checkpoint == PUBLISHED:
            shape, scale = config.encoder, SPEECH_SCALE if config.normalise else 1.0
        else:
            with _one_line_errors(config.checkpoint):
                shape, scale = _read_config(config.checkpoint)
        encoder = _new_encoder(shape)
        return cls(encoder, freeze_stem=config.freeze_stem, input_scale=scale, **mixing)

    @classmethod
    def from_pretrained(cls, name: str, *, freeze_stem: bool = True, **mixing: Any) -> Self:
        """Read a published or local checkpoint; safetensors only, never a pickle.

        Parameters
        ----------
        name : str
            Name on the Hugging Face hub (taken from the cache where it is there), or a folder
            with ``config.json`` and ``model.safetensors``.
        freeze_stem : bool
            As in the constructor.
        mixing
            `layers` and `learns`, as there.

        Raises
        ------
        CheckpointError
            Not there, not reachable, none of `ENCODERS`, without safetensors, or incomplete.
        """
        with _one_line_errors(name), _quiet_transformers():
            shape, scale = _read_config(name)
            encoder, report = _cached_or_fetched(
                _class(shape, "Model").from_pretrained,
                name,
                config=_encoder_config(shape),
                use_safetensors=True,
                output_loading_info=True,
            )
        missing = set(report["missing_keys"]) - {"masked_spec_embed"}
        if missing:
            raise CheckpointError(
                f"{name} lacks {len(missing)} weights of its encoder, such as {min(missing)}; "
                f"give a complete checkpoint, such as {PUBLISHED}"
            )
        return cls(encoder.float(), freeze_stem=freeze_stem, input_scale=scale, **mixing)

    @classmethod
    def from_config(
        cls, changes: Mapping[str, Any], *, freeze_stem: bool = False, **mixing: Any
    ) -> Self:
        """A new encoder with random weights: `COMPACT` with `changes`.

        Parameters
        ----------
        changes : mapping
            Keys of transformers' configuration.
        freeze_stem : bool
            Deviation: off, for a fixed random stem carries little information.
        mixing
            `layers` and `learns`, as in the constructor.
        """
        encoder = _new_encoder({**COMPACT, **changes})
        return cls(encoder, freeze_stem=freeze_stem, **mixing)

    def described(self, config: Wav2VecConfig) -> Wav2VecConfig:
        """Configuration that builds the encoder where its checkpoint is no longer there."""
        if config.checkpoint is None:
            return config
        encoder: Any = self.encoder.config
        values = json.loads(encoder.to_json_string(use_diff=True))
        shape = {key: value for key, value in values.items() if key not in _ABOUT}
        normalise = self.input_scale == SPEECH_SCALE
        return config.model_copy(update={"encoder": shape, "normalise": normalise})

    def features(self, waveform: Tensor, context: None = None) -> Tensor:
        """Features (B, K, D) at 50 Hz of (B, S); what is too short for one is padded with zeros."""
        lacking = max(0, self.margin - waveform.shape[-1])
        padded = nn.functional.pad(waveform * self.input_scale, (0, lacking))
        found = self.encoder(padded, output_hidden_states=bool(self.layers))
        output: Tensor = found.last_hidden_state
        if not self.layers:
            return output
        return self.mixed([state.flatten(0, 1) for state in found.hidden_states]).view_as(output)


def _class(shape: Mapping[str, Any], part: str) -> Any:
    """Transformers' class of the ``model_type`` of a shape: its ``Config`` or its ``Model``."""
    import transformers

    kind = shape.get("model_type", "wav2vec2")
    if kind not in ENCODERS:
        raise ConfigError(f"model_type {quoted(kind)}: it must be {', '.join(ENCODERS)}")
    return getattr(transformers, ENCODERS[kind] + part)


def _encoder_config(shape: Mapping[str, Any]) -> "PretrainedConfig":
    """A checked configuration; SpecAugment, layer drop and adapter are off (Paper silent)."""
    kind = _class(shape, "Config")
    known = kind().to_dict()
    for key in shape:
        if key not in known:
            raise ConfigError(
                f"encoder key {key!r} is none of transformers' {kind.__name__}; it has "
                "hidden_size, num_hidden_layers, num_attention_heads, conv_dim"
            )
    try:
        check_encoder(shape)
    except ValueError as error:
        raise ConfigError(f"the encoder's shape is impossible: {error}; mend it") from None
    off = {"apply_spec_augment": False, "layerdrop": 0.0, "add_adapter": False}
    fixed = {key: value for key, value in off.items() if key in known}
    try:
        config: PretrainedConfig = kind(**{**shape, **fixed})
        return config
    except Exception as error:  # its validation raises classes of huggingface_hub's own
        reason = " ".join(str(error).split())
        raise ConfigError(f"the encoder's shape is impossible: {reason}; mend it") from error


def _new_encoder(shape: Mapping[str, Any]) -> nn.Module:
    config = _encoder_config(shape)
    try:
        encoder: PreTrainedModel = _class(shape, "Model")(config)
        return encoder
    except (ValueError, TypeError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"the encoder's shape is impossible: {reason}; mend it") from error


def _read_config(name: str) -> tuple[dict[str, Any], float]:
    """A checkpoint's shape, and its input scale."""
    from transformers import PretrainedConfig, Wav2Vec2FeatureExtractor

    values, _ = _cached_or_fetched(PretrainedConfig.get_config_dict, name)
    if values.get("model_type") not in ENCODERS:
        raise CheckpointError(
            f"{name} is a {values.get('model_type')!r} model; it must be "
            f"{', '.join(ENCODERS)}, such as {PUBLISHED}"
        )
    known = _class(values, "Config")().to_dict()
    try:
        extractor, _ = _cached_or_fetched(Wav2Vec2FeatureExtractor.get_feature_extractor_dict, name)
    except OSError:
        extractor = {}  # a folder of weights alone: the extractor's defaults
    if extractor.get("sampling_rate", SAMPLE_RATE) != SAMPLE_RATE:
        raise CheckpointError(
            f"{name} is for {extractor['sampling_rate']} Hz; it must be {SAMPLE_RATE} Hz: "
            f"use {PUBLISHED}"
        )
    shape = {key: value for key, value in values.items() if key in known}
    return shape, SPEECH_SCALE if extractor.get("do_normalize", True) else 1.0


def _cached_or_fetched(read: Any, name: str, **options: Any) -> Any:
    """Result of `read` in the folder or the cache, else on the hub."""
    try:
        return read(name, local_files_only=True, **options)
    except OSError:
        # Without an answer of the hub transformers would try for a long time.
        if Path(name).exists() or hub_metadata(name) is None:
            raise
        return read(name, **options)


@contextmanager
def _one_line_errors(name: str) -> Iterator[None]:
    """Turn the many ways a checkpoint cannot be read into one CheckpointError."""
    try:
        yield
    except (CheckpointError, ConfigError):
        raise
    except OSError as error:
        raise CheckpointError(
            f"cannot find a speech encoder with model.safetensors as {name!r}, neither as "
            "a folder, nor in the cache, nor on the hub; check the name, go online once with "
            f"`hf download {PUBLISHED}`, or use a model with the mel frontend"
        ) from error
    except Exception as error:  # safetensors, torch and huggingface_hub each raise their own
        reason = " ".join(str(error).split())[:200]
        raise CheckpointError(
            f"{name} cannot be read as a speech encoder ({reason}); fetch or save it again"
        ) from error


@contextmanager
def _quiet_transformers() -> Iterator[None]:
    """Without its report on the heads we leave out and without its bar."""
    import transformers

    logging: Any = transformers.utils.logging
    level, bars = logging.get_verbosity(), logging.is_progress_bar_enabled()
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    try:
        yield
    finally:
        logging.set_verbosity(level)
        if bars:
            logging.enable_progress_bar()
