"""Training of mesh models: sequences in, a model folder out (SDFA §4). ``deitalk train sdfa.yaml``.

The main path is `train_sdfa`, then `_fit`, then `_step`. The run folder is that of
`deitalk.training.run_folder`, with ``meshes/`` beside it where the data had to be built.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader

from deitalk.config import MeshTrainConfig, SDFAConfig
from deitalk.data.mesh_bases import MeshBases
from deitalk.data.mesh_features import FeatureSegments
from deitalk.data.mesh_folder import MeshFolder
from deitalk.data.mesh_segments import Segment, SegmentBatches, Segments
from deitalk.data.mesh_sources import knows_lips, open_meshes
from deitalk.emotions import Direction
from deitalk.errors import ConfigError
from deitalk.frontends.mel_bilstm import MelFrontend
from deitalk.frontends.sdfa import SDFAEncoder
from deitalk.models.checkpoint import new_encoder, new_mesh_model, require_model, save_model
from deitalk.models.curve_features import DEITalkFeatures
from deitalk.models.curve_model import DEITalk
from deitalk.models.deformation_decoder import InversePCA
from deitalk.models.folder import describe_model
from deitalk.models.mesh_head import MeshHead
from deitalk.models.mesh_model import MeshModel
from deitalk.pipeline.mesh import predict_mesh
from deitalk.training.lip_regression import LipRegression
from deitalk.training.mesh_losses import LIPS, AutomaticWeights, lip_loss, motion_terms, term_names
from deitalk.training.run_folder import open_folder, resume_run, save_checkpoints
from deitalk.training.run_tables import log
from deitalk.training.update import update
from deitalk.workers import end_with_parent

LOG_EVERY = 25
DEVELOPMENT_CLIPS = 8
STARTED_RATE = 1 / 3
"""Share of the learning rate that an encoder learns at which has learnt before."""

Progress = Callable[[int, int, dict[str, float]], None]


@dataclass
class MeshRun:
    """What changes while training."""

    model: MeshModel
    average: MeshModel
    balance: AutomaticWeights
    optimizer: torch.optim.Optimizer
    scheduler: torch.optim.lr_scheduler.LRScheduler
    total: int
    """Steps of the whole run."""
    step: int = 0
    best_score: float = -math.inf
    bad_steps: int = 0

    @cached_property
    def frozen(self) -> frozenset[str]:
        """Names of the bases, which are half of the weights and do not change."""
        return frozenset(name for name in self.model.state_dict() if ".inverse_pca." in name)

    @property
    def parts(self) -> dict[str, Any]:
        """What ``state.pt`` keeps."""
        names = ("model", "average", "balance", "optimizer", "scheduler")
        return {name: getattr(self, name) for name in names}


def train_sdfa(
    config: SDFAConfig,
    data: Path,
    out: Path,
    *,
    resume: bool = False,
    progress: Progress = lambda step, total, values: None,
) -> dict[str, Any]:
    """Train a model on one device.

    Parameters
    ----------
    config : SDFAConfig
        Model, data and schedule.
    data : Path
        A mesh folder, a folder laid out as VOCASET, or a dataset folder whose curves the embedded
        heads act (`deitalk.data.mesh_sources`).
    out : Path
        Run folder; new or empty unless `resume`.
    resume : bool
        Go on from the run folder's ``state.pt``; where there is none yet the run begins.
    progress : callable
        Told the step, the number of steps and the values that were logged.

    Returns
    -------
    dict
        Step and development scores of the best model.

    Raises
    ------
    DataError
        If the data or the run folder is not as it must be, or gradients stay not finite.
    ConfigError
        If `config` differs from the run that is resumed, or asks for lips the data lacks.
    rig.errors.TargetError
        If the run folder holds what no run wrote, or edited files, or is in use.
    """
    with open_folder(out, config, resume=resume):
        return _train(config, data, out, resume, progress)


def _train(
    config: SDFAConfig, data: Path, out: Path, resume: bool, progress: Progress
) -> dict[str, Any]:
    """Train in a run folder that is open."""
    if config.train.lip_weight and not knows_lips(data, out / "meshes"):
        raise ConfigError(
            f"train.lip_weight={config.train.lip_weight:g}: {data} does not say where the lips "
            "are; set train.lip_weight=0"
        )
    folder = open_meshes(data, config.data, out / "meshes")
    torch.manual_seed(config.train.seed)
    model = _new_model(config, folder)
    if config.train.start_encoder is not None:
        _copy_encoder(model, config.train.start_encoder, config.train.start_new)
    segments = _segments(config, folder, model)
    if isinstance(segments, FeatureSegments):
        cast("DEITalkFeatures", model.encoder).fit(segments.rows)
    total = _n_steps(config.train, segments)
    run = _start(config, model, _new_model(config, folder), total)
    if resume:
        run.step, run.best_score = resume_run(out, run.parts, truncate_logs=True)
        segments.skip = run.step
    progress(run.step, run.total, {})
    loss = MeshLoss(config, folder, segments).to(run.model.device)
    _fit(run, loss, segments, folder, config, out, progress)
    return dict(describe_model(out / "best")["training"])


def frozen_layers(bases: MeshBases, motion: str) -> dict[str, InversePCA]:
    """The last layers of what a model predicts: ``gradients`` or ``offsets``."""
    names = ("offsets",) if motion == "offsets" else ("stretch", "rotation")
    return {name: InversePCA.of(getattr(bases, name)) for name in names}


def _new_model(config: SDFAConfig, folder: MeshFolder) -> MeshModel:
    speakers = folder.training_speakers
    return new_mesh_model(
        config.model,
        frozen_layers(folder.bases, config.model.motion),
        {speaker: folder.templates[speaker] for speaker in speakers},
        fps=folder.fps,
        unit_mm=folder.unit_mm,
    ).to("cuda" if torch.cuda.is_available() else "cpu")


def _copy_encoder(model: MeshModel, name: str, new: Sequence[str]) -> None:
    """Copy an encoder but for its `new` parts; what SDFA's lacks (`centre`, `rig`) is left out."""
    encoder = model.encoder
    start = require_model(name, DEITalk).frontend
    try:
        assert isinstance(encoder, SDFAEncoder) and isinstance(start, MelFrontend)
        left_out = {*new, "rig"}
        if encoder.frontend.normalise is None:
            left_out.add("normalise")
        weights = {k: v for k, v in start.state_dict().items() if k.split(".")[0] not in left_out}
        missing, unexpected = encoder.frontend.load_state_dict(weights, strict=False)
        assert not unexpected and {key.split(".")[0] for key in missing} <= set(new)
    except (AssertionError, RuntimeError):
        raise ConfigError(
            f"train.start_encoder={name!r}: its encoder is not of model.frontend's sizes; copy "
            "them from its config.yaml, name what differs in train.start_new, or leave it out"
        ) from None


def _segments(config: SDFAConfig, folder: MeshFolder, model: MeshModel) -> SegmentBatches:
    settings, clips = config.train, folder.split("train")
    drawing = {
        "n_segments": settings.batch_size // settings.segment_frames,
        "n_frames": settings.segment_frames,
        "seed": settings.seed,
    }
    encoder = new_encoder(config.model.frontend)  # of its own: spectra are cut on the CPU
    if isinstance(encoder, DEITalkFeatures):
        return FeatureSegments(clips, model.speakers, encoder, **drawing)
    augment = config.data.augment
    return Segments(clips, model.speakers, folder.fps, encoder, augment=augment, **drawing)


def _n_steps(settings: MeshTrainConfig, segments: SegmentBatches) -> int:
    if settings.steps is not None:
        return settings.steps
    return max(math.ceil(settings.epochs * segments.n_frames_total / settings.batch_size), 1)


def _start(config: SDFAConfig, model: MeshModel, average: MeshModel, total: int) -> MeshRun:
    settings = config.train
    branches = list(model.decoder.deviations)
    names = term_names(branches, lips=settings.lip_weight > 0)
    balance = AutomaticWeights(names, decay=settings.loss_decay)
    groups = (
        (model.encoder, 1.0 if settings.start_encoder is None else STARTED_RATE),
        (model.decoder, 1.0),
    )
    rates = [settings.learning_rate * share for _, share in groups]
    optimizer = torch.optim.Adam(
        [
            {"params": list(part.parameters()), "lr": rate}
            for (part, _), rate in zip(groups, rates, strict=True)
        ]
    )
    scheduler: torch.optim.lr_scheduler.LRScheduler
    if settings.schedule == "one_cycle":
        scheduler = torch.optim.lr_scheduler.OneCycleLR(
            optimizer,
            rates,
            total_steps=total + 1,
            pct_start=0.08,
            cycle_momentum=False,
            div_factor=10,
            final_div_factor=100,
        )
    else:
        scheduler = torch.optim.lr_scheduler.ConstantLR(optimizer, factor=1.0)
    average.load_state_dict(model.state_dict())
    average.eval().requires_grad_(False)
    return MeshRun(model, average, balance, optimizer, scheduler, total)


class MeshLoss(torch.nn.Module):
    """The terms of §4.2, and the lips where they are asked for."""

    def __init__(self, config: SDFAConfig, folder: MeshFolder, segments: SegmentBatches) -> None:
        super().__init__()
        self.precision = config.train.precision
        self.places = segments.places
        self.lips: LipRegression | None = None
        if config.train.lip_weight:
            self.lips = LipRegression.fit(
                [(clip.motion, clip.speaker) for clip in segments.clips],
                folder,
                motion=config.model.motion,
            )

    def forward(self, model: MeshModel, batch: Segment) -> dict[str, Tensor]:
        """Every term of one batch, not yet scaled."""
        device = batch.features.device
        with torch.autocast(device.type, torch.bfloat16, enabled=self.precision == "bfloat16"):
            rows = model(batch.features, self.places.to(device), batch.speaker)
        rows = {name: row.float() for name, row in rows.items()}
        target = {name: getattr(batch, name) for name in rows}
        parts = motion_terms(rows, target, model.decoder.deviations)
        if self.lips is not None:
            given = self.lips(rows, batch.speaker)
            wanted = batch.lips * model.unit_mm
            parts[LIPS] = lip_loss(given, wanted, self.lips.rest_parting(batch.speaker))
        return parts


def _fit(
    run: MeshRun,
    loss: MeshLoss,
    segments: SegmentBatches,
    folder: MeshFolder,
    config: SDFAConfig,
    out: Path,
    progress: Progress,
) -> None:
    loader = DataLoader(
        segments, batch_size=None, num_workers=config.train.workers, worker_init_fn=end_with_parent
    )
    batches: Iterator[Segment] = iter(loader if run.step < run.total else ())
    while run.step < run.total:
        batch = Segment(*(part.to(run.model.device) for part in next(batches)))
        torch.manual_seed(config.train.seed * 2**20 + run.step)
        values = _step(run, loss, batch, config.train)
        run.step += 1
        is_last = run.step == run.total
        if run.step % LOG_EVERY == 0 or is_last:
            log(out / "metrics.csv", run.step, values)
            progress(run.step, run.total, values)
        if run.step % config.train.evaluate_every == 0 or is_last:
            progress(run.step, run.total, _evaluate(run, folder, config, out))


def _step(
    run: MeshRun, loss: MeshLoss, batch: Segment, settings: MeshTrainConfig
) -> dict[str, float]:
    """One update; a batch whose gradient is not finite is left out."""
    run.model.train()
    parts = loss(run.model, batch)
    total = run.balance(parts, {LIPS: settings.lip_weight})
    run.optimizer.zero_grad(set_to_none=True)
    total.backward()
    limit = settings.gradient_clip or math.inf
    norm = float(torch.nn.utils.clip_grad_norm_(run.model.parameters(), limit))
    update(run, norm, settings.ema, run.frozen)
    values = {name: float(part.detach()) for name, part in parts.items()}
    rate = float(run.scheduler.get_last_lr()[-1])
    return values | {"total": float(total.detach()), "gradient_norm": norm, "learning_rate": rate}


def _evaluate(run: MeshRun, folder: MeshFolder, config: SDFAConfig, out: Path) -> dict[str, float]:
    """Score the averaged weights, keep them if none were better, and save the state."""
    scores = mesh_scores(run.average, folder)
    named = {f"dev_{k}": v for k, v in scores.items()}
    log(out / "development.csv", run.step, named)
    run.best_score = save_checkpoints(
        out,
        run.parts,
        run.step,
        scores,
        run.best_score,
        lambda folder, summary: save_model(folder, run.average, config, summary),
    )
    return named


def mesh_scores(
    model: MeshModel, folder: MeshFolder, split: str = "validation"
) -> dict[str, float]:
    """Vertex errors on a split, in mm.

    Parameters
    ----------
    model : SDFA or MeshHead
        Put to evaluation mode.
    folder : MeshFolder
        Its first `DEVELOPMENT_CLIPS` clips of the split are heard; of the training split where it
        has none.
    split : str
        Which.

    Returns
    -------
    dict
        `mean_mm`, over all vertices and frames; `lively_mm`, over the twentieth of the vertices
        that moves most, or the lips' rims where they are known; `score`, minus the latter. A
        speaker that was not trained on is heard in the first style and seen on his own template.
    """
    model.eval()
    everywhere, lively = [], []
    for clip in (folder.split(split) or folder.split("train"))[:DEVELOPMENT_CLIPS]:
        style = clip.speaker if clip.speaker in model.speakers else 0
        template = folder.templates[clip.speaker]
        offsets = folder.bases.offsets.expand(clip.motion()["offsets"])
        truth = template.vertices + offsets.reshape(len(offsets), -1, 3)
        direction = Direction.of(clip.emotion) if isinstance(model, MeshHead) else None
        given = predict_mesh(model, clip.waveform(), style, direction, template)
        n = min(len(given), len(truth))
        error = np.linalg.norm(given[:n] - truth[:n], axis=-1)
        if folder.lips is not None:
            most = folder.lips.both
        else:
            motion = np.linalg.norm(truth - template.vertices, axis=-1).max(axis=0)
            most = np.argsort(motion)[-max(len(motion) // 20, 1) :]
        everywhere.append(float(error.mean()) * folder.unit_mm)
        lively.append(float(error[:, most].mean()) * folder.unit_mm)
    return {
        "score": -float(np.mean(lively)),
        "mean_mm": float(np.mean(everywhere)),
        "lively_mm": float(np.mean(lively)),
    }
