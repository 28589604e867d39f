"""Fine-tuning of a trained model on captures of a rig: a task of the trainer.

``deitalk finetune DATA --from default -o runs/mine``. It differs from training in what is learnt
(`TuneConfig.part`), in that the base model is the teacher of all that captures do not show
(controls they do not know, emotions they lack, other speech), and in the score, which compares
with the mean pose of the captures and so serves any rig.
"""

import copy
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from deitalk.config.curves import FinetuneConfig
from deitalk.data.captures.splits import divide_clips, shortage
from deitalk.data.clips import REHEARSED, Clip, read_clips, read_known
from deitalk.data.windows import (
    FrozenFeatures,
    Share,
    Window,
    WindowBatches,
    remove_features,
)
from deitalk.emotions import EMOTIONS
from deitalk.errors import ConfigError, DataError
from deitalk.evaluation.comparison import CaptureSet, MeanPose, mean_pose, write_comparison
from deitalk.evaluation.figures import ClipRows
from deitalk.evaluation.validation import load_example
from deitalk.models.checkpoint import require_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import describe_model, model_folder, weights_hash
from deitalk.training.curve_losses import CurveLoss, start_as
from deitalk.training.curves import CurveTask, clip_rows, shown_examples
from deitalk.training.trainer import Progress, new_optimizer, run_training, silent
from deitalk.training.tuning.recipe import (
    can_learn_intensity,
    is_same_rig,
    learnt_controls,
    with_actors,
    with_base_parts,
    with_captured_intensity,
    with_direct_layers,
)
from deitalk.training.tuning.ridge import (
    Capture,
    ExpressionAxis,
    Maps,
    Rows,
    Sums,
    expression_axes,
    fit_ridge,
    label_intensity,
)
from rig.errors import ControlError

ACTORS_FASTER = 30
"""Styles of actors begin at 0, far from those of emotions (about 1), and learn so much faster."""
LAST_SLOWER = 30
"""Last layers begin as a regression, from which steps of the decoder's size lead away at once."""
ABOUT = ("base", "start", "part")
"""Settings that a report states; the run's config.yaml has all."""


@torch.no_grad()
def _widen(new: Tensor, old: Tensor) -> None:
    """Copy a matrix into the first columns of a wider one; its other columns are 0."""
    new.zero_()[..., : old.shape[-1]] = old


def finetune(
    config: FinetuneConfig,
    data: Path,
    out: Path,
    *,
    resume: bool = False,
    tensorboard: bool = False,
    progress: Progress = silent,
    frozen_features: FrozenFeatures | None = None,
) -> dict[str, Any]:
    """Tune a model, then compare it with the base on held-out clips.

    Parameters
    ----------
    config : FinetuneConfig
        From `read_recipe`.
    data : Path
        Dataset folder of captures.
    out, resume, tensorboard, progress
        As for `deitalk.training.trainer.run_training`.
    frozen_features : FrozenFeatures or None
        Features of the base for several runs on the same clips.

    Returns
    -------
    dict
        Scores of each system, as in ``report.json`` (`deitalk.evaluation.comparison`).

    Raises
    ------
    DataError, ConfigError, MissingError, rig.errors.TargetError
        As `run_training`, and as `FinetuneTask`.
    """
    task = FinetuneTask(config, data, frozen_features, progress)
    run_training(task, out, resume=resume, tensorboard=tensorboard, progress=progress)
    scores = write_comparison(
        out,
        task.systems(require_model(out / "best", DEITalk)),
        CaptureSet.of(task.test_clips, task.controls, task.pose, task.learnt),
        task.clips,
        are_unseen=task.has_test,
        about=_about(config, out, task.model.actors),
    )
    remove_features(out / "features")  # a run that is over needs none
    return scores


def _about(config: FinetuneConfig, out: Path, actors: Sequence[str]) -> dict[str, Any]:
    """The base, the start and the course of a run, for its report."""
    tune = config.tune
    facts = {name: getattr(tune, name) for name in ABOUT}
    rows = pd.read_csv(out / "development.csv").to_dict("list")
    course = {str(name).removeprefix("dev_"): values for name, values in rows.items()}
    return facts | {
        "base_sha256": weights_hash(model_folder(tune.base)),
        "actors": list(actors),
        "best_step": describe_model(out / "best")["training"]["step"],
        "learning": course,
    }


class FinetuneTask(CurveTask):
    """A base model, captures, and what holds the base's abilities.

    Parameters
    ----------
    config : FinetuneConfig
    data : Path
        Dataset folder.
    frozen_features : FrozenFeatures or None
        As for `finetune`.
    progress : callable
        Called before the first step with the share of the captures that is ``read``, ``encoded``
        or ``fitted`` by the regression.

    Raises
    ------
    DataError
        If the dataset folder is not as it must be, or holds no clips to train on or to validate.
    ConfigError
        If the network is too large, or speech is to be rehearsed for another rig than the base's.
    """

    config: FinetuneConfig
    scores_start = True
    keeps_state = False
    features_folder: Path | None = None
    ridge: DEITalk | None = None
    """The model before the first step, where a regression is its start."""
    late: Maps | None = None
    """What validation clips add to the regression; saved models have it, which choosing has not."""

    def __init__(
        self,
        config: FinetuneConfig,
        data: Path,
        frozen_features: FrozenFeatures | None = None,
        progress: Progress = silent,
    ) -> None:
        self.progress = progress
        division = divide_clips(read_clips(data), config.tune.leave_out)
        complete = with_direct_layers(with_actors(config, division.train))
        super().__init__(complete, data, frozen_features=frozen_features)
        config = self.config
        self.clips, self.validation_clips = division.train, division.validation
        speakers = {clip.speaker for clip in division.train}
        others = (*division.validation, *division.between)
        self.late_clips = [clip for clip in others if clip.speaker in speakers]
        if config.model.decoder != "convolution":
            raise ConfigError(
                f"tune.base: {config.tune.base!r} has decoder: {config.model.decoder}, which is "
                "for comparison; fine-tune a model such as default"
            )
        if not self.clips or not self.validation_clips:
            found = shortage(len(self.clips), len(self.validation_clips))
            raise DataError(f"{data}: has {found}")
        self.has_test = bool(division.test)
        self.test_clips = division.test or self.validation_clips
        self.learnt = learnt_controls(config, self.controls)
        self.pose = self._mean_pose(data)
        if is_same_rig(config):
            captured = self.learnt & self.pose.alive
            config = with_base_parts(config, self.controls, self.learnt, captured)
            self.config, self.learnt = config, captured
        shown = {clip.emotion for clip in self.clips}
        self.unseen = [i for i, emotion in enumerate(EMOTIONS) if emotion not in shown]
        self.axes = self._axes()
        if self.axes:
            self.config = with_captured_intensity(self.config)

    def _mean_pose(self, data: Path) -> MeanPose:
        try:
            return mean_pose(self._shown("read"), self.controls, self.learnt)
        except ControlError as error:
            raise DataError(
                f"{data}: curves of another rig than {self.controls.id}; give `rig`, its file "
                f"({error})",
                parameter="rig",
            ) from None

    def _shown(self, phase: str) -> Iterator[Clip]:
        """The clips to train on, with progress."""
        for done, clip in enumerate(self.clips, 1):
            yield clip
            self.progress(0, 1, {phase: done / len(self.clips)})

    def _axes(self) -> dict[tuple[str, str], ExpressionAxis]:
        """The captured expressions from which intensity is learnt."""
        config = self.config
        axes = {}
        if can_learn_intensity(config):
            axes = expression_axes(self.clips, self.controls, self.learnt)
        if not axes and config.tune.intensity == "captured":
            raise ConfigError(
                "tune.intensity=captured: no captured emotion differs from the actor's neutral "
                "clips, or the base has no intensity; use auto"
            )
        return axes

    def read(self, out: Path) -> None:
        """Measure the strength of the captured expressions, in ``intensity/`` of the run."""
        super().read(out)
        self.features_folder = out / "features"
        if self.axes:
            self.clips, self.validation_clips, self.test_clips = (
                label_intensity(clips, self.axes, self.controls, out / "intensity")
                for clips in (self.clips, self.validation_clips, self.test_clips)
            )

    def build(self, device: torch.device) -> None:
        """Build the model with the base's weights; keep the base as the teacher."""
        tune = self.config.tune
        base = require_model(tune.base, DEITalk)
        self.base = base.to(device).requires_grad_(False)
        self.is_same_rig = base.controls.names == self.controls.names
        if tune.corpus is not None and not self.is_same_rig:
            raise ConfigError(
                f"tune.corpus: {tune.base!r} has other controls than {self.controls.id!r}, and "
                "no curves of it to rehearse; set it to null"
            )
        self.model = self._network()
        if tune.part != "all":
            self._prepare_features(device)
        if tune.start == "base":
            self._start_as(base)
            self._fit_last_layers()
        self._choose(tune.part)
        moving = {name for name, p in self.model.named_parameters() if p.requires_grad}
        self.frozen = self.model.state_dict().keys() - moving
        self._loss = CurveLoss(self.config.loss, self.controls, device, hold=tune.hold)
        self.validation_set = CaptureSet.of(
            self.validation_clips, self.controls, self.pose, self.learnt
        )
        self.shown = shown_examples(self.validation_clips, self.controls)

    def _prepare_features(self, device: torch.device) -> None:
        """Features of the captures, and of speech that is rehearsed, in the run folder."""
        found = self.frozen_features or FrozenFeatures(self.config.tune.base, self.features_folder)
        self.frozen_features = found
        data = self.config.data
        if not data.augment:
            found.prepare(
                [*self.clips, *self.late_clips, *self._rehearsed()],
                data.window_frames,
                device,
                lambda share: self.progress(0, 1, {"encoded": share}),
            )

    @torch.no_grad()
    def _start_as(self, base: DEITalk) -> None:
        """Begin with the base's weights, also of what it goes on to move."""
        start_as(self.model, base)
        decoder, given = self.model.rig_decoder, base.rig_decoder
        if self.is_same_rig:
            _widen(decoder.output.weight, given.output.weight)
        else:
            decoder.output.weight.zero_()
        if decoder.kept is not None and given.kept is None:
            own = decoder.kept.state_dict()
            for name, weight in given.state_dict().items():
                if name in own:
                    _widen(own[name], weight)
        kept = self.model.intensity.kept if self.config.model.intensity else None
        if kept is not None:
            before = base.intensity.kept or base.intensity.project
            kept.load_state_dict(before.state_dict())
        if given.actors is not None and decoder.actors is not None:
            _widen(decoder.actors.weight, given.actors.weight)
        if given.actor_layers is not None and decoder.actor_layers is not None and self.is_same_rig:
            pairs = zip(
                decoder.actor_layers.parameters(), given.actor_layers.parameters(), strict=True
            )
            for new, old in pairs:
                new[: len(old)] = old

    def _fit_last_layers(self) -> None:
        """Add what a ridge regression finds to the last layers: the start of the tuning."""
        sums: dict[tuple[int, ...], Sums] = {}
        maps = self._regression(self.clips, sums)
        if self.late_clips and self.config.tune.part != "all":
            whole = self._regression([*self.clips, *self.late_clips], sums)
            self.late = Maps(
                whole.weight - maps.weight, whole.bias - maps.bias, whole.penalty - maps.penalty
            )
        maps.add_to(self.model.rig_decoder)
        self.ridge = copy.deepcopy(self.model).eval()

    def _regression(self, clips: Sequence[Clip], sums: dict[tuple[int, ...], Sums]) -> Maps:
        """What a ridge regression on clips adds to the last layers."""
        captures = [
            Capture(clip.take or clip.name, clip.speaker, read_known(clip.known, self.controls))
            for clip in clips
        ]
        actors = self.config.model.actors

        def read(place: int) -> Rows:
            self.progress(0, 1, {"fitted": (place + 1) / len(clips)})
            return self._rows(clips[place])

        return fit_ridge(captures, read, actors, self.learnt, sums)

    def systems(self, after: DEITalk) -> dict[str, DEITalk | None]:
        """The models to compare, none of which learnt from the clips that are scored."""
        if self.late is not None and self.has_test and self.ridge is not None:
            self.late.add_to(self.ridge.rig_decoder)
        elif self.late is not None:
            self.late.add_to(after.rig_decoder, -1)
        before = self.base.cpu() if self.is_same_rig else None
        return {"before": before, "ridge": self.ridge, "after": after}

    def _choose(self, part: str) -> None:
        """Let only the weights of a part learn."""
        decoder = self.model.rig_decoder
        if part == "all":
            return
        self.model.requires_grad_(False)
        if part == "adapters":
            add_adapters([decoder.style, decoder.layers], self.config.tune.rank)
        elif part == "decoder":
            decoder.requires_grad_(True)
            if decoder.kept is not None:
                decoder.kept.requires_grad_(False)
        if decoder.actors is not None:
            decoder.actors.requires_grad_(True)
        if decoder.actor_layers is not None:
            decoder.actor_layers.requires_grad_(True)
        if part == "head" or not self.is_same_rig:
            decoder.output.requires_grad_(True)
        if self.axes:
            self.model.intensity.requires_grad_(True)
            self.model.motion.requires_grad_(True)
            if self.model.intensity.kept is not None:
                self.model.intensity.kept.requires_grad_(False)

    @torch.no_grad()
    def _rows(self, clip: Clip) -> Rows:
        """A clip as the last layer is given it, and what is missing in the curves."""
        model, frozen = self.model.eval(), self.frozen_features
        example = load_example(clip, self.controls, sound=frozen is None)
        n_frames, sound = len(example.curves), example.waveform
        if frozen is not None:
            sound = frozen.features(clip, n_frames)[:n_frames].astype(np.float32)
        analysis = model.analyse(torch.from_numpy(sound), n_frames)
        emotion = torch.eye(len(EMOTIONS))[EMOTIONS.index(clip.emotion)].expand(n_frames, -1)
        style = model.styles(emotion, clip.speaker)
        hidden = model.describe(analysis, style)
        given = model.rig_decoder.curves(hidden[None], style[None])[0]
        return hidden.numpy(), example.curves - given.numpy()

    def optimizer(self) -> torch.optim.Optimizer:
        """AdamW or Adam; styles of actors learn `ACTORS_FASTER`, last layers `LAST_SLOWER`."""
        last = ("decoder.output.", "decoder.actor_layers.") if self.ridge is not None else ()

        def factor(name: str) -> float:
            if name.startswith("decoder.actors."):
                return ACTORS_FASTER
            return 1 / LAST_SLOWER if name.startswith(last) else 1

        return new_optimizer(self.model, self.config.train, factor)

    def batches(self, share: Share) -> WindowBatches:
        """Windows of the captures, and of speech to rehearse."""
        settings = self.config.train
        captures = [replace(clip, source="recording") for clip in self.clips]
        captures += self._rehearsed()
        return WindowBatches(
            captures,
            self.controls,
            self.config.data,
            settings.seed,
            settings.batch_size,
            share,
            frozen_features=self.frozen_features,
            actors=self.config.model.actors,
        )

    def _rehearsed(self) -> list[Clip]:
        corpus = self.config.tune.corpus
        others = [] if corpus is None else read_clips(corpus, "train")
        return [replace(clip, source=REHEARSED, speaker="") for clip in others]

    def set_training(self) -> None:
        """Put the model in training mode, but for a frontend that does not learn."""
        self.model.train()
        if self.config.tune.part != "all":
            self.model.get_submodule("frontend").eval()

    def loss(self, network: nn.Module, batch: Window) -> dict[str, Tensor]:
        """Every part of the loss, and their weighted sum (Eq. 8)."""
        learnt = torch.from_numpy(self.learnt).to(batch.known)
        batch = batch._replace(
            known=batch.known * learnt, emotion=self._partly_anonymous(batch.emotion)
        )
        if not self.is_same_rig:
            return self._loss(network, batch)
        return self._loss(network, *self._completed(batch))

    def _partly_anonymous(self, emotion: Tensor) -> Tensor:
        """The styles, in `TuneConfig.anonymous` of the windows without an actor."""
        if emotion.shape[1] == len(EMOTIONS):
            return emotion
        hidden = torch.rand(len(emotion)) < self.config.tune.anonymous
        keeps = torch.ones_like(emotion)
        keeps[hidden.to(emotion.device), len(EMOTIONS) :] = 0
        return emotion * keeps

    @torch.no_grad()
    def _completed(self, batch: Window) -> tuple[Window, Tensor]:
        """Targets of the base where captures have none; the curves in the emotion of the voice.

        Controls that a clip does not know are the base's. Some windows take an emotion that no
        capture has: their targets change as the base's curves do from emotion to emotion.
        """
        base = self._base_curves(batch, batch.emotion)
        curves = acted = torch.where(batch.known[:, None] > 0, batch.curves, base)
        other = self._other_emotion(batch.emotion)
        if other is not batch.emotion:
            curves = curves + self._base_curves(batch, other) - base
        return batch._replace(curves=curves, emotion=other), acted

    def _base_curves(self, batch: Window, emotion: Tensor) -> Tensor:
        known = emotion[:, : len(EMOTIONS) + len(self.base.config.actors)]
        curves: Tensor = self.base(batch.waveform, known, batch.frames, batch.total).curves
        return curves

    def _other_emotion(self, emotion: Tensor) -> Tensor:
        """The styles, whose emotion by `TuneConfig.rehearsal` becomes one that no capture has."""
        if not self.unseen:
            return emotion
        changes = torch.rand(len(emotion)) < self.config.tune.rehearsal
        places = torch.tensor(self.unseen)[torch.randint(len(self.unseen), (len(emotion),))]
        chosen = torch.eye(len(EMOTIONS))[places].to(emotion)
        chosen = torch.cat((chosen, emotion[:, len(EMOTIONS) :]), dim=-1)
        return torch.where(changes[:, None].to(emotion.device), chosen, emotion)

    def validate(self, model: nn.Module) -> tuple[dict[str, float], list[ClipRows]]:
        """Scores of `CaptureSet`, and the clips that are drawn."""
        curve_model = cast("DEITalk", model)
        scores = self.validation_set.score(curve_model)
        return scores, [clip_rows(name, e, curve_model) for name, e in self.shown.items()]

    def save(self, folder: Path, model: nn.Module, summary: dict[str, Any]) -> None:
        """Write a model folder; adapters become part of the weights."""
        whole = self._network()
        whole.load_state_dict(merged_weights(model))
        if self.late is not None:
            self.late.add_to(whole.rig_decoder)
        save_model(folder, whole, self.config, summary | {"base": self.config.tune.base})


# Changes of low rank of trained layers (LoRA, Hu et al. 2021), merged when the model is saved.
#
# A weight W becomes W + B A, where A [shape=(rank, inputs)] is random and B [shape=(outputs, rank)]
# begins at 0; W stays as it is. A convolution's weight counts as a matrix of its outputs and of all
# its inputs at every offset, so that linear layers and convolutions are changed alike, and a saved
# model is an ordinary one. (peft wraps each layer in a module of its own; merging by torch's
# parametrisations needs neither that nor another dependency.)


class LowRank(nn.Module):
    """Change of one weight.

    Parameters
    ----------
    weight : Tensor [shape=(outputs, ...)]
        Gives the shape.
    rank : int
        At most the smaller side of the matrix is used.
    """

    def __init__(self, weight: Tensor, rank: int) -> None:
        super().__init__()
        outputs, inputs = weight.flatten(1).shape
        rank = min(rank, outputs, inputs)
        self.down = nn.Parameter(torch.randn(rank, inputs) * inputs**-0.5)
        self.up = nn.Parameter(torch.zeros(outputs, rank))

    def forward(self, weight: Tensor) -> Tensor:
        """Add the change."""
        return weight + (self.up @ self.down).view_as(weight)


def add_adapters(layers: Iterable[nn.Module], rank: int) -> None:
    """Give every linear layer and convolution a `LowRank` change, which alone learns."""
    for layer in layers:
        for module in [m for m in layer.modules() if isinstance(m, nn.Linear | nn.Conv1d)]:
            module.requires_grad_(False)
            parametrize.register_parametrization(module, "weight", LowRank(module.weight, rank))


def merged_weights(model: nn.Module) -> dict[str, Tensor]:
    """State dict of the model as it was without adapters, their changes added to its weights."""
    weights = dict(model.state_dict())
    for path, module in model.named_modules():
        if parametrize.is_parametrized(module, "weight"):
            parts = f"{path}.parametrizations.weight."
            weights = {name: w for name, w in weights.items() if not name.startswith(parts)}
            changed: Tensor = module.weight
            weights[f"{path}.weight"] = changed.detach()
    return weights
