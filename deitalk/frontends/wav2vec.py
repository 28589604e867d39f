"""wav2vec 2.0 speech features, 50 Hz brought to the rig's 30 Hz (DEITalk §3.2, §4.1).

K wav2vec features at 50 Hz.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Self

import torch
from torch import Tensor, nn

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.config import Wav2VecConfig
from deitalk.config.section import check_encoder
from deitalk.errors import CheckpointError, ConfigError

if TYPE_CHECKING:
    from transformers import Wav2Vec2Config

PUBLISHED = "facebook/wav2vec2-base-960h"
"""The encoder of the paper; transformers' defaults are its shape."""

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


class Wav2VecFrontend(nn.Module):
    """A wav2vec 2.0 encoder with one row per rig frame.

    Row i describes the time i/30 s. Feature k of the encoder describes the samples
    320 k … 320 k + 399, so its centre is (320 k + 199.5) / 16000 s, and row i is interpolated
    linearly between the two features around it (the ends are held).

    Deviation: the paper's "linear interpolation layer" is, in the code of its predecessors, a
    resize of K rows to T with the corners aligned. That puts feature 0 (12.5 ms) at 0 ms and the
    last one, up to 32 ms before the clip's end, at its last frame: rows drift against the audio
    by up to a frame, and by how much depends on the length. Here every row is exact in time.

    Parameters
    ----------
    encoder : transformers.Wav2Vec2Model
    freeze_stem : bool
        Keep the convolutional stem fixed: "the TCN parameters in Wav2Vec2.0 are fixed" (§4.1).
    input_scale : float
        Factor on the waveform.
    """

    def __init__(
        self, encoder: nn.Module, *, freeze_stem: bool = True, input_scale: float = SPEECH_SCALE
    ) -> None:
        super().__init__()
        self.encoder = encoder
        self.input_scale = input_scale
        config: Any = encoder.config
        self.output_size: int = config.hidden_size
        self.receptive_field, self.stride = _receptive_field(config.conv_kernel, config.conv_stride)
        if freeze_stem:
            encoder.freeze_feature_encoder()  # type: ignore[operator]
        if hasattr(encoder, "masked_spec_embed"):  # never used: apply_spec_augment is off
            encoder.masked_spec_embed.requires_grad_(False)

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
        if config.checkpoint is None:
            return cls.from_config(config.encoder)
        if pretrained:
            return cls.from_pretrained(config.checkpoint, freeze_stem=config.freeze_stem)
        shape: Mapping[str, Any]
        if config.encoder or config.checkpoint == PUBLISHED:
            shape, scale = config.encoder, SPEECH_SCALE if config.normalise else 1.0
        else:
            with _one_line_errors(config.checkpoint):
                shape, scale = _read_config(config.checkpoint)
        encoder = _new_encoder(shape)
        return cls(encoder, freeze_stem=config.freeze_stem, input_scale=scale)

    @classmethod
    def from_pretrained(cls, name: str, *, freeze_stem: bool = True) -> Self:
        """Read a published or local checkpoint; safetensors only, never a pickle.

        Parameters
        ----------
        name : str
            Name on the Hugging Face hub (taken from the cache where it is there), or a folder
            with ``config.json`` and ``model.safetensors``.
        freeze_stem : bool
            As in the constructor.

        Raises
        ------
        CheckpointError
            Not there, not reachable, not wav2vec 2.0, without safetensors, or incomplete.
        """
        from transformers import Wav2Vec2Model

        with _one_line_errors(name), _quiet_transformers():
            shape, scale = _read_config(name)
            encoder, report = _cached_or_fetched(
                Wav2Vec2Model.from_pretrained,
                name,
                config=_encoder_config(shape),
                use_safetensors=True,
                output_loading_info=True,
            )
        missing = set(report["missing_keys"]) - {"masked_spec_embed"}
        if missing:
            raise CheckpointError(
                f"{name} lacks {len(missing)} weights of wav2vec 2.0, such as {min(missing)}; "
                f"give a complete checkpoint, such as {PUBLISHED}"
            )
        return cls(encoder.float(), freeze_stem=freeze_stem, input_scale=scale)

    @classmethod
    def from_config(cls, changes: Mapping[str, Any], *, freeze_stem: bool = False) -> Self:
        """A new encoder with random weights: `COMPACT` with `changes`.

        Parameters
        ----------
        changes : mapping
            Keys of transformers' ``Wav2Vec2Config``.
        freeze_stem : bool
            Deviation: off, for a fixed random stem carries little information.
        """
        encoder = _new_encoder({**COMPACT, **changes})
        return cls(encoder, freeze_stem=freeze_stem)

    def described(self, config: Wav2VecConfig) -> Wav2VecConfig:
        """Configuration that builds the encoder where its checkpoint is no longer there."""
        if config.checkpoint is None:
            return config
        encoder: Any = self.encoder.config
        values = json.loads(encoder.to_json_string(use_diff=True))
        shape = {key: value for key, value in values.items() if key not in _ABOUT}
        normalise = self.input_scale == SPEECH_SCALE
        return config.model_copy(update={"encoder": shape, "normalise": normalise})

    def forward(self, waveform: Tensor, n_frames: int) -> Tensor:
        """Encode a batch of speech at 30 Hz.

        Parameters
        ----------
        waveform : Tensor [shape=(B, S)]
            float32, 16 kHz, speech at -23 dBFS.
        n_frames : int
            T.

        Returns
        -------
        Tensor [shape=(B, T, D)]
            Row i is time i/30 s.
        """
        return self._rows(self.features(waveform), 0, n_frames, first_sample=0)

    def features(self, waveform: Tensor) -> Tensor:
        """Features (B, K, D) at 50 Hz of (B, S), before interpolation."""
        return self._encoded(waveform)

    @torch.no_grad()
    def encode(
        self,
        waveform: Tensor,
        n_frames: int,
        chunk_seconds: float = 24.0,
        overlap_seconds: float = 2.0,
        progress: Callable[[float], None] = lambda share: None,
    ) -> Tensor:
        """Encode a whole clip in chunks of bounded memory, in evaluation mode.

        Neighbouring chunks overlap and are cross-faded there, so that the frames at a chunk's
        edge, which lack context, count least. A clip of up to one chunk is encoded at once and
        equals `forward`. On longer ones attention spans 24 s instead of the whole clip: the
        difference is more than rounding, but small wherever attention is local. Chunks start on the
        stem's own grid.

        Parameters
        ----------
        waveform : Tensor [shape=(S,)]
            As for `forward`; it may lie on the CPU, chunks are moved to the encoder.
        n_frames : int
            T.
        chunk_seconds, overlap_seconds : float
            A chunk is at least two overlaps long.
        progress : callable
            Called with the share done, 0 to 1.

        Returns
        -------
        Tensor [shape=(T, D)]
        """
        chunk, overlap = round(chunk_seconds * FRAME_RATE), round(overlap_seconds * FRAME_RATE)
        if overlap < 0 or chunk < max(2 * overlap, 1):
            raise ConfigError(
                f"chunk_seconds={chunk_seconds:g} must be at least twice "
                f"overlap_seconds={overlap_seconds:g}; lengthen the chunks"
            )
        device = next(self.encoder.parameters()).device
        rows = torch.empty(n_frames, self.output_size, device=device)
        done = 0
        while done < n_frames:
            start = max(0, min(done - overlap, n_frames - chunk)) if done else 0
            stop = min(start + chunk, n_frames)
            first, last = self._sample_span(start, stop)
            piece = waveform[first:last].unsqueeze(0).to(device)
            new = self._rows(self._encoded(piece), start, stop, first_sample=first)[0]
            kept = done - overlap if done else 0
            fade = torch.arange(1, done - kept + 1, device=device).unsqueeze(1) / (overlap + 1)
            rows[kept:done].lerp_(new[kept - start : done - start], fade)
            rows[done:stop] = new[done - start :]
            done = stop
            progress(done / n_frames)
        return rows

    def _encoded(self, waveform: Tensor) -> Tensor:
        """Run the encoder on (B, S); what is too short for one feature is padded with zeros."""
        lacking = max(0, self.receptive_field - waveform.shape[-1])
        padded = nn.functional.pad(waveform * self.input_scale, (0, lacking))
        output: Tensor = self.encoder(padded).last_hidden_state
        return output

    def _sample_span(self, start: int, stop: int) -> tuple[int, int]:
        """Samples [first, last) that the rows start … stop - 1 are interpolated from.

        `first` is a multiple of the stride, so a chunk's features lie on the whole clip's grid.
        """
        first = start * SAMPLE_RATE // FRAME_RATE - self.receptive_field
        last = -(-stop * SAMPLE_RATE // FRAME_RATE) + self.receptive_field
        return max(0, first // self.stride * self.stride), last

    def _rows(self, features: Tensor, start: int, stop: int, *, first_sample: int) -> Tensor:
        """Interpolate features (B, K, D), begun at `first_sample`, at the times of rows (B, n, D).

        With stride 320, rows 0, 1, 2, 3 (samples 0, 533.3, 1066.7, 1600) lie at the feature
        positions -0.62 (held at 0), 1.04, 2.71 and 4.38.
        """
        frames = torch.arange(start, stop, device=features.device, dtype=torch.float64)
        centre = first_sample + (self.receptive_field - 1) / 2
        position = (frames * SAMPLE_RATE / FRAME_RATE - centre) / self.stride
        position = position.clamp(0, features.shape[1] - 1)
        below = position.long()
        above = (below + 1).clamp(max=features.shape[1] - 1)
        part = (position - below).to(features.dtype).unsqueeze(-1)  # (n, 1)
        return torch.lerp(features[:, below], features[:, above], part)


def _receptive_field(kernels: list[int], strides: list[int]) -> tuple[int, int]:
    """Samples under one feature, samples between features: (400, 320) for the base model."""
    field, jump = 1, 1
    for kernel, stride in zip(kernels, strides, strict=True):
        field += (kernel - 1) * jump
        jump *= stride
    return field, jump


def _encoder_config(shape: Mapping[str, Any]) -> "Wav2Vec2Config":
    """A checked Wav2Vec2Config; SpecAugment, layer drop and adapter are off (Paper silent)."""
    from transformers import Wav2Vec2Config

    known = Wav2Vec2Config().to_dict()
    for key in shape:
        if key not in known:
            raise ConfigError(
                f"encoder key {key!r} is none of transformers' Wav2Vec2Config; it has "
                "hidden_size, num_hidden_layers, num_attention_heads, conv_dim"
            )
    try:
        check_encoder(shape)
    except ValueError as error:
        raise ConfigError(f"the encoder's shape is impossible: {error}; mend it") from None
    fixed = {"apply_spec_augment": False, "layerdrop": 0.0, "add_adapter": False}
    try:
        return Wav2Vec2Config(**{**shape, **fixed})
    except Exception as error:  # its validation raises classes of huggingface_hub's own
        reason = " ".join(str(error).split())
        raise ConfigError(f"the encoder's shape is impossible: {reason}; mend it") from error


def _new_encoder(shape: Mapping[str, Any]) -> nn.Module:
    from transformers import Wav2Vec2Model

    config = _encoder_config(shape)
    try:
        return Wav2Vec2Model(config)
    except (ValueError, TypeError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"the encoder's shape is impossible: {reason}; mend it") from error


def _read_config(name: str) -> tuple[dict[str, Any], float]:
    """A checkpoint's shape, and its input scale."""
    from transformers import Wav2Vec2Config, Wav2Vec2FeatureExtractor

    values, _ = _cached_or_fetched(Wav2Vec2Config.get_config_dict, name)
    if values.get("model_type") != "wav2vec2":
        raise CheckpointError(
            f"{name} is a {values.get('model_type')!r} model; it must be wav2vec2, "
            f"such as {PUBLISHED}"
        )
    known = Wav2Vec2Config().to_dict()
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
    """What `read` finds in the folder or the cache, else on the hub."""
    try:
        return read(name, local_files_only=True, **options)
    except OSError:
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
            f"cannot find a wav2vec 2.0 checkpoint with model.safetensors as {name!r}, neither as "
            "a folder, nor in the cache, nor on the hub; check the name, go online once with "
            f"`hf download {PUBLISHED}`, or use a model with the mel frontend"
        ) from error
    except Exception as error:  # safetensors, torch and huggingface_hub each raise their own
        reason = " ".join(str(error).split())[:200]
        raise CheckpointError(
            f"{name} cannot be read as wav2vec 2.0 ({reason}); fetch or save it again"
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
