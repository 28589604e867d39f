"""Speech and a speaker to the motion of a mesh: SDFA (§3, Fig. 1) and its comparison models.

C channels of a spectrum, W spectra of a window::

    waveform -> mel spectrogram (B, 3, F, L) -> spectral gathering (B, L, 256)
             -> Time-BiLSTM, attention (B, T, 512)
             -> decoder: coefficients (B, T, K) -> (T, 6 N), (T, 3 N) -> solve -> vertices (T, V, 3)

With another encoder, or vertex offsets in place of gradients, it is one of the models that the
paper compares itself with.
"""

from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.config.mesh import SDFAModelConfig
from deitalk.errors import CheckpointError
from deitalk.frontends.base import Encoder, nearest_places
from deitalk.models.deformation_decoder import (
    Coefficients,
    InversePCA,
    Motion,
    MotionDecoder,
)
from deitalk.models.protocol import Product
from rig.arrays import Float32
from rig.mesh import TriMesh
from rig.mesh.deformation import DeformationSolver, mesh_solver

if TYPE_CHECKING:
    from deitalk.models.curve_model import DEITalk


LEAST_DEVIATION = 1e-3


class DEITalkFeatures(nn.Module):
    """Standardised input of the last layer of a frozen DEITalk model.

    The features hold speech, emotional style and intensity, after eight convolutions along time.

    Parameters
    ----------
    network : DEITalk
        Frozen here; neither trained nor saved as a part of this module.
    fingerprint : str
        SHA-256 of its weights, which a mesh head's folder stores.

    Attributes
    ----------
    output_size : int
        D.
    mean, deviation : Tensor [shape=(D,)]
        By which every feature is standardised; set by `fit`.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, network: "DEITalk", fingerprint: str) -> None:
        super().__init__()
        self._frozen = (network.requires_grad_(False),)  # a tuple: no module of this one
        self.fingerprint = fingerprint
        self.output_size = network.decoder.output.in_features
        self.register_buffer("mean", torch.zeros(self.output_size))
        self.register_buffer("deviation", torch.ones(self.output_size))

    @property
    def network(self) -> "DEITalk":
        """The DEITalk model, in evaluation mode, on the device of the buffers."""
        return self._frozen[0].to(self.mean.device)

    def fit(self, rows: Tensor) -> None:
        """Set mean and deviation from features (T, D) of many clips.

        A feature of deviation 0 is divided by `LEAST_DEVIATION`.
        """
        self.mean.copy_(rows.mean(dim=0))
        self.deviation.copy_(rows.std(dim=0) + LEAST_DEVIATION)

    def standardised(self, rows: Tensor) -> Tensor:
        """Features (..., D) of mean 0 and deviation 1."""
        return (rows - self.mean) / self.deviation

    def forward(self, features: Tensor, places: Tensor) -> Tensor:
        """Map features (B, 1, D, T) to standardised rows (B, len(places), D) at `places`."""
        return self.standardised(features[:, 0].transpose(1, 2)[:, places])


FRAMES_AT_ONCE = 480
"""Frames encoded together when predicting."""
FRAMES_EXPANDED = 64
"""Frames whose gradients are in memory together: gradients of a minute take a gigabyte."""


class FeatureChunk(NamedTuple):
    """Features of a part of a recording, and the rows to keep of what is decoded from them."""

    features: Tensor
    """[shape=(1, C, F, L)]."""
    places: Tensor
    """Spectrum of every frame, context included."""
    kept: slice
    """Frames of `places` that are not context."""


class MeshModel(nn.Module):
    """A speech encoder, the decoder of SDFA §3.4, and the templates it moves.

    Parameters
    ----------
    config : SDFAModelConfig
        Sizes of the decoder.
    encoder : Encoder or DEITalkFeatures
        The one that `config.frontend` names.
    layers : mapping of str to InversePCA
        Frozen layers by branch, see `deitalk.models.deformation_decoder.MotionDecoder`.
    templates : mapping of str to TriMesh
        Expressionless mesh of every speaker, in the order of the one-hot label.
    fps : float
        Frames per second it was trained at; it predicts as many.
    unit_mm : float
        Millimetres in a unit of the templates.
    """

    product: Product = "mesh"
    has_emotion = False

    def __init__(
        self,
        config: SDFAModelConfig,
        encoder: Encoder | DEITalkFeatures,
        layers: Mapping[str, InversePCA],
        templates: Mapping[str, TriMesh],
        *,
        fps: float,
        unit_mm: float,
    ) -> None:
        super().__init__()
        self.config, self.fps, self.unit_mm = config, fps, unit_mm
        self.speakers, self.templates = tuple(templates), dict(templates)
        self.encoder = encoder
        self.decoder = MotionDecoder(
            encoder.output_size,
            len(self.speakers),
            layers,
            shared=config.shared_size,
            hidden=config.branch_sizes,
            normalise_weights=config.weight_norm,
        )

    def forward(self, features: Tensor, places: Tensor, speaker: Tensor) -> Coefficients:
        """Map features (B, C, F, L), places (T,) and one-hot speakers (B, Q) to (B, T, K)."""
        speech = self.encoder(features, places)  # (B, T, D)
        label = speaker.unsqueeze(1).expand(-1, speech.shape[1], -1)
        coefficients: Coefficients = self.decoder(speech, label)
        return coefficients

    @torch.no_grad()
    def expand(self, coefficients: Iterable[Coefficients]) -> Iterator[Motion]:
        """Gradients or offsets of coefficients (T, K), `FRAMES_EXPANDED` frames at a time."""
        for rows in coefficients:
            split = {name: torch.split(row, FRAMES_EXPANDED) for name, row in rows.items()}
            for parts in zip(*split.values(), strict=True):
                yield self.decoder.expand(dict(zip(split, parts, strict=True)))

    def vertices(self, motion: Motion, template: TriMesh) -> Float32:
        """Vertices (T, V, 3) of a template in frames of gradients or offsets (§3.5)."""
        rows = [part.cpu().double().numpy() for part in motion]
        if self.config.motion == "offsets":
            offsets = rows[0].reshape(-1, *template.vertices.shape)
            return np.asarray(template.vertices + offsets, dtype=np.float32)
        s, r = rows
        return np.asarray(_solver(template).solve(s, r), dtype=np.float32)

    def about(self) -> dict[str, Any]:
        """Its entries of ``model.json``."""
        return {
            "kind": "sdfa",
            "control_set": "none (meshes)",  # curve models name theirs
            "controls": [],
            "speakers": list(self.speakers),
            "fps": self.fps,
            "unit_mm": self.unit_mm,
        }

    def is_fixed(self, name: str) -> bool:
        """Whether a weight is that of a published encoder, which did not learn: none is."""
        return False

    def template(self, speaker: str | int) -> TriMesh:
        """Expressionless mesh of a speaker, by name or number."""
        return self.templates[self.speakers[self._number(speaker)]]

    def label(self, speaker: str | int) -> Tensor:
        """One-hot label [shape=(1, Q)] of a speaker, by name or number."""
        return torch.eye(len(self.speakers), device=self.device)[[self._number(speaker)]]

    @property
    def device(self) -> torch.device:
        """Device of the weights."""
        return next(self.decoder.parameters()).device

    def _number(self, speaker: str | int) -> int:
        if isinstance(speaker, int) and 0 <= speaker < len(self.speakers):
            return speaker
        if speaker in self.speakers:
            return self.speakers.index(str(speaker))
        raise CheckpointError(
            f"speaker {speaker!r} is unknown; this model has {', '.join(self.speakers)}"
        )


class SDFA(MeshModel):
    """`MeshModel` with a speech encoder of its own (§3.1-3.3)."""

    encoder: Encoder

    @torch.no_grad()
    def coefficients(self, sound: Tensor, speaker: str | int = 0) -> Iterator[Coefficients]:
        """Coefficients (T, K) of a recording, `FRAMES_AT_ONCE` frames at a time.

        Parameters
        ----------
        sound : Tensor [shape=(S,)]
            16 kHz, level-normalised; T = ceil(fps S / 16000), frame i at i / fps seconds.
        speaker : str or int
            Style, by name or number.

        Notes
        -----
        What depends on one spectrum alone is computed once a spectrum, not once in every window
        that holds it; the result is that of every window on its own.
        Deviation: a window's centre is the spectrum nearest to the frame, at most half a hop
        (4 ms) away, well within the shifts of the augmentation (8.3 ms).
        """
        label = self.label(speaker)
        for features, places, kept in self.feature_chunks(sound):
            rows = self(features, places, label)
            yield {name: row[0, kept] for name, row in rows.items()}

    @torch.no_grad()
    def feature_chunks(self, sound: Tensor) -> Iterator[FeatureChunk]:
        """Features of a recording (S,), `FRAMES_AT_ONCE` frames at a time, with their context."""
        sound = sound.unsqueeze(0).to(self.device)
        n_frames = max(int(np.ceil(sound.shape[1] / SAMPLE_RATE * self.fps - 1e-9)), 1)
        context = round(self.encoder.context_seconds * self.fps)
        for start in range(0, n_frames, FRAMES_AT_ONCE):
            stop = min(start + FRAMES_AT_ONCE, n_frames)
            begin = max(start - context, 0)
            end = min(stop + context, n_frames)
            places = nearest_places(end, self.fps, self.encoder.frame_rate, begin)
            first = int(places[0]) - self.encoder.reach
            last = int(places[-1]) + self.encoder.reach + 1
            features = self.encoder.features_between(sound, first, last)
            kept = slice(start - begin, stop - begin)
            yield FeatureChunk(features, (places - first).to(self.device), kept)


@lru_cache(maxsize=16)
def _solver(template: TriMesh) -> DeformationSolver:
    return mesh_solver(template)
