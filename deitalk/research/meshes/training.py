"""Training of mesh models, from segments of adjacent frames (SDFA §4): the task of the trainer.

``train configs/sdfa.yaml --data DIR --out DIR``. The loop is `deitalk.training.trainer`;
the run folder holds ``meshes/`` too where the data had to be built.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn

from deitalk.acting import Acting
from deitalk.config.mesh import SDFAModelConfig
from deitalk.data.seeded_batches import Share
from deitalk.errors import ConfigError
from deitalk.frontends.base import Encoder
from deitalk.frontends.mel_bilstm import MelFrontend
from deitalk.frontends.sdfa_encoder import SDFAEncoder
from deitalk.models.checkpoint import new_encoder, require_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.deformation_decoder import InversePCA
from deitalk.models.mesh_head import MeshHead
from deitalk.models.mesh_model import SDFA, DEITalkFeatures, MeshModel
from deitalk.postprocess.lip_seal import check_faces
from deitalk.research.config import MeshTrainingConfig
from deitalk.research.meshes.feature_segments import FeatureSegments
from deitalk.research.meshes.folder import MeshClip, MeshFolder
from deitalk.research.meshes.gradient_bases import GradientBasis
from deitalk.research.meshes.losses import MeshLoss
from deitalk.research.meshes.mesh_bases import MeshBases
from deitalk.research.meshes.predict import predict_mesh
from deitalk.research.meshes.scores import lip_gap
from deitalk.research.meshes.segments import Segment, SegmentBatches, Segments
from deitalk.research.meshes.sources import has_lips, open_meshes
from deitalk.research.training.pictures import ClipRows, DrawsClips, Row
from deitalk.training.trainer import Progress, Task, run_training, silent
from rig.arrays import AnyFloat
from rig.mesh.trimesh import TriMesh

VALIDATION_CLIPS = 8
"""At most so many clips are scored at every evaluation; the first two are drawn."""
N_SHOWN = 2
STARTED_RATE = 1 / 3
"""Share of the learning rate for an encoder that begins as another model's."""


def train_mesh(
    config: MeshTrainingConfig,
    data: Path,
    out: Path,
    *,
    resume: bool = False,
    track: Sequence[str] = (),
    progress: Progress = silent,
) -> dict[str, Any]:
    """Train a model of meshes.

    Parameters
    ----------
    config : MeshTrainingConfig
        Model, data and schedule.
    data : Path
        A mesh folder, a folder laid out as VOCASET, or a dataset folder whose curves the embedded
        heads act (`deitalk.research.meshes.sources`).
    out, resume, track, progress
        As for `deitalk.training.trainer.run_training`.

    Returns
    -------
    dict
        Step and development scores of the best model.

    Raises
    ------
    DataError, MissingError, rig.errors.TargetError
        As `run_training`.
    ConfigError
        As `run_training`; and if ``train.lip_weight`` is set and the data does not say where the
        lips are, or the encoder to start from does not fit.
    """
    task = MeshTask(config, data)
    return run_training(task, out, resume=resume, track=track, progress=progress)


class MeshTask(DrawsClips, Task[Segment]):
    """SDFA's network or the mesh head, segments of frames, and the loss of §4.2.

    Parameters
    ----------
    config, data
        As for `train_mesh`.
    """

    config: MeshTrainingConfig
    model: MeshModel

    def __init__(self, config: MeshTrainingConfig, data: Path) -> None:
        self.config, self.data = config, data
        self.item_size = config.train.segment_frames

    def read(self, out: Path) -> None:
        """Open the mesh folder; build it in the run folder where `data` is none."""
        weight = self.config.train.lip_weight
        if weight and not has_lips(self.data, out / "meshes"):
            raise ConfigError(
                f"train.lip_weight={weight:g}: {self.data} does not say where the lips are; set "
                "train.lip_weight=0"
            )
        self.folder = open_meshes(self.data, self.config.data, out / "meshes")

    def build(self, device: torch.device) -> None:
        """Build the model with the encoder it starts from, the segments and the loss."""
        config, folder, settings = self.config, self.folder, self.config.train
        speakers = folder.training_speakers
        self.model = new_mesh_model(
            config.model,
            frozen_layers(folder.bases, config.model.motion),
            {speaker: folder.templates[speaker] for speaker in speakers},
            fps=folder.fps,
            unit_mm=folder.unit_mm,
        )
        if settings.start_encoder is not None:
            copy_encoder(self.model, settings.start_encoder, settings.start_new)
        self.segments = self._segments()
        if isinstance(self.segments, FeatureSegments):
            cast("DEITalkFeatures", self.model.encoder).fit(self.segments.rows)
        self._loss = MeshLoss(self.model, settings, folder, self.segments).to(device)
        self.state = {"balance": self._loss.balance}
        # The bases are half of the weights.
        self.frozen = {name for name in self.model.state_dict() if ".inverse_pca." in name}

    def _segments(self) -> SegmentBatches:
        settings, clips = self.config.train, self.folder.split("train")
        drawing = {
            "n_frames": settings.segment_frames,
            "seed": settings.seed,
            "batch_size": settings.batch_size // settings.segment_frames,
        }
        speakers = self.model.speakers
        encoder = new_encoder(self.config.model.frontend)  # its own: spectra are cut on the CPU
        if self.config.model.frontend.kind == "deitalk":
            features = cast("DEITalkFeatures", encoder)
            return FeatureSegments(clips, speakers, features, **drawing)
        augment, spectral = self.config.data.augment, cast("Encoder", encoder)
        return Segments(clips, speakers, self.folder.fps, spectral, augment=augment, **drawing)

    def epoch_size(self) -> int:
        """Frames of all clips."""
        return self.segments.n_frames_total

    def optimizer(self) -> torch.optim.Optimizer:
        """Adam (§4.4); an encoder that begins as another model's learns at `STARTED_RATE`."""
        settings = self.config.train
        share = 1.0 if settings.start_encoder is None else STARTED_RATE
        rates = ((self.model.encoder, share), (self.model.decoder, 1.0))
        return torch.optim.Adam(
            [
                {"params": list(part.parameters()), "lr": settings.learning_rate * share}
                for part, share in rates
            ]
        )

    def batches(self, share: Share) -> SegmentBatches:
        """Segments of the training clips."""
        self.segments.share = share
        return self.segments

    def loss(self, network: nn.Module, batch: Segment) -> dict[str, Tensor]:
        """Every term, and the sum of the scaled terms (§4.2)."""
        parts: dict[str, Tensor] = self._loss(self.model, network, batch)
        return parts

    def validate(self, model: nn.Module) -> dict[str, float]:
        """Vertex errors on the validation clips."""
        scores, self.rows = validate_mesh(cast("MeshModel", model), self.folder)
        return scores

    def save(self, folder: Path, model: nn.Module, summary: dict[str, Any]) -> None:
        """Write a model folder."""
        save_model(folder, cast("MeshModel", model), self.config, summary)


def frozen_layers(bases: MeshBases, motion: str) -> dict[str, InversePCA]:
    """The last layers of what a model predicts: ``gradients`` or ``offsets``."""
    names = ("offsets",) if motion == "offsets" else ("stretch", "rotation")
    return {name: frozen_layer(getattr(bases, name)) for name in names}


def frozen_layer(basis: GradientBasis) -> InversePCA:
    """The layer of a fitted basis."""
    layer = InversePCA(*basis.components.shape)
    layer.mean = torch.from_numpy(basis.mean.copy())
    layer.components = torch.from_numpy(basis.components.astype("float32"))
    layer.deviations = torch.from_numpy(basis.deviations.copy())
    return layer


def copy_encoder(model: MeshModel, name: str, new: Sequence[str]) -> None:
    """Copy an encoder but for its `new` parts; what SDFA's lacks (`centre`, `rig`) is left out."""
    encoder, owner = cast("SDFAEncoder", model.encoder), require_model(name, DEITalk)
    start = cast("MelFrontend", owner.frontend)
    try:
        assert owner.config.frontend.kind == "mel" and "mel" in model.config.frontend.kind
        for setting in ("window_seconds", "frame_rate", "tapers"):  # which no shape shows
            assert getattr(encoder.frontend.config, setting) == getattr(start.config, setting)
        left_out = {*new, "rig"}
        if encoder.frontend.normalise is None:
            left_out.add("normalise")
        weights = {k: v for k, v in start.state_dict().items() if k.split(".")[0] not in left_out}
        missing, unexpected = encoder.frontend.load_state_dict(weights, strict=False)
        assert not unexpected and {key.split(".")[0] for key in missing} <= set(new)
    except (AssertionError, RuntimeError):
        raise ConfigError(
            f"train.start_encoder={name!r}: its encoder is built otherwise than model.frontend; "
            "copy the settings from its config.yaml, name what differs in train.start_new, or "
            "leave it out"
        ) from None


def validate_mesh(model: MeshModel, folder: MeshFolder) -> tuple[dict[str, float], list[ClipRows]]:
    """Vertex errors on the validation split, in mm, and the rows of its first clips.

    Parameters
    ----------
    model : SDFA or MeshHead
        Put to evaluation mode.
    folder : MeshFolder
        Its first `VALIDATION_CLIPS` clips of the split are used; of the training split where it
        has none.

    Returns
    -------
    scores : dict
        `mean_mm`, over all vertices and frames; `lively_mm`, over the lips' rims where they are
        known, else the twentieth of the vertices that moves most; `score`, minus the latter. A
        speaker that was not trained on gets the first style on his own template.
    rows : list of ClipRows
        Of `N_SHOWN` clips: the lips' gap (or the motion of those vertices) and `lively_mm` of
        every frame.
    """
    model.eval()
    clips = (folder.split("validation") or folder.split("train"))[:VALIDATION_CLIPS]
    means, livelies, rows = zip(*(_measure(model, folder, clip) for clip in clips), strict=True)
    lively = float(np.mean(livelies))
    scores = {"score": -lively, "mean_mm": float(np.mean(means)), "lively_mm": lively}
    return scores, list(rows[:N_SHOWN])


def _measure(model: MeshModel, folder: MeshFolder, clip: MeshClip) -> tuple[float, float, ClipRows]:
    """`mean_mm`, `lively_mm` and the rows of one clip."""
    style = clip.speaker if clip.speaker in model.speakers else 0
    template, waveform = folder.templates[clip.speaker], clip.waveform()
    offsets = folder.bases.offsets.expand(clip.motion()["offsets"])
    truth = template.vertices + offsets.reshape(len(offsets), -1, 3)
    if folder.lips is not None:
        lively = folder.lips.both
    else:
        motion = np.linalg.norm(truth - template.vertices, axis=-1).max(axis=0)
        lively = np.argsort(motion)[-max(len(motion) // 20, 1) :]
    acting = Acting.of(emotion=clip.emotion) if model.has_emotion else None
    predicted = predict_mesh(model, waveform, style, acting, template)
    n_frames = min(len(predicted), len(truth))
    truth, predicted = truth[:n_frames], predicted[:n_frames]
    error = np.linalg.norm(predicted - truth, axis=-1)  # (T, V)
    unit = folder.unit_mm

    def opening(vertices: AnyFloat) -> AnyFloat:
        if folder.lips is not None:
            return lip_gap(vertices, folder.lips, unit)
        moved = np.linalg.norm(vertices[:, lively] - template.vertices[lively], axis=-1)
        return np.asarray(unit * moved.mean(axis=1))

    label = "motion, mm" if folder.lips is None else "lip gap, mm"
    rows = (
        Row(label, opening(truth), opening(predicted)),
        Row("error, mm", None, unit * error[:, lively].mean(axis=1)),
    )
    shown = ClipRows(f"{clip.name} ({clip.speaker})", waveform, rows, folder.fps)
    return float(error.mean()) * unit, float(error[:, lively].mean()) * unit, shown


def new_mesh_model(
    config: SDFAModelConfig,
    layers: Mapping[str, InversePCA],
    templates: Mapping[str, TriMesh],
    *,
    fps: float,
    unit_mm: float,
) -> SDFA | MeshHead:
    """Build a mesh model of new weights; parameters as for `deitalk.models.mesh_model.MeshModel`.

    The DEITalk model that a mesh head decodes is loaded.

    Raises
    ------
    CheckpointError
        If that model cannot be loaded.
    ConfigError
        If `config` needs lips that the templates lack.
    """
    check_faces(config.seal_mm, templates.values())
    kind = MeshHead if config.frontend.kind == "deitalk" else SDFA
    encoder = new_encoder(config.frontend)
    return kind(config, encoder, layers, templates, fps=fps, unit_mm=unit_mm)
