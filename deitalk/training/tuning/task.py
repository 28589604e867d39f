"""Fine-tuning of a trained model on captures of a rig: a task of the trainer.

``deitalk finetune DATA --from default -o runs/mine``. It differs from training in what is learnt
(`TuneConfig.part`), in that the base model gives all that captures do not show (controls they do
not know, emotions they lack, other speech), and in the score, which compares with the mean pose of
the captures and so serves any rig.

Without steps, the default, the result is the regression (`deitalk.training.tuning.ridge`) on all
clips, with what was chosen by folds; its scores are those of clips that are predicted from others.
With steps some takes validate, and the best weights are kept, those of the regression included.
"""

import copy
import ctypes
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn

from deitalk.config.finetuning import FinetuneConfig
from deitalk.data.captures.conventions import (
    Convention,
    TakeProducts,
    name_styles,
)
from deitalk.data.captures.splits import divide_clips, last_takes, shortage
from deitalk.data.clips import REHEARSED, Clip, read_clips, spread_clips
from deitalk.data.frozen_features import FrozenFeatures, remove_features
from deitalk.data.seeded_batches import Share
from deitalk.data.waveforms import sound_of
from deitalk.data.windows import Window, WindowBatches
from deitalk.emotions import EMOTIONS
from deitalk.errors import ConfigError, DataError
from deitalk.evaluation.captures import System, by_model, errs_less, write_comparison
from deitalk.evaluation.comparison import CaptureSet, MeanPose, mean_pose
from deitalk.evaluation.smoothness import load_example
from deitalk.models.checkpoint import require_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import describe_model, model_folder, weights_hash
from deitalk.models.rig_decoder import RigDecoder
from deitalk.training.curve_losses import CurveLoss, start_as
from deitalk.training.curves import CurveTask
from deitalk.training.journal import read_log
from deitalk.training.optimizer import new_optimizer, shared_copy
from deitalk.training.trainer import Progress, run_training, silent
from deitalk.training.tuning.expression_strength import expression_axes, label_intensity
from deitalk.training.tuning.recipe import (
    can_learn_intensity,
    carried,
    contact_controls,
    is_same_rig,
    learnt_controls,
    with_base_parts,
    with_captured_intensity,
    with_styles,
)
from deitalk.training.tuning.regression import (
    MOST_SCORED,
    Regression,
    analysed,
    styles_of_clip,
)
from deitalk.training.tuning.ridge import Maps
from rig.arrays import Bool, Float32
from rig.errors import ControlError

ACTORS_FASTER = 30
"""Styles of actors begin at 0, far from those of emotions (about 1), and learn so much faster."""
LAST_SLOWER = 30
"""Last layers begin as a regression, from which steps of the decoder's size lead away at once."""
ABOUT = ("base", "part")
"""Settings that a report states; the run's config.yaml has all."""
MMAP_THRESHOLD = -3
"""`M_MMAP_THRESHOLD` of glibc's `mallopt`."""


def _return_memory() -> None:
    """Have glibc return what is freed, and later blocks from 1 MB on at once; else do nothing.

    It does so at first, but raises the size with every larger block that is freed, and then keeps
    what lies between others: of a tuning a sixth of its memory.
    """
    with suppress(AttributeError, OSError, TypeError):
        library = ctypes.CDLL(None)
        library.mallopt(MMAP_THRESHOLD, 2**20)
        library.malloc_trim(0)


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
    track: Sequence[str] = (),
    progress: Progress = silent,
    frozen_features: FrozenFeatures | None = None,
    task: "type[FinetuneTask] | None" = None,
) -> dict[str, Any]:
    """Tune a model, then compare it with the base on held-out clips.

    Parameters
    ----------
    config : FinetuneConfig
        From `read_recipe`.
    data : Path
        Dataset folder of captures.
    out, resume, track, progress
        As for `deitalk.training.trainer.run_training`.
    frozen_features : FrozenFeatures or None
        Features of the base for several runs on the same clips.
    task : type or None
        `FinetuneTask`, or a class of it with another `loss`.

    Returns
    -------
    dict
        Scores of each system, as in ``report.json`` (`deitalk.evaluation.comparison`).

    Raises
    ------
    DataError, ConfigError, MissingError, rig.errors.TargetError
        As `run_training`, and as `FinetuneTask`.
    """
    _return_memory()
    job = (task or FinetuneTask)(config, data, frozen_features, progress)
    run_training(job, out, resume=resume, track=track, progress=progress)
    scores, complete = job.compare(out), job.config
    del job  # its networks and clips are not needed for the graph
    sound_of.cache_clear()
    # Once more, with the graph that ONNX Runtime evaluates.
    tuned, summary = require_model(out / "best", DEITalk), describe_model(out / "best")["training"]
    save_model(out / "best", tuned, complete, summary, graph=True)
    remove_features(out / "features")  # a run that is over needs none
    return scores


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
        If the dataset folder, the corpus or the table of the rig is not as it must be, or there
        are no clips to train on or to validate.
    ConfigError
        If the network is too large, or speech is to be rehearsed for another rig than the base's.
    """

    config: FinetuneConfig
    scores_start = True
    keeps_state = False
    features_folder: Path | None = None
    ridge: DEITalk | None = None
    """The model before the first step, whose last layers are a regression."""
    has_start: bool
    """Whether the model before the regression is the base, or what is carried of it to the rig: the
    rig is related to the base's, and the decoder is of its class."""
    late: Maps | None = None
    """What validation clips add to the regression; saved models have it, which choosing has not."""
    conventions: dict[str, Convention]
    """By the name of their style."""
    held: str
    """What the scored clips are, for the report."""

    def __init__(
        self,
        config: FinetuneConfig,
        data: Path,
        frozen_features: FrozenFeatures | None = None,
        progress: Progress = silent,
    ) -> None:
        self.progress = progress
        division = divide_clips(read_clips(data), config.tune.leave_out)
        if not config.train.steps:
            learnt = [*division.train, *division.validation, *division.between]
            division = division._replace(train=learnt, validation=[], between=[])
        elif not division.validation:
            division = last_takes(division)
        complete = with_styles(config, division.train, config.model.actors)
        super().__init__(complete, data, frozen_features=frozen_features)
        self.base_actors, config = config.model.actors, self.config
        self.clips, self.validation_clips = division.train, division.validation
        speakers = {clip.speaker for clip in division.train}
        others = (*division.validation, *division.between)
        self.late_clips = [clip for clip in others if clip.speaker in speakers]
        if not self.clips or (config.train.steps and not self.validation_clips):
            found = shortage(len(self.clips), len(self.validation_clips))
            raise DataError(f"{data}: has {found}")
        self.test_clips, self.conventions = division.test, {}
        carried(self.config, self.controls)  # bad files are refused before there is a run folder
        self._rehearsed()
        self.learnt = learnt_controls(config.rules, self.controls)
        self.pose = self._mean_pose(data)
        captured = self.learnt & self.pose.alive
        self.own_rules = config.rules
        self._keep_base(captured)
        if is_same_rig(config):
            self.learnt = captured
        # The captured expressions from which intensity is learnt.
        config = self.config
        axes = {}
        if config.train.steps and can_learn_intensity(config):
            axes = expression_axes(self.clips, self.controls, self.learnt)
        if not axes and config.tune.intensity == "captured":
            raise ConfigError(
                "tune.intensity=captured: no captured emotion differs from the actor's neutral "
                "clips, the base has no intensity, or train.steps is 0; use auto"
            )
        self.axes = axes
        if self.axes:
            self.config = with_captured_intensity(self.config)

    def _keep_base(self, captured: Bool) -> None:
        """Leave to the base what captures do not show, of controls (C,) and emotions."""
        config = self.config.model_copy(update={"rules": self.own_rules})
        shown = {clip.emotion for clip in self.clips}
        self.config = with_base_parts(config, self.controls, self.learnt, captured, shown)

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

    def read(self, out: Path) -> None:
        """Encode the captures, find their conventions, measure the strength of expressions.

        The strength is written to ``intensity/`` of the run.
        """
        super().read(out)
        self.features_folder = out / "features"
        self._begin()
        if self.config.tune.conventions and len({c.take_name for c in self.clips}) > len(
            {clip.group for clip in self.clips}
        ):
            self._find_conventions()
        if self.axes:
            self.clips, self.validation_clips, self.test_clips = (
                label_intensity(clips, self.axes, self.controls, out / "intensity")
                for clips in (self.clips, self.validation_clips, self.test_clips)
            )

    def _begin(self) -> None:
        """Load the base, and encode captures and speech that is rehearsed, in the run folder."""
        tune = self.config.tune
        self.base = require_model(tune.base, DEITalk).requires_grad_(False)
        self.is_same_rig = self.base.controls.names == self.controls.names
        if tune.corpus is not None and not self.is_same_rig:
            raise ConfigError(
                f"tune.corpus: {tune.base!r} has other controls than {self.controls.id!r}, and "
                "no curves of it to rehearse; set it to null"
            )
        if tune.part == "all":
            return
        on_cpu = torch.accelerator.current_accelerator() is None  # where the base stays
        owner = self.base if on_cpu else None
        found = self.frozen_features or FrozenFeatures(tune.base, self.features_folder, owner)
        self.frozen_features = found
        if not self.config.data.augment:
            found.prepare(
                [*self.clips, *self.late_clips, *self.test_clips, *self._rehearsed()],
                self.config.data.window_frames,
                torch.accelerator.current_accelerator() or "cpu",
                lambda share: self.progress(0, 1, {"encoded": share}),
            )

    @torch.no_grad()
    def _find_conventions(self) -> None:
        """Give clips of an actor whose takes differ in convention the style of theirs."""
        lip = self.base.controls.subset("lip")
        takes: dict[tuple[str, str], dict[str, TakeProducts]] = defaultdict(dict)
        every = [*self.clips, *self.late_clips, *self.test_clips]
        for clip in every:
            example = load_example(clip, self.controls, sound=False)
            analysis = analysed(self.base, clip, len(example.curves), self.frozen_features)
            predicted = self.base.decode(
                analysis, styles_of_clip(self.base, clip, len(example.curves))
            )
            own = takes[clip.group].setdefault(clip.take_name, TakeProducts())
            own.add(predicted.numpy()[:, lip], example.curves, example.known)
        learnt = {(*clip.group, clip.take_name) for clip in self.clips}
        self.conventions, names = name_styles(takes, learnt, self.controls.names, self.pose.moving)
        self.clips, self.late_clips, self.validation_clips, self.test_clips = (
            [
                replace(clip, speaker=names.get((*clip.group, clip.take_name), clip.speaker))
                for clip in part
            ]
            for part in (self.clips, self.late_clips, self.validation_clips, self.test_clips)
        )
        before = self.base_actors[: len(self.base.actors)]
        self.config = with_styles(self.config, self.clips, before)

    def build(self, device: torch.device) -> None:
        """Build the model with the base's weights; keep the base as the teacher."""
        tune = self.config.tune
        if not hasattr(self, "base"):
            self._begin()
        self._begin_model()
        sound_of.cache_clear()  # no recording is read by the regression
        _return_memory()
        self._fit_last_layers()
        _return_memory()
        self.base.to(device)
        # Let only the weights of a part learn.
        decoder, intensity = self.model.rig_decoder, self.model.intensity if self.axes else None
        parts: dict[str, nn.Module] = {"all": self.model, "decoder": decoder}
        learns: list[nn.Module | None] = [parts.get(tune.part), decoder.output]
        learns += [decoder.actors, decoder.actor_layers]
        learns += [] if intensity is None else [intensity, self.model.motion]
        held = [decoder.kept, decoder.change, None if intensity is None else intensity.kept]
        self.model.requires_grad_(False)
        for modules, moves in ((learns, True), (held, False)):
            for module in modules:
                if module is not None:
                    module.requires_grad_(moves)
        moving = {name for name, p in self.model.named_parameters() if p.requires_grad}
        self.frozen = self.model.state_dict().keys() - moving
        self._loss = CurveLoss(self.config.loss, tune.hold)
        self.validation_set = CaptureSet.of(
            self.validation_clips, self.controls, self.pose, self.learnt
        )

    def _begin_model(self) -> None:
        self.model = self._network()
        self._start_as(self.base)
        if self.config.tune.part != "all":
            self.model.frontend = self.base.frontend

    @torch.no_grad()
    def _start_as(self, base: DEITalk) -> None:
        """Begin with the base's weights, also of what it goes on to move."""
        start_as(self.model, base)
        decoder, given = self.model.rig_decoder, base.rig_decoder
        carry = carried(self.config, self.controls)
        # Last layers go with the layers before them.
        self.has_start = carry is not None and type(decoder) is type(given)
        if carry is not None:
            share = torch.from_numpy(carry).to(given.output.weight)
            if decoder.change is not None and (given.change is None or not self.is_same_rig):
                decoder.change.carry.copy_(share[:, : decoder.change.carry.shape[1]])
        if self.has_start:
            rest = torch.tensor(base.controls.rest)
            _widen(decoder.output.weight, share @ given.output.weight)
            decoder.output.bias.copy_(
                torch.tensor(self.controls.rest) + share @ (given.output.bias - rest)
            )
        else:
            decoder.output.weight.zero_()
            decoder.output.bias.copy_(torch.tensor(self.controls.rest))
        self._keep(base)
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
                new[: len(old), ..., : old.shape[-1]] = old

    def _keep(self, base: DEITalk) -> None:
        """Give the decoder of what captures do not show the base's weights."""
        decoder, given = self.model.rig_decoder, base.rig_decoder
        if decoder.kept is None or (given.kept is not None and self.is_same_rig):
            return
        if type(given) is not RigDecoder:
            raise ConfigError(
                f"tune.base: {self.config.tune.base!r} has an own decoder, which cannot stay "
                "beside another; tune the model that it was tuned from"
            )
        own = decoder.kept.state_dict()
        for name, weight in given.state_dict().items():
            if name in own:
                _widen(own[name], weight)

    def _fit_last_layers(self) -> None:
        """Add what a ridge regression finds to the last layers: the start of the tuning."""
        fit = self.regression = Regression(
            self.model,
            self.base,
            self.clips,
            self.learnt,
            self.frozen_features,
            self.progress,
            new_actors=not self.conventions,
        )
        late = self.late_clips if self.config.tune.part != "all" else []
        self.late = fit.fit(late, may_stay=self.has_start)
        contacts = contact_controls(self.controls)
        if self.config.model.lips and (self.learnt & contacts).any() and fit.contacts_are_base():
            self._keep_base(self.learnt & ~contacts)
            fit.learnt = self.learnt = self.learnt & ~contacts
            del self.model, fit.model  # before there is another
            self._begin_model()
            fit.model = self.model
        fit.maps.add_to(self.model.rig_decoder)
        gain = fit.teach_emotions(scales=self.is_same_rig)
        rules = self.config.rules
        if rules.expressions is not None:
            size = {"size": gain * rules.expressions.size}
            update = {"expressions": rules.expressions.model_copy(update=size)}
            rules = rules.model_copy(update=update)
            self.config = self.config.model_copy(update={"rules": rules})
            self.model.rules = rules
        if self.config.tune.range is not None:
            fit.match_range(self.config.tune.range)
            if self.late is not None and fit.raised is not None:
                weight, bias = (
                    fit.raised.of(torch.from_numpy(part)).numpy()
                    for part in (self.late.weight, self.late.bias)
                )
                self.late = self.late._replace(weight=weight, bias=bias)
        fit.size_emotions()
        self.ridge = self._copy() if self.config.train.steps else None

    def _copy(self) -> DEITalk:
        """Copy of the model for evaluation, with the same frontend where it does not learn."""
        fixed = {name for name in self.model.state_dict() if name.startswith("frontend.")}
        return shared_copy(self.model, set() if self.config.tune.part == "all" else fixed).eval()

    def compare(self, out: Path) -> dict[str, Any]:
        """Write the report of a run; where the start of its steps errs less, deliver that."""
        ridge = copy.deepcopy(self.ridge)
        _return_memory()
        captures, systems = self.systems(out / "best")
        self.stays = self.regression.maps.stays
        del self.base, self.regression, self.model  # pictures need as much memory
        self.frozen_features = None
        _return_memory()
        scores = self._report(out, captures, systems)
        if ridge is not None and self.test_clips and errs_less(scores, "ridge", "after"):
            self.save(out / "best", ridge, describe_model(out / "best")["training"] | {"step": 0})
            scores = self._report(out, captures, systems | {"after": systems["ridge"]})
        return scores

    def _report(
        self, out: Path, captures: CaptureSet, systems: dict[str, System]
    ) -> dict[str, Any]:
        """Compare the systems; the report has the base, the start and the course of the run."""
        tune = self.config.tune
        facts: dict[str, Any] = {name: getattr(tune, name) for name in ABOUT}
        log = read_log(out / "development.csv")
        course = {name.removeprefix("dev_"): values for name, values in log.items()}
        best = describe_model(out / "best")["training"]["step"]
        about = facts | {
            "base_sha256": weights_hash(model_folder(tune.base)),
            "actors": list(self.config.model.actors),
            "conventions": {name: list(found.takes) for name, found in self.conventions.items()},
            "best_step": best,
            "delivered": self.delivered(best),
            "learning": course if len(course["step"]) > 1 else {},
        }
        return write_comparison(out, systems, captures, self.clips, held=self.held, about=about)

    def systems(self, best: Path) -> tuple[CaptureSet, dict[str, System]]:
        """What is scored on which clips, none of which a system learnt from; `best`: the result."""
        if not self.test_clips and not self.config.train.steps:
            return self._by_folds()
        after = require_model(best, DEITalk)
        before = self.base.cpu() if self.is_same_rig else None
        models = {"before": before, "ridge": self.ridge}
        if self.test_clips:
            self.held = "not used in training"
            if self.late is not None and self.ridge is not None:
                self.late.add_to(self.ridge.rig_decoder)
        else:
            self.held = "which also chose the weights"
            if self.late is not None:
                self.late.add_to(after.rig_decoder, -1)
        clips = self.test_clips or self.validation_clips
        captures = CaptureSet.of(clips, self.controls, self.pose, self.learnt)
        systems = {name: by_model(m) for name, m in (models | {"after": after}).items() if m}
        if self.conventions and self.test_clips:
            own = systems["after"]
            systems["after, mean style"] = lambda example: own(example._replace(speaker=""))
        return captures, systems

    def _by_folds(self) -> tuple[CaptureSet, dict[str, System]]:
        """Clips that are each predicted from other takes, or from other parts of their take."""
        self.held = "each predicted from the other takes, or from other parts of its only one"
        clips = spread_clips(self.clips, MOST_SCORED)
        examples = tuple(load_example(clip, self.controls) for clip in clips)
        found: dict[int, dict[str, Float32]] = {}
        for clip, example in zip(clips, examples, strict=True):
            curves = {"after": self.regression.predicted(clip, example)}
            if self.has_start:
                curves["before"] = self.regression.before(clip, example)
            found[id(example)] = curves
        names = ["before", "after"] if self.has_start else ["after"]

        def system(name: str) -> System:
            return lambda example: (found[id(example)][name], None)

        captures = CaptureSet(examples, self.controls, self.pose, self.learnt)
        return captures, {name: system(name) for name in names}

    def delivered(self, best_step: int) -> str:
        """What the result is, by control."""
        stays = self.learnt & self.stays
        learnt = int((self.learnt & self.pose.alive & ~stays).sum())
        what = "the regression" if not best_step else f"the weights of step {best_step}"
        kept = f", the base for {int(stays.sum())} that it predicts as well" if stays.any() else ""
        return f"{what} for {learnt} controls{kept}"

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
        """Targets of the base for controls that a clip does not know; the curves with them."""
        known = batch.emotion[:, : len(EMOTIONS) + len(self.base.config.actors)]
        base = self.base(batch.waveform, known, batch.frames, batch.total).curves
        curves = torch.where(batch.known[:, None] > 0, batch.curves, base)
        return batch._replace(curves=curves), curves

    def validate(self, model: nn.Module) -> dict[str, float]:
        """Scores of `CaptureSet`; none without steps."""
        if not self.config.train.steps:
            return {"score": 0.0}
        return self.validation_set.score(cast("DEITalk", model))

    def save(self, folder: Path, model: nn.Module, summary: dict[str, Any]) -> None:
        """Write a model folder."""
        whole = cast("DEITalk", model)
        if self.late is not None:
            whole = copy.deepcopy(whole)
            self.late.add_to(whole.rig_decoder)
        save_model(folder, whole, self.config, summary | {"base": self.config.tune.base})
