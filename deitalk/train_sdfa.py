"""Training of SDFA: mesh sequences in, a model folder out (SDFA §4). ``deitalk train sdfa.yaml``.

The main path is `train_sdfa`, then `_fit`, then `_step`. The run folder is that of
`deitalk.run_folder`, with the bases and, where the data had to be built, ``meshes/`` beside them.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.data import DataLoader

from deitalk.checkpoint import describe_model
from deitalk.config import SDFAConfig
from deitalk.data.mesh_folder import MeshFolder
from deitalk.data.mesh_sources import open_meshes
from deitalk.data.mesh_windows import MeshBatches, MeshPair, fit_mesh_bases
from deitalk.deformation_decoder import Deformation, frozen_layers
from deitalk.errors import DataError
from deitalk.mesh_checkpoint import save_sdfa
from deitalk.mesh_losses import AutomaticWeights, mesh_terms
from deitalk.run_folder import forget, log, open_folder, restore_state, save_state
from deitalk.sdfa import SDFA
from rig.mesh import read_bases, write_bases

LOG_EVERY = 25
DEVELOPMENT_CLIPS = 8
MAX_BAD_STEPS = 20

Progress = Callable[[int, int, dict[str, float]], None]


@dataclass
class MeshRun:
    """What changes while training."""

    model: SDFA
    balance: AutomaticWeights
    optimizer: torch.optim.Optimizer
    total: int
    """Steps of the whole run."""
    step: int = 0
    best_score: float = -math.inf
    bad_steps: int = 0

    @property
    def parts(self) -> dict[str, Any]:
        """What ``state.pt`` keeps."""
        return {name: getattr(self, name) for name in ("model", "balance", "optimizer")}


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
        Run folder; must be new unless `resume`.
    resume : bool
        Go on from the run folder's ``state.pt``.
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
        If `config` differs from the run that is resumed.
    """
    open_folder(out, config, resume=resume, write=True)
    folder = open_meshes(data, config.data, out / "meshes")
    torch.manual_seed(config.train.seed)
    run, batches = _start(config, folder, out)
    if resume:
        state = restore_state(out, run.parts)
        run.step, run.best_score = int(state["step"]), float(state["best_score"])
        for name in ("metrics.csv", "development.csv"):
            forget(out / name, run.step)
        batches.skip = run.step
    progress(run.step, run.total, {})
    _fit(run, batches, folder, config, out, progress)
    return dict(describe_model(out / "best")["training"])


def _start(config: SDFAConfig, folder: MeshFolder, out: Path) -> tuple[MeshRun, MeshBatches]:
    settings, speakers = config.train, folder.training_speakers
    batches = MeshBatches(
        folder.split("train"),
        speakers,
        folder.fps,
        config.model.frontend,
        n_pairs=settings.batch_size // 2,
        augment=config.data.augment,
        seed=settings.seed,
    )
    bases_file = out / "bases.npz"
    if not bases_file.is_file():
        bases = fit_mesh_bases(folder, config.data, settings.seed)
        write_bases(bases_file, bases)
        for step, row in enumerate(bases.table):
            log(out / "bases.csv", step, row)
    layers = frozen_layers(read_bases(bases_file))
    templates = {speaker: folder.templates[speaker] for speaker in speakers}
    model = SDFA(
        config.model, layers, speakers, templates, fps=folder.fps, unit_mm=folder.unit_mm
    ).to("cuda" if torch.cuda.is_available() else "cpu")
    optimizer = torch.optim.Adam(model.parameters(), lr=settings.learning_rate)
    balance = AutomaticWeights(decay=settings.loss_decay)
    total = settings.steps or math.ceil(settings.epochs * batches.n_frames / settings.batch_size)
    return MeshRun(model, balance, optimizer, total), batches


def _fit(
    run: MeshRun,
    batches: MeshBatches,
    folder: MeshFolder,
    config: SDFAConfig,
    out: Path,
    progress: Progress,
) -> None:
    loader = DataLoader(batches, batch_size=None, num_workers=config.train.workers)
    device = next(run.model.parameters()).device
    pairs: Iterator[MeshPair] = iter(loader if run.step < run.total else ())
    while run.step < run.total:
        batch = MeshPair(*(part.to(device) for part in next(pairs)))
        torch.manual_seed(config.train.seed * 2**20 + run.step)
        values = _step(run, batch, config)
        run.step += 1
        is_last = run.step == run.total
        if run.step % LOG_EVERY == 0 or is_last:
            log(out / "metrics.csv", run.step, values)
            progress(run.step, run.total, values)
        if run.step % config.train.evaluate_every == 0 or is_last:
            _evaluate(run, folder, config, out)


def _step(run: MeshRun, batch: MeshPair, config: SDFAConfig) -> dict[str, float]:
    """One update; a batch whose gradient is not finite is left out."""
    run.model.train()
    speakers = batch.speaker.repeat_interleave(2, dim=0)  # (2 M, P)
    s, r = run.model(batch.mel.flatten(0, 1), speakers)
    predicted = Deformation(s.view_as(batch.s), r.view_as(batch.r))
    decoder = run.model.decoder
    weights = decoder.stretch.inverse_pca.weights, decoder.rotation.inverse_pca.weights
    parts = mesh_terms(predicted, Deformation(batch.s, batch.r), weights)
    total = run.balance(parts)
    run.optimizer.zero_grad(set_to_none=True)
    total.backward()
    limit = config.train.gradient_clip or math.inf
    norm = float(torch.nn.utils.clip_grad_norm_(run.model.parameters(), limit))
    if math.isfinite(norm):
        run.optimizer.step()
        run.bad_steps = 0
    else:
        run.bad_steps += 1
    if run.bad_steps >= MAX_BAD_STEPS:
        raise DataError(
            f"step {run.step}: {run.bad_steps} gradients in a row are not finite; lower "
            "train.learning_rate or set train.gradient_clip"
        )
    values = {name: float(part.detach()) for name, part in parts.items()}
    return values | {"total": float(total.detach()), "gradient_norm": norm}


def _evaluate(run: MeshRun, folder: MeshFolder, config: SDFAConfig, out: Path) -> None:
    """Score held-out sequences, keep the weights if none were better, and save the state."""
    scores = mesh_scores(run.model, folder)
    log(out / "development.csv", run.step, {f"dev_{k}": v for k, v in scores.items()})
    summary = {"step": run.step, "development": scores}
    if scores["score"] >= run.best_score:
        run.best_score = scores["score"]
        save_sdfa(out / "best", run.model, config, summary)
    save_sdfa(out / "last", run.model, config, summary)
    save_state(out, run.parts, {"step": run.step, "best_score": run.best_score})


def mesh_scores(model: SDFA, folder: MeshFolder, split: str = "validation") -> dict[str, float]:
    """Vertex errors on a split, in mm.

    Parameters
    ----------
    model : SDFA
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
        that moves most; `score`, minus the latter. A speaker that was not trained on is heard in
        the first style and seen on his own template.
    """
    model.eval()
    everywhere, lively = [], []
    for clip in (folder.split(split) or folder.split("train"))[:DEVELOPMENT_CLIPS]:
        style = clip.speaker if clip.speaker in model.speakers else 0
        template = folder.templates[clip.speaker]
        truth_s, truth_r = (torch.from_numpy(np.array(rows)) for rows in clip.gradients())
        s, r = model.predict(clip.waveform(), style)
        n = min(len(s), len(truth_s))
        truth = model.vertices(truth_s[:n], truth_r[:n], template)
        error = np.linalg.norm(model.vertices(s[:n], r[:n], template) - truth, axis=-1)
        motion = np.linalg.norm(truth - template.vertices, axis=-1).max(axis=0)
        most = np.argsort(motion)[-max(len(motion) // 20, 1) :]
        everywhere.append(float(error.mean()) * folder.unit_mm)
        lively.append(float(error[:, most].mean()) * folder.unit_mm)
    return {
        "score": -float(np.mean(lively)),
        "mean_mm": float(np.mean(everywhere)),
        "lively_mm": float(np.mean(lively)),
    }
