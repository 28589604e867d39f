"""DEITalk's network: the stages of §3, wired in the order of Fig. 2."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from torch import Tensor, nn

from deitalk.audio.frames import FRAME_RATE
from deitalk.config.curves import ModelConfig
from deitalk.config.frontends import CausalWhisperConfig
from deitalk.config.rules import RulesConfig
from deitalk.emotions import EMOTIONS
from deitalk.frontends import build_frontend
from deitalk.models.intensity import DynamicIntensity, Intensity, MotionEncoder, temporal_maximum
from deitalk.models.joined import JoinedClips
from deitalk.models.lip_readout import LipReadout
from deitalk.models.positions import dynamic_positions
from deitalk.models.protocol import (
    Product,
    Reading,
    Tracks,
    is_neutral,
    neutral_and_acted,
    neutral_weights,
    styles_of,
)
from deitalk.models.rig_decoder import Decoder, RigDecoder, build_decoder
from deitalk.postprocess.curve_pass import CurvePass, TorchPass
from rig import ControlSet, default_controls
from rig.arrays import Float32

DECODE_FRAMES = 1024
"""Rig frames decoded at once on a long clip (34 s)."""
FRAMES_TOGETHER = 32_768
"""Rig frames of recordings that are decoded at once (18 minutes, some 700 MB)."""


class Output(NamedTuple):
    """Output for one batch in training."""

    curves: Tensor
    """Predicted curves [shape=(B, T, C)]."""
    intensity: Intensity | None
    emotion_logits: Tensor | None
    """[shape=(B, 5)]."""
    motion_embedding: Tensor | None
    """m_max [shape=(B, E)]; only where the captured curves were given."""
    speech: Tensor | None = None
    """Speech features [shape=(B, T, D)]."""


class Analysis(NamedTuple):
    """What the network computes of a whole clip, independent of the emotion."""

    speech: Tensor
    """Speech features [shape=(T, D)]."""
    guidance: Tensor | None
    """E_in [shape=(T, E)]."""
    saliency: Tensor | None
    """e_sim [shape=(T,), range -1 to 1]."""
    strength: Tensor | None
    """Predicted intensity [shape=(T,), range 0 to 1]."""
    effort: Tensor | None = None
    """Strength of the voice [shape=(T,)], dB above the usual."""
    lips: Tensor | None = None
    """What `deitalk.models.lip_readout` reads [shape=(T, 11)]."""

    @property
    def tracks(self) -> Tracks:
        """What is predicted of each frame, as arrays."""
        rows = (self.saliency, self.strength, self.effort)
        return Tracks(*(None if row is None else row.cpu().numpy() for row in rows))


class DEITalk(nn.Module):
    """Speech and emotion to control curves (DEITalk §3, Fig. 2).

    Parameters
    ----------
    config : ModelConfig
    controls : ControlSet or None
        The rig; the default set if None.
    pretrained : bool
        Read the wav2vec 2.0 checkpoint that the configuration names.
    rules : RulesConfig
        Post-processing of the curves; the network itself does not read it.
    """

    product: Product = "curves"
    fps = float(FRAME_RATE)
    """Frames per second of the curves."""

    def __init__(
        self,
        config: ModelConfig,
        controls: ControlSet | None = None,
        *,
        pretrained: bool = True,
        rules: RulesConfig = RulesConfig(),
    ) -> None:
        super().__init__()
        self.config, self.rules = config, rules
        self.controls = controls or default_controls()
        self.frontend = build_frontend(config.frontend, pretrained)
        size = self.frontend.output_size
        n_emotions, n_controls = len(EMOTIONS), len(self.controls.names)
        if config.intensity:
            self.intensity = DynamicIntensity(
                size,
                config.emotion_size,
                config.classifier_size,
                n_emotions,
                config.saliency_frames,
                self.is_causal,
                config.kept_intensity,
                config.effort,
            )
            self.motion = MotionEncoder(
                n_controls, config.motion_channels, config.kernel_size, config.emotion_size
            )
        self.decoder = self.new_decoder()
        names, kept, causal = self.controls.names, config.kept_controls, self.is_causal
        self.lips = LipReadout(size, names, causal=causal, kept=kept) if config.lips else None

    def new_decoder(self) -> Decoder:
        """Make the decoder, that of Eq. 7."""
        size = self.frontend.output_size
        return build_decoder(self.config, size, self.controls, causal=self.is_causal)

    def forward(
        self,
        waveform: Tensor,
        emotion: Tensor,
        frames: Tensor,
        total: Tensor,
        curves: Tensor | None = None,
    ) -> Output:
        """Predict one batch of windows.

        Parameters
        ----------
        waveform : Tensor [shape=(B, S)]
            16 kHz, level-normalised; begins with the first frame of the window. Or its speech
            features [shape=(B, T, D)].
        emotion : Tensor [shape=(B, 5) or (B, 5 + actors)]
            Weights of the emotional styles, and of the actors.
        frames : Tensor [shape=(B, T)]
            Frame indices in the whole clip.
        total : Tensor [shape=(B,)]
            Frames of the whole clip.
        curves : Tensor [shape=(B, T, C)] or None
            Captured curves, for the motion encoder.
        """
        is_encoded = waveform.dim() == 3
        speech = waveform if is_encoded else self.frontend(waveform, frames.shape[1])  # (B, T, D)
        intensity = self.intensity(speech) if self.config.intensity else None
        predicted = self.decoder(
            self.place(speech, frames, total), emotion, intensity.guidance if intensity else None
        )
        if intensity is None:
            return Output(predicted, None, None, None, speech)
        return Output(
            predicted,
            intensity,
            self.intensity.classify(intensity.features),
            None if curves is None else temporal_maximum(self.motion(curves)),
            speech,
        )

    @property
    def is_causal(self) -> bool:
        """Whether frames depend on a bounded look-ahead only (`deitalk.live`)."""
        return self.frontend.is_causal

    @property
    def rig_decoder(self) -> RigDecoder:
        """The decoder of Eq. 7.

        Raises
        ------
        CheckpointError
            If the model has the decoder of another paper.
        """
        return cast("RigDecoder", self.decoder)

    @property
    def device(self) -> torch.device:
        """Device of the weights."""
        return next(self.parameters()).device

    @property
    def actors(self) -> tuple[str, ...]:
        """Names of the actors whose styles it has."""
        return tuple(self.config.actors)

    @property
    def emotions(self) -> tuple[str, ...]:
        """Trained emotions that it shows; the others pass as the first of them."""
        return tuple(self.config.captured_emotions if self.config.base_controls == 0 else EMOTIONS)

    def curve_pass(self, *, live: bool = False) -> TorchPass:
        """Rules after the network; see `deitalk.models.protocol.Network`."""
        ahead = cast("CausalWhisperConfig", self.config.frontend).rules_ahead if live else None
        rules = CurvePass(self.controls, self.rules, ahead)
        return TorchPass(rules.to(self.device))

    def read(
        self,
        sound: Float32,
        weights: Float32,
        actor: str = "",
        progress: Callable[[float], None] = lambda share: None,
        gain: float = 1.0,
    ) -> Reading:
        """Curves of a whole recording; see `deitalk.models.protocol.CurveNetwork`."""
        analysis = self.analyse(torch.from_numpy(sound), len(weights), progress, gain)
        return self._acted(analysis, weights, actor)

    def _acted(self, analysis: Analysis, weights: Float32, actor: str) -> Reading:
        """Both readings of a clip."""
        styles = self.styles(torch.from_numpy(np.stack(neutral_and_acted(weights))), actor)
        curves = self.decode(analysis, styles.to(self.device))
        if self.lips is not None and analysis.lips is not None:
            with torch.no_grad():
                curves = self.lips.correct(curves, analysis.lips)
        readings = list(curves.cpu().numpy())
        return Reading(readings[0], readings[-1], analysis.tracks)

    def about(self) -> dict[str, Any]:
        """Its entries of ``model.json``."""
        about = {"control_set": self.controls.id, "controls": list(self.controls.names)}
        if not self.actors:
            return about
        return about | {"actors": list(self.actors), "actor_by_default": "the mean of all"}

    def is_fixed(self, name: str) -> bool:
        """Whether a weight is that of a published encoder, which did not learn."""
        return self.frontend.is_fixed(name.removeprefix("frontend."))

    @torch.no_grad()
    def read_together(
        self, sounds: Sequence[Float32], weights: Sequence[Float32], actors: Sequence[str]
    ) -> list[Reading]:
        """Curves of recordings of any lengths; as `read` of each, to rounding.

        With a Whisper frontend and the decoder of Eq. 7 all of them are one pass, of as many calls
        of torch as that of one, in parts of at most `FRAMES_TOGETHER` frames.

        Parameters
        ----------
        sounds : sequence of array [shape=(S,)]
            16 kHz, level-normalised.
        weights : sequence of array [shape=(T, 5)]
            Emotion of each frame of each recording.
        actors : sequence of str
            As for `read`, of each recording.
        """
        clips = [torch.from_numpy(sound) for sound in sounds]
        counts = [len(rows) for rows in weights]
        speech = self.frontend.encode_together(clips, counts)
        is_local = not self.config.intensity or self.intensity.saliency_frames is not None
        if not (is_local and self.decoder.joins):
            return [
                self._acted(self.analyse(features, len(features)), rows, actor)
                for features, rows, actor in zip(speech, weights, actors, strict=True)
            ]
        found: list[Reading] = []
        for part in _parts(counts):
            found += self._read_joined(speech[part], weights[part], actors[part])
        return found

    def _read_joined(
        self, speech: Sequence[Tensor], weights: Sequence[Float32], actors: Sequence[str]
    ) -> list[Reading]:
        """Readings of recordings from their features (T, D), in one pass."""
        clips = JoinedClips([len(rows) for rows in weights], self.device)
        rows = torch.cat(list(speech)).float().unsqueeze(0)  # (1, K, D)
        intensity = self.intensity(rows, None, clips) if self.config.intensity else None
        placed = self.place(rows.transpose(0, 1), clips.frames[:, None], clips.totals)
        acted = [
            styles_of(np.stack((neutral_weights(len(each)), each)), self.actors, actor)
            for each, actor in zip(weights, actors, strict=True)
        ]
        curves = self.rig_decoder.readings(
            placed.transpose(0, 1),
            torch.from_numpy(np.concatenate(acted, axis=1)).to(self.device),
            None if intensity is None else intensity.guidance,
            clips,
        )
        if self.lips is not None:
            curves = self.lips.correct(curves, self.lips(rows, None, clips)[0])
        values, ends = curves.float().cpu().numpy(), np.cumsum(clips.counts)[:-1]
        tracks: list[Any] = []
        if intensity is not None:
            known = [intensity.saliency, intensity.strength]
            known += [] if intensity.effort is None else [intensity.effort]
            tracks = np.split(torch.cat(known).float().cpu().numpy(), ends, axis=1)
        return [
            Reading(
                each[0],
                each[0] if is_neutral(given) else each[1],
                Tracks(*track, *[None] * (len(Tracks._fields) - len(track))),
            )
            for each, given, track in zip(
                np.split(values, ends, axis=1), weights, tracks or [()] * len(weights), strict=True
            )
        ]

    def styles(self, emotion: Tensor, actor: str) -> Tensor:
        """Weights of all styles: those of the emotions, and 1 for an actor.

        Parameters
        ----------
        emotion : Tensor [shape=(..., 5)]
            Weights of the emotional styles.
        actor : str
            One of ``config.actors``; any other is nobody, whose style the base model had.

        Returns
        -------
        Tensor [shape=(..., 5 + actors)]
        """
        chosen = emotion.new_tensor([float(name == actor) for name in self.config.actors])
        return torch.cat((emotion, chosen.expand(*emotion.shape[:-1], -1)), dim=-1)

    def place(self, speech: Tensor, frames: Tensor, total: Tensor) -> Tensor:
        """Add the dynamic positional encoding (Eq. 3)."""
        if not self.config.positions:
            return speech
        return speech + dynamic_positions(frames, total, speech.shape[-1])

    @torch.no_grad()
    def analyse(
        self,
        waveform: Tensor,
        n_frames: int,
        progress: Callable[[float], None] = lambda share: None,
        gain: float = 1.0,
    ) -> Analysis:
        """Analyse a whole clip in bounded memory.

        Parameters
        ----------
        waveform : Tensor [shape=(S,)]
            16 kHz, level-normalised; or the frontend's features of it [shape=(T, D)].
        n_frames : int
            Rig frames T of the clip.
        progress : callable
            Called with the share of the frontend's work that is done, 0 to 1.
        gain : float
            Factor that normalises the waveform's level, if that is not done.
        """
        if waveform.ndim == 2:
            speech = waveform
        else:
            speech = self.frontend.encode(waveform, n_frames, progress=progress, gain=gain)
        lips = self._read_lips(speech)
        if not self.config.intensity:
            return Analysis(speech, None, None, None, lips=lips)
        module = self.intensity
        embedding = None
        if module.saliency_frames is None:
            pieces = torch.split(speech, DECODE_FRAMES)
            largest = [module.project(piece.float()).amax(dim=0) for piece in pieces]
            embedding = torch.stack(largest).amax(dim=0).unsqueeze(0)
        margin = (module.saliency_frames or 0) // (1 if module.causal else 2)
        parts = []
        for first, last, start, stop in _pieces(n_frames, margin):
            output = module(speech[first:last].float().unsqueeze(0), embedding)
            rows = (output.guidance.to(speech.dtype), output.saliency, output.strength)
            rows += () if output.effort is None else (output.effort,)
            parts.append([row[0, start - first : stop - first] for row in rows])
        found = [torch.cat(part) for part in zip(*parts, strict=True)]
        return Analysis(speech, *found)._replace(lips=lips)

    def _read_lips(self, speech: Tensor) -> Tensor | None:
        """Readout of a whole clip's features (T, D), piece by piece [shape=(T, 11)]."""
        if self.lips is None:
            return None
        parts = [
            self.lips(speech[first:last].float().unsqueeze(0))[0, start - first : stop - first]
            for first, last, start, stop in _pieces(len(speech), self.lips.margin)
        ]
        return torch.cat(parts)

    @torch.no_grad()
    def decode(self, analysis: Analysis, emotion: Tensor) -> Tensor:
        """Curves of a whole clip, piece by piece; equal to one piece to rounding.

        Parameters
        ----------
        analysis : Analysis
            Of the whole clip.
        emotion : Tensor [shape=(T, 5 or 5 + actors) or (R, T, 5 or 5 + actors)]
            Weights of the emotional styles, and of the actors (`styles`), frame by frame; R
            readings of one speech take less time together.

        Returns
        -------
        Tensor [shape=(T, C) or (R, T, C)]
        """
        return self._by_pieces(self.decoder.readings, analysis, emotion, len(self.controls.names))

    @torch.no_grad()
    def describe(self, analysis: Analysis, emotion: Tensor) -> Tensor:
        """Input of the decoder's last layer, from which a mesh can be decoded.

        See `deitalk.models.mesh_model`; arguments as `decode`.

        Returns
        -------
        Tensor [shape=(T, H) or (R, T, H)]
        """
        width = self.decoder.output.in_features
        return self._by_pieces(self.decoder.hidden_readings, analysis, emotion, width)

    def _by_pieces(
        self, decode: Callable[..., Tensor], analysis: Analysis, emotion: Tensor, width: int
    ) -> Tensor:
        total, emotions = len(analysis.speech), emotion if emotion.dim() == 3 else emotion[None]
        shape = len(emotions), total, width
        rows = analysis.speech.new_empty(shape, dtype=torch.float32)
        for first, last, start, stop in _pieces(total, self.decoder.margin):
            frames = torch.arange(first, last, device=rows.device).unsqueeze(0)
            speech = analysis.speech[first:last].float().unsqueeze(0)
            guidance = analysis.guidance
            decoded = decode(
                self.place(speech, frames, frames.new_tensor([total])),
                emotions[:, first:last],
                None if guidance is None else guidance[first:last].float().unsqueeze(0),
            )
            rows[:, start:stop] = decoded[:, start - first : stop - first]
        return rows if emotion.dim() == 3 else rows[0]


def _parts(counts: Sequence[int]) -> Iterator[slice]:
    """Neighbours with `FRAMES_TOGETHER` frames at most, or one that has more."""
    start = total = 0
    for place, count in enumerate(counts):
        if total and total + count > FRAMES_TOGETHER:
            yield slice(start, place)
            start, total = place, 0
        total += count
    yield slice(start, len(counts))


def _pieces(total: int, margin: int) -> Iterator[tuple[int, int, int, int]]:
    """Ranges that cover a clip: (first, last) with margin, (start, stop) without."""
    for start in range(0, total, DECODE_FRAMES):
        stop = min(start + DECODE_FRAMES, total)
        yield max(start - margin, 0), min(stop + margin, total), start, stop
