"""Speech and a speaker to the motion of a mesh: SDFA (§3, Fig. 1) and its rivals.

Letters: B clips or segments, T frames, C channels and F bins of a spectrum, L spectra, D features,
P speakers, K components, N triangles, V vertices::

    waveform -> mel spectrogram (B, 3, F, L) -> spectral gathering (B, L, 256)
             -> Time-BiLSTM, attention (B, T, 512)
             -> decoder: coefficients (B, T, K) -> (T, 6 N), (T, 3 N) -> solve -> vertices (T, V, 3)

With another encoder, or vertex offsets in place of gradients, it is one of the models that the
paper compares itself with (`deitalk.frontends.karras`, `deitalk.frontends.voca`).
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from deitalk.audio.load import SAMPLE_RATE
from deitalk.audio.voice_activity import normalise_level
from deitalk.config import (
    DEITalkFeaturesConfig,
    KarrasConfig,
    SDFAMelConfig,
    SDFAModelConfig,
    VocaConfig,
)
from deitalk.errors import CheckpointError, ConfigError, DataError, EmotionError
from deitalk.frontends.karras import KarrasEncoder
from deitalk.frontends.sdfa import SDFAEncoder
from deitalk.frontends.voca import VocaEncoder
from deitalk.frontends.windows import Encoder, nearest_places
from deitalk.models.curve_features import DEITalkFeatures
from deitalk.models.deformation_decoder import (
    Coefficients,
    InversePCA,
    Motion,
    MotionDecoder,
    Offsets,
)
from deitalk.postprocess.lip_seal import LipSeal
from rig.arrays import Float32
from rig.deformation.reconstruct import DeformationSolver, mesh_solver
from rig.face import build_head
from rig.mesh import TriMesh

if TYPE_CHECKING:
    from deitalk.models.mesh_head import Direction

NO_EMOTION = (
    "an SDFA model has no emotion and no intensity; leave them out, or use a DEITalk model such as "
    "default"
)
FRAMES_AT_ONCE = 480
"""Frames that are heard together when predicting."""
FRAMES_EXPANDED = 64
"""Frames whose gradients are in memory together."""


class FeatureChunk(NamedTuple):
    """Features of a piece of a recording, and which rows of theirs are wanted."""

    features: Tensor
    """[shape=(1, C, F, L)]."""
    places: Tensor
    """Spectrum of every frame, context included."""
    kept: slice
    """Those of `places` that are not context."""


class SDFA(nn.Module):
    """The network with the templates it can move.

    Parameters
    ----------
    config : SDFAModelConfig
        Encoder and sizes.
    layers : mapping of str to InversePCA
        Frozen layers by branch, see `deitalk.models.deformation_decoder.MotionDecoder`.
    speakers : sequence of str
        Styles, in the order of the one-hot label.
    templates : dict of str to TriMesh
        Expressionless mesh of every speaker.
    fps : float
        Frames per second it was trained at; `predict` gives as many.
    unit_mm : float
        Millimetres in a unit of the templates.
    """

    def __init__(
        self,
        config: SDFAModelConfig,
        layers: Mapping[str, InversePCA],
        speakers: Sequence[str],
        templates: dict[str, TriMesh],
        *,
        fps: float,
        unit_mm: float,
    ) -> None:
        super().__init__()
        self.config, self.fps, self.unit_mm = config, fps, unit_mm
        self.speakers, self.templates = tuple(speakers), dict(templates)
        self.encoder = build_encoder(config.frontend)
        self.decoder = MotionDecoder(
            self.encoder.output_size,
            len(self.speakers),
            layers,
            shared=config.shared_size,
            hidden=config.branch_sizes,
            normalise_weights=config.weight_norm,
        )
        self.seal = _seal(config.seal_mm, self.templates, unit_mm)

    def forward(self, features: Tensor, places: Tensor, speaker: Tensor) -> Coefficients:
        """Map features (B, C, F, L), places (T,) and one-hot speakers (B, P) to (B, T, K)."""
        heard = self.encoder(features, places)  # (B, T, D)
        label = speaker.unsqueeze(1).expand(-1, heard.shape[1], -1)
        coefficients: Coefficients = self.decoder(heard, label)
        return coefficients

    @torch.no_grad()
    def predict(
        self, waveform: Any, speaker: str | int = 0, direction: "Direction | None" = None
    ) -> Motion:
        """Gradients or offsets of a whole recording, frame i at i / fps seconds.

        Parameters
        ----------
        waveform : array [shape=(S,)]
            16 kHz, any level.
        speaker : str or int
            Style, by name or place.
        direction : Direction, optional
            Emotion and intensity, which only a `deitalk.models.mesh_head.MeshHead` can act.

        Returns
        -------
        Deformation or Offsets
            T = ceil(fps S / 16000) frames.

        Notes
        -----
        What sees one spectrum at a time runs once a spectrum, not once in every window that holds
        it; the result is that of every window on its own.
        Deviation: a window's centre is the spectrum nearest to the frame, at most half a hop
        (4 ms) away, well within the shifts that training sees (8.3 ms).
        """
        pieces = list(self.pieces(waveform, speaker, direction))
        return type(pieces[0])(*(torch.cat(rows) for rows in zip(*pieces, strict=True)))

    @torch.no_grad()
    def pieces(
        self, waveform: Any, speaker: str | int = 0, direction: "Direction | None" = None
    ) -> Iterator[Motion]:
        """As `predict`, some frames at a time: gradients of a minute take a gigabyte."""
        for coefficients in self.coefficients(waveform, speaker, direction):
            split = {k: torch.split(rows, FRAMES_EXPANDED) for k, rows in coefficients.items()}
            for rows in zip(*split.values(), strict=True):
                yield self.decoder.expand(dict(zip(split, rows, strict=True)))

    @torch.no_grad()
    def coefficients(
        self, waveform: Any, speaker: str | int = 0, direction: "Direction | None" = None
    ) -> Iterator[Coefficients]:
        """Coefficients (T, K) of some frames at a time, in order."""
        if direction is not None:
            raise EmotionError(NO_EMOTION)
        label = self.label(speaker).to(self.device)
        for features, places, kept in self.feature_chunks(waveform):
            rows = self(features, places, label)
            yield {name: row[0, kept] for name, row in rows.items()}

    @torch.no_grad()
    def feature_chunks(self, waveform: Any) -> Iterator[FeatureChunk]:
        """Features of a recording, `FRAMES_AT_ONCE` frames at a time, with what is about them."""
        assert isinstance(self.encoder, Encoder)
        samples = normalise_level(checked_waveform(waveform))
        sound = torch.from_numpy(samples).unsqueeze(0).to(self.device)
        n_frames = max(int(np.ceil(sound.shape[1] / SAMPLE_RATE * self.fps - 1e-9)), 1)
        context = round(self.encoder.context_seconds * self.fps)
        for start in range(0, n_frames, FRAMES_AT_ONCE):
            stop = min(start + FRAMES_AT_ONCE, n_frames)
            begin = max(start - context, 0)
            end = min(stop + context, n_frames)
            places = nearest_places(end, self.fps, self.encoder.frame_rate, begin)
            first = int(places[0]) - self.encoder.reach
            last = int(places[-1]) + self.encoder.reach + 1
            features = self.encoder.heard(sound, first, last)
            kept = slice(start - begin, stop - begin)
            yield FeatureChunk(features, (places - first).to(self.device), kept)

    @torch.no_grad()
    def attention_weights(self, waveform: Any) -> Float32:
        """Where each frame of a recording looks [shape=(T, W)]; rows sum to 1 (Fig. 9).

        Raises
        ------
        CheckpointError
            If this model has no attention.
        """
        config = self.config.frontend
        if not isinstance(self.encoder, SDFAEncoder) or (
            isinstance(config, SDFAMelConfig) and config.summary != "attention"
        ):
            raise CheckpointError("this model has no attention; choose one with SDFA's encoder")
        rows = [
            self.encoder.attention_weights(features, places)[kept]
            for features, places, kept in self.feature_chunks(waveform)
        ]
        return np.asarray(torch.cat(rows).cpu().numpy(), dtype=np.float32)

    def predict_mesh(
        self,
        waveform: Any,
        speaker: str | int = 0,
        template: TriMesh | None = None,
        direction: "Direction | None" = None,
    ) -> Float32:
        """Vertices of a whole recording (§3.5).

        Parameters
        ----------
        waveform : array [shape=(S,)]
            16 kHz, any level.
        speaker : str or int
            Style, by name or place.
        template : TriMesh, optional
            Face to move; it must have the templates' triangles. The speaker's own if not given.
        direction : Direction, optional
            As for `predict`.

        Returns
        -------
        array [shape=(T, V, 3)]
            In the template's unit; frame i is at i / fps seconds.
        """
        mesh = self.template(speaker) if template is None else template
        pieces = self.pieces(waveform, speaker, direction)
        return np.concatenate([self.vertices(piece, mesh) for piece in pieces])

    def vertices(self, motion: Motion, template: TriMesh) -> Float32:
        """Vertices (T, V, 3) of a template in frames of gradients or offsets."""
        if isinstance(motion, Offsets):
            offsets = motion.offsets.cpu().numpy().reshape(-1, *template.vertices.shape)
            moved = np.asarray(template.vertices + offsets, dtype=np.float32)
        else:
            s, r = (rows.cpu().double().numpy() for rows in motion)
            moved = np.asarray(_solver(template).solve(s, r), dtype=np.float32)
        return moved if self.seal is None else self.seal(moved)

    def template(self, speaker: str | int) -> TriMesh:
        """Expressionless mesh of a speaker."""
        return self.templates[self.speakers[self._place(speaker)]]

    def label(self, speaker: str | int) -> Tensor:
        """One-hot label [shape=(1, P)] of a speaker."""
        return torch.eye(len(self.speakers))[self._place(speaker)].unsqueeze(0)

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return next(self.decoder.parameters()).device

    def _place(self, speaker: str | int) -> int:
        if isinstance(speaker, int) and 0 <= speaker < len(self.speakers):
            return speaker
        if speaker in self.speakers:
            return self.speakers.index(str(speaker))
        raise CheckpointError(
            f"speaker {speaker!r} is unknown; this model knows {', '.join(self.speakers)}"
        )


def build_encoder(
    config: SDFAMelConfig | KarrasConfig | VocaConfig | DEITalkFeaturesConfig,
) -> Encoder | DEITalkFeatures:
    """The encoder a configuration names."""
    if isinstance(config, SDFAMelConfig):
        return SDFAEncoder(config)
    if isinstance(config, DEITalkFeaturesConfig):
        return DEITalkFeatures(config)
    return KarrasEncoder(config) if isinstance(config, KarrasConfig) else VocaEncoder(config)


def _seal(reach_mm: float, templates: Mapping[str, TriMesh], unit_mm: float) -> LipSeal | None:
    if reach_mm == 0:
        return None
    faces = build_head(0).skin.faces
    if not all(np.array_equal(mesh.faces, faces) for mesh in templates.values()):
        raise ConfigError(
            f"model.seal_mm={reach_mm:g}: only the embedded heads' lips are known; set it to 0"
        )
    return LipSeal.of_heads(reach_mm, unit_mm)


@lru_cache(maxsize=16)
def _solver(template: TriMesh) -> DeformationSolver:
    return mesh_solver(template)


def checked_waveform(waveform: Any) -> Float32:
    """One row of finite samples, or DataError."""
    samples = np.asarray(waveform, dtype=np.float32)
    if samples.ndim != 1 or not len(samples) or not np.isfinite(samples).all():
        raise DataError(
            f"a waveform of shape {samples.shape} cannot be used; give one row of finite samples "
            "at 16 kHz"
        )
    return samples
