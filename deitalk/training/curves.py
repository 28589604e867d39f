"""Training of DEITalk models, from windows of curves (DEITalk §4.1): the task of the trainer.

The loop is `deitalk.training.trainer`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn

from deitalk.audio.frames import FRAME_RATE
from deitalk.config.curves import Config
from deitalk.config.rig_file import read_controls
from deitalk.data.clips import Clip, read_clips, spread_clips
from deitalk.data.frozen_features import FrozenFeatures
from deitalk.data.seeded_batches import SeededBatches, Share
from deitalk.data.waveforms import read_waveform
from deitalk.data.windows import Window, WindowBatches, count_windows
from deitalk.errors import ConfigError
from deitalk.evaluation.clips_figure import ClipRows, Row
from deitalk.evaluation.smoothness import (
    Example,
    ValidationSet,
    lips_together,
    load_example,
    predict,
)
from deitalk.models.checkpoint import network_class, require_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import network_shapes
from deitalk.training.curve_losses import (
    CurveLoss,
    turn_to_the_past,
)
from deitalk.training.optimizer import new_optimizer
from deitalk.training.run_folder import record_data
from deitalk.training.trainer import Progress, Task, run_training, silent
from rig import ControlSet

N_SHOWN = 2
"""Validation clips that are drawn at every evaluation."""
JAW = "CTRL_C_jaw.ty"
MEASURED_CLIPS = 200
"""Training clips from which the mean and spread of an encoder's states are measured."""
LIMITS = (-0.05, 1.05)
"""Of the axes of a picture."""


def train_curves(
    config: Config,
    data: Path,
    out: Path,
    *,
    resume: bool = False,
    start_from: Path | None = None,
    track: Sequence[str] = (),
    frozen_features: FrozenFeatures | None = None,
    progress: Progress = silent,
    task: "type[CurveTask] | None" = None,
) -> dict[str, Any]:
    """Train a model of curves.

    Parameters
    ----------
    config : Config
        Model, loss, data and schedule.
    data : Path
        Dataset folder.
    out, resume, track, progress
        As for `deitalk.training.trainer.run_training`.
    start_from : Path or None
        Model folder whose weights are the start (fine-tuning).
    frozen_features : FrozenFeatures or None
        Those of ``train.frozen_frontend``, where several runs share them.
    task : type or None
        `CurveTask`, or a class of it with parts of its own.

    Returns
    -------
    dict
        Step and development scores of the best model.

    Raises
    ------
    DataError, MissingError, rig.errors.TargetError
        As `run_training`.
    ConfigError
        As `run_training`; and if `config` does not fit the weights to start from.
    """
    job = (task or CurveTask)(config, data, start_from=start_from, frozen_features=frozen_features)
    return run_training(job, out, resume=resume, track=track, progress=progress)


class CurveTask(Task[Window]):
    """DEITalk's network, windows of curves, and the loss of Eq. 8.

    Parameters
    ----------
    config, data, start_from, frozen_features
        As for `train_curves`.

    Raises
    ------
    DataError
        If the dataset folder is not as it must be.
    ConfigError
        If the network is too large.
    """

    config: Config
    model: DEITalk

    def __init__(
        self,
        config: Config,
        data: Path,
        *,
        start_from: Path | None = None,
        frozen_features: FrozenFeatures | None = None,
    ) -> None:
        self.config, self.data, self.start_from = config, data, start_from
        self.frozen_features = frozen_features
        self.controls = read_controls(config.model.control_set)
        network_shapes(self._network)  # not too large to be built
        self.clips = spread_clips(read_clips(data, "train"), config.data.clips)
        self.validation_clips = read_clips(data, "validation")

    def _network(self, pretrained: bool = False) -> DEITalk:
        config = self.config
        network = network_class(config.model)
        return network(config.model, self.controls, pretrained=pretrained, rules=config.rules)

    def new_model(self) -> DEITalk:
        """Make the model with the published weights that it starts from."""
        return self._network(pretrained=True)

    def build(self, device: torch.device) -> None:
        """Build the model with the weights it starts from, and the validation clips."""
        config, settings = self.config, self.config.train
        self.model = self.new_model()
        if self.start_from is not None:
            _copy_weights(self.model, self.start_from)
        elif self.model.frontend.layers:
            sounds = [
                read_waveform(clip.audio) for clip in spread_clips(self.clips, MEASURED_CLIPS)
            ]
            self.model.frontend.measure(sounds)
        if settings.frozen_frontend is not None:
            self.frozen_features = self.frozen_features or FrozenFeatures(settings.frozen_frontend)
            self.frozen_features.copy_into(self.model)
        controls = self.controls
        self._loss = CurveLoss(config.loss, controls, device)
        self.validation = ValidationSet.of(self.validation_clips, controls)
        self.shown = shown_examples(self.validation_clips, controls)

    def read(self, out: Path) -> None:
        """Check that a resumed run has its own data; remember where features are kept."""
        record_data(out, self.data)
        self.out = out

    def epoch_size(self) -> int:
        """All windows of all clips."""
        return count_windows(self.clips, self.config.data)

    def optimizer(self) -> torch.optim.Optimizer:
        """Adam or AdamW."""
        return new_optimizer(self.model, self.config.train)

    def batches(self, share: Share) -> SeededBatches[Window]:
        """Windows of the training clips."""
        settings = self.config.train
        return WindowBatches(
            self.clips,
            self.controls,
            self.config.data,
            settings.seed,
            settings.batch_size,
            share,
            frozen_features=self.frozen_features,
        )

    def loss(self, network: nn.Module, batch: Window) -> dict[str, Tensor]:
        """Every part of the loss, and their weighted sum (Eq. 8)."""
        return self._loss(network, batch)

    def set_training(self) -> None:
        """Put the model in training mode, but for a frontend that does not learn."""
        self.model.train()
        if self.config.train.frozen_frontend is not None:
            self.model.get_submodule("frontend").eval()

    def validate(self, model: nn.Module) -> tuple[dict[str, float], list[ClipRows]]:
        """Scores of `ValidationSet`, and the clips that are drawn."""
        curve_model = cast("DEITalk", model)
        scores = self.validation.score(curve_model)
        return scores, [clip_rows(name, e, curve_model) for name, e in self.shown.items()]

    def save(self, folder: Path, model: nn.Module, summary: dict[str, Any]) -> None:
        """Write a model folder."""
        save_model(folder, cast("DEITalk", model), self.config, summary)


def _copy_weights(model: DEITalk, folder: Path) -> None:
    start = require_model(folder, DEITalk)
    try:
        model.load_state_dict(start.state_dict())
    except RuntimeError:
        raise ConfigError(
            f"{folder}: its weights do not fit the configuration's model; begin with "
            f"{folder / 'config.yaml'}"
        ) from None
    if model.is_causal and not start.is_causal:
        turn_to_the_past(model.decoder)


def shown_examples(clips: Sequence[Clip], controls: ControlSet) -> dict[str, Example]:
    """Load the first and the last clip, of the recorded ones where there are any, by name."""
    chosen = [clip for clip in clips if clip.source == "recording"] or list(clips)
    places = np.unique(np.linspace(0, len(chosen) - 1, min(N_SHOWN, len(chosen))).astype(int))
    return {chosen[i].name: load_example(chosen[i], controls) for i in places}


def clip_rows(name: str, example: Example, model: DEITalk) -> ClipRows:
    """Jaw, lips and intensity of a clip: the targets, and what a model predicts.

    Of a rig other than the board, the three controls that move most.

    Parameters
    ----------
    name : str
        Of the clip.
    example : Example
        The targets.
    model : DEITalk
        In evaluation mode.
    """
    curves, intensity = predict(model, example)
    if JAW not in model.controls.names:
        places = np.argsort(-example.curves.std(axis=0), kind="stable")[:3]
        most = [
            Row(model.controls.names[i], example.curves[:, i], curves[:, i], LIMITS) for i in places
        ]
        return ClipRows(f"{name} ({example.emotion})", example.waveform, most, FRAME_RATE)
    jaw = model.controls.index(JAW)
    target, predicted = (lips_together(c, model.controls) for c in (example.curves, curves))
    rows = (
        Row("jaw", example.curves[:, jaw], curves[:, jaw], LIMITS),
        Row("lips together", target, predicted, LIMITS),
        Row("intensity", example.intensity, intensity, LIMITS),
    )
    return ClipRows(f"{name} ({example.emotion})", example.waveform, rows, FRAME_RATE)
