"""Training of curve models with a teacher, measured lips or sound that was encoded before.

The task of `python -m deitalk.research train`; its main path is `deitalk.training.curves`.
"""

from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from deitalk.data.augment_waveform import Surroundings
from deitalk.data.clips import Clip
from deitalk.data.seeded_batches import SeededBatches, Share
from deitalk.data.waveforms import read_waveform
from deitalk.data.windows import Window, WindowBatches
from deitalk.errors import ConfigError
from deitalk.models.curve_model import DEITalk
from deitalk.research.comparison.emotalk import EmoTalk
from deitalk.research.config import TrainingConfig, TrainingLossConfig
from deitalk.research.lips.losses import LipLoss
from deitalk.research.training.distillation import Teacher, read_teacher
from deitalk.research.training.encoded_passes import EncodedPasses
from deitalk.training import curves
from deitalk.training.curve_losses import CurveLoss, start_as
from deitalk.training.curves import CurveTask
from deitalk.training.optimizer import new_optimizer
from rig import ControlSet
from rig.arrays import Float32
from rig.controls import DEFAULT_ID

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

    Parameters
    ----------
    *given, **options
        As for `WindowBatches`.
    encoded : EncodedPasses or None
        Windows carry features of a random pass instead of the sound.
    clean : bool
        Windows carry the sound before augmentation too.
    """

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
    config, controls, device
        As for `CurveLoss`.
    teacher : Teacher or None
        Whose features are a second target.

    Raises
    ------
    ConfigError
        As `CurveLoss`; if `config.lips` or `config.range` is set for a rig other than the board.
    """

    config: TrainingLossConfig

    def __init__(
        self,
        config: TrainingLossConfig,
        controls: ControlSet,
        device: torch.device,
        teacher: Teacher | None = None,
    ) -> None:
        super().__init__(config, controls, device)
        self.teacher, self.lips = teacher, None
        if config.lips or config.range:
            if controls.id != DEFAULT_ID:
                raise ConfigError(
                    "loss.lips, loss.range: the embedded head has the board's controls only; set 0"
                )
            self.lips = LipLoss(bool(config.range), device)

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
        parts = self.parts(output, batch, known)
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


class TrainingTask(CurveTask):
    """Training from the start; parameters as for `CurveTask`."""

    config: TrainingConfig
    encoded: EncodedPasses | None = None

    teacher: DEITalk | None = None

    def new_model(self) -> DEITalk:
        """Make the model, with the teacher's weights where they fit."""
        model, name = super().new_model(), self.config.train.teacher
        if name is not None:
            self.teacher = read_teacher(name, model)
            start_as(model, self.teacher)
        return model

    def build(self, device: torch.device) -> None:
        """Build the model with the weights it starts from, its teacher and the validation clips."""
        config, settings = self.config, self.config.train
        super().build(device)
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
                Surroundings.read(config.data.noise_folder, config.data.room_folder),
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
        )

    def set_training(self) -> None:
        """Put the model in training mode, but for a frontend that does not learn."""
        super().set_training()
        if self.encoded is not None:
            self.model.get_submodule("frontend").eval()


train_curves = partial(curves.train_curves, task=TrainingTask)
"""`deitalk.training.curves.train_curves` by a `TrainingConfig`."""
