"""Training of curve models from windows of curves (DEITalk §4.1), with what ours have beside.

The task of `python -m deitalk.research train`: its windows may be of measured lips, or of
sound that was encoded before, its loss may have a teacher. The loop is `deitalk.training.trainer`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from torch import Tensor, nn

from deitalk.data.clips import MEASURED, Clip, read_clips, spread_clips
from deitalk.data.frozen_features import FrozenFeatures
from deitalk.data.seeded_batches import SeededBatches, Share
from deitalk.data.waveforms import read_waveform
from deitalk.data.windows import Window, WindowBatches
from deitalk.errors import ConfigError
from deitalk.models.checkpoint import require_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.temporal_conv import TemporalConv
from deitalk.research.comparison.emotalk import EmoTalk
from deitalk.research.config import TrainingConfig, TrainingDataConfig, TrainingLossConfig
from deitalk.research.lips.losses import LipLoss
from deitalk.research.training.curve_losses import across_processes, contact_loss, control_weights
from deitalk.research.training.distillation import Teacher, read_teacher
from deitalk.research.training.encoded_passes import EncodedPasses
from deitalk.research.training.pictures import DrawsClips, clip_rows, shown_examples
from deitalk.research.training.surroundings import read_surroundings
from deitalk.research.training.validation import ValidationSet
from deitalk.training.curve_losses import CurveLoss, start_as
from deitalk.training.curves import CurveTask
from deitalk.training.optimizer import new_optimizer
from deitalk.training.trainer import Progress, run_training, silent
from rig import ControlSet
from rig.arrays import Float32
from rig.controls import DEFAULT_ID

MEASURED_CLIPS = 200
"""Training clips from which the mean and spread of an encoder's states are measured."""
STARTED_SLOWER = 3
"""Weights that begin as the teacher's learn at a rate so many times lower."""


class TaughtWindow(NamedTuple):
    """A `Window`, and its sound before augmentation."""

    waveform: Tensor
    curves: Tensor
    emotion: Tensor
    voice: Tensor
    intensity: Tensor
    frames: Tensor
    total: Tensor
    known: Tensor
    clean: Tensor
    """The waveform before augmentation [shape=(S,)]; without a teacher [shape=(0,)]."""


class TrainingWindows(WindowBatches):
    """Windows of sound beside their clean sound, or of the features of a random pass.

    Clips with measured lips are drawn by `TrainingDataConfig.measured_fraction`, their speakers
    alike.

    Parameters
    ----------
    *given, **options
        As for `WindowBatches`.
    encoded : EncodedPasses or None
        Windows carry features of a random pass instead of the sound.
    clean : bool
        Windows carry the sound before augmentation too.
    """

    config: TrainingDataConfig

    def __init__(
        self,
        *given: Any,
        encoded: EncodedPasses | None = None,
        clean: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(*given, **options)
        self.encoded, self.clean = encoded, clean
        if encoded is not None:
            self.frozen_features = None
        self.needs_sound = clean or self.frozen_features is None
        self.cache.sound = self.needs_sound
        self._turn, self._clean = 0, np.zeros(0, np.float32)
        # Measured clips by speaker, if they have a share of their own.
        self.measured: list[list[Clip]] = []
        others = [clip for clip in self.clips if clip.source != MEASURED]
        if self.config.measured_fraction is not None and others:
            speakers: dict[str, list[Clip]] = {}
            for clip in self.clips:
                if clip.source == MEASURED:
                    speakers.setdefault(clip.speaker, []).append(clip)
            self.measured = list(speakers.values())
            self.draw_from(others)

    def _draw(self, rng: np.random.Generator) -> Clip:
        if self.measured and rng.random() < (self.config.measured_fraction or 0.0):
            clips = self.measured[rng.integers(len(self.measured))]
            return clips[rng.integers(len(clips))]
        return super()._draw(rng)

    def item(self, number: int) -> Any:
        """Cut the window of a number."""
        window = super().item(number)
        return TaughtWindow(*window, torch.from_numpy(self._clean))

    def speed(self, rng: np.random.Generator, clip: Clip) -> float:
        """Return the speed of a window, or of the pass that is drawn."""
        speed = super().speed(rng, clip)
        if self.encoded is None:
            return speed
        self._turn = int(rng.integers(len(self.encoded.rows)))
        return self.encoded.speed(self._turn, clip.audio)

    def sound(
        self, rng: np.random.Generator, clip: Clip, waveform: Float32, first: int, total: int
    ) -> Float32:
        """Return what a window carries of a sound."""
        self._clean = waveform if self.clean else waveform[:0]
        if self.encoded is None:
            return super().sound(rng, clip, waveform, first, total)
        rows = self.encoded.window(self._turn, clip.audio, first, self.config.window_frames)
        return rows.astype(np.float32)


class TrainingLoss(CurveLoss):
    """The loss with lips of the embedded head and a teacher.

    Parameters
    ----------
    config : TrainingLossConfig
        Weights of the parts.
    controls : ControlSet
        Columns of the curves.
    device : torch.device
        Where batches are.
    teacher : Teacher or None
        Whose features are a second target.

    Raises
    ------
    ConfigError
        If a control weight's name is unknown; if `config.lips` or `config.range` is set for a rig
        other than the board.
    """

    config: TrainingLossConfig

    def __init__(
        self,
        config: TrainingLossConfig,
        controls: ControlSet,
        device: torch.device,
        teacher: Teacher | None = None,
    ) -> None:
        super().__init__(config)
        self.teacher, self.lips = teacher, None
        self.control_weights = control_weights(config.control_weights, controls).to(device)
        self.contact = torch.tensor(
            [i for i, name in enumerate(controls.names) if "lipsTogether" in name], device=device
        )
        if config.lips or config.range:
            if controls.id != DEFAULT_ID:
                raise ConfigError(
                    "loss.lips, loss.range: the embedded head has the board's controls only; set 0"
                )
            self.lips = LipLoss(bool(config.range), device)

    def weights(self, known: Tensor) -> Tensor:
        """Weight of every control in Eq. 12-13, by its name too."""
        return super().weights(known) * self.control_weights

    def __call__(
        self, network: nn.Module, batch: Any, motion: Tensor | None = None
    ) -> dict[str, Tensor]:
        """Every part of the loss of one batch, and their weighted sum as ``total``."""
        curves = batch.curves if self.config.contrast else None
        given = batch.waveform, batch.emotion, batch.frames, batch.total, curves
        known, model = batch.known, getattr(network, "module", network)
        if isinstance(model, EmoTalk):
            output, found = network(*given, batch.voice)
            known = known * found[:, None]
        else:
            output = network(*given)
        parts = self.parts(across_processes(output), batch, known)
        if self.config.contact and len(self.contact):
            parts["contact"] = contact_loss(
                batch.curves[..., self.contact],
                output.curves[..., self.contact],
                known[:, self.contact],
            )
            parts["total"] = parts["total"] + self.config.contact * parts["contact"]
        if self.lips is not None:
            predicted = torch.where(known[:, None] > 0, output.curves, batch.curves)
            for name, part in self.lips(batch.curves, predicted).items():
                parts[name] = part
                parts["total"] = parts["total"] + getattr(self.config, name) * part
        if self.teacher is not None:
            distance = self.teacher.distance(batch.clean, output.speech)
            parts["distillation"] = distance
            parts["total"] = parts["total"] + self.config.distillation * distance
        return parts


class TrainingTask(DrawsClips, CurveTask):
    """Training from the start: DEITalk's network, windows of curves, and the loss of Eq. 8.

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

    config: TrainingConfig
    encoded: EncodedPasses | None = None
    teacher: DEITalk | None = None

    def __init__(
        self,
        config: TrainingConfig,
        data: Path,
        *,
        start_from: Path | None = None,
        frozen_features: FrozenFeatures | None = None,
    ) -> None:
        super().__init__(config, data, frozen_features=frozen_features)
        self.start_from = start_from
        self.clips = spread_clips(read_clips(data, "train"), config.data.clips)
        self.validation_clips = read_clips(data, "validation")

    def read(self, out: Path) -> None:
        """Check that a resumed run has its own data; remember where features are kept."""
        super().read(out)
        self.out = out

    def build(self, device: torch.device) -> None:
        """Build the model with the weights it starts from, its teacher and the validation clips."""
        config, settings = self.config, self.config.train
        self.model = self._network(pretrained=True)
        if settings.teacher is not None:
            self.teacher = read_teacher(settings.teacher, self.model)
            start_as(self.model, self.teacher)
            if self.model.is_causal and not self.teacher.is_causal:
                turn_to_the_past(self.model.decoder)
        if self.start_from is not None:
            _copy_weights(self.model, self.start_from)
        elif self.model.frontend.layers:
            chosen = spread_clips(self.clips, MEASURED_CLIPS)
            self.model.frontend.measure([read_waveform(clip.audio) for clip in chosen])
        if settings.frozen_frontend is not None:
            self.frozen_features = self.frozen_features or FrozenFeatures(settings.frozen_frontend)
            _copy_frontend(self.model, self.frozen_features.owner, settings.frozen_frontend)
        self.surroundings = read_surroundings(config.data.noise_folder, config.data.room_folder)
        self.validation = ValidationSet.of(self.validation_clips, self.controls)
        self.shown = shown_examples(self.validation_clips, self.controls)
        taught = None
        if self.teacher is not None:
            taught = Teacher(self.teacher, device, settings.precision)
        self._loss = TrainingLoss(config.loss, self.controls, device, taught)
        if config.data.encoded_passes:
            self.encoded = EncodedPasses.write(
                self.out / "features",
                list(dict.fromkeys(clip.audio for clip in self.clips)),
                read_waveform,
                self.model.eval().frontend,
                self.surroundings,
                passes=config.data.encoded_passes,
                seed=settings.seed,
            )

    def optimizer(self) -> torch.optim.Optimizer:
        """Adam or AdamW; with a teacher, all behind the frontend learns `STARTED_SLOWER`."""
        settings = self.config.train

        def factor(name: str) -> float:
            is_started = settings.teacher is not None and not name.startswith("frontend.")
            return 1 / STARTED_SLOWER if is_started else 1

        return new_optimizer(self.model, settings, factor)

    def batches(self, share: Share) -> SeededBatches[Window]:
        """Windows of the training clips."""
        settings = self.config.train
        return TrainingWindows(
            self.clips,
            self.controls,
            self.config.data,
            settings.seed,
            settings.batch_size,
            share,
            frozen_features=self.frozen_features,
            encoded=self.encoded,
            clean=settings.teacher is not None,
            surroundings=self.surroundings,
        )

    def set_training(self) -> None:
        """Put the model in training mode, but for a frontend that does not learn."""
        self.model.train()
        if self.config.train.frozen_frontend is not None or self.encoded is not None:
            self.model.get_submodule("frontend").eval()

    def loss(self, network: nn.Module, batch: Window) -> dict[str, Tensor]:
        """Every part of the loss, and their weighted sum (Eq. 8)."""
        return self._loss(network, batch)

    def validate(self, model: nn.Module) -> dict[str, float]:
        """Scores of `ValidationSet`."""
        curve_model = cast("DEITalk", model)
        self.rows = [clip_rows(name, e, curve_model) for name, e in self.shown.items()]
        return self.validation.score(curve_model)

    def save(self, folder: Path, model: nn.Module, summary: dict[str, Any]) -> None:
        """Write a model folder."""
        save_model(folder, cast("DEITalk", model), self.config, summary)


def train_curves(
    config: TrainingConfig,
    data: Path,
    out: Path,
    *,
    resume: bool = False,
    start_from: Path | None = None,
    track: Sequence[str] = (),
    frozen_features: FrozenFeatures | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Train a model of curves.

    Parameters
    ----------
    config : TrainingConfig
        Model, loss, data and schedule.
    data : Path
        Dataset folder.
    out, resume, track, progress
        As for `deitalk.training.trainer.run_training`.
    start_from : Path or None
        Model folder whose weights are the start (fine-tuning).
    frozen_features : FrozenFeatures or None
        Those of ``train.frozen_frontend``, where several runs share them.

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
    task = TrainingTask(config, data, start_from=start_from, frozen_features=frozen_features)
    return run_training(task, out, resume=resume, track=track, progress=progress)


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


def _copy_frontend(model: DEITalk, owner: DEITalk, name: str) -> None:
    """Copy the frontend of another model; no gradient reaches it."""
    if model.config.frontend != owner.config.frontend:
        raise ConfigError(
            f"train.frozen_frontend={name!r} is built otherwise than model.frontend; "
            "use that model's own config.yaml"
        )
    frontend = model.get_submodule("frontend").requires_grad_(False)
    frontend.load_state_dict(owner.get_submodule("frontend").state_dict())


@torch.no_grad()
def turn_to_the_past(decoder: nn.Module) -> None:
    """Move the taps of symmetric kernels (..., K) to those of causal ones, in place.

    The taps after the centre are added to it: what does not change with time has the same result.
    """
    for module in decoder.modules():
        if isinstance(module, TemporalConv):
            kernel = module.conv.weight
            half, symmetric = kernel.shape[-1] // 2, kernel.clone()
            kernel.zero_()
            kernel[..., half:] = symmetric[..., : half + 1]
            kernel[..., -1] = symmetric[..., half:].sum(dim=-1)
