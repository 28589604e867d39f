"""A tuned model from Python: what ``deitalk finetune`` does."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deitalk.config.rig_file import rig_of_dataset
from deitalk.evaluation.captures import beats_loudness, warnings_of
from deitalk.training.trainer import Progress, silent
from deitalk.training.tuning.recipe import read_recipe
from deitalk.training.tuning.task import FinetuneTask
from deitalk.training.tuning.task import finetune as tune

if TYPE_CHECKING:
    from deitalk.config.finetuning import FinetuneConfig

PathLike = str | Path
NO_GRAPH = (
    "{}: no graph for ONNX Runtime was written, torch evaluates the model; after pip install "
    "'deitalk[onnx]', deitalk model export writes it with one."
)


@dataclass(frozen=True)
class Tuned:
    """A tuned model and how it does on clips that were predicted from others, or held out.

    Attributes
    ----------
    model : Path
        Model folder, for `deitalk.animate`.
    scores : dict
        Scores of each system, as in ``report.json``; ``after`` is the model.
    delivered : str
        What the model is, by control.
    conventions : dict of str to list of str
        Takes by style, where an actor's takes differ in convention.
    warnings : tuple of str
        Lines on a model that is no better than the base or than loudness, or has no graph for ONNX
        Runtime.
    """

    model: Path
    scores: dict[str, dict[str, float]]
    delivered: str
    conventions: dict[str, list[str]]
    warnings: tuple[str, ...]

    @property
    def beats_loudness(self) -> bool:
        """Whether it errs less than a line over loudness."""
        return beats_loudness(self.scores)


def finetune(
    dataset: PathLike,
    out: PathLike,
    *,
    base: str | None = None,
    rig: str | None = None,
    mapping: PathLike | None = None,
    leave_out: str | None = None,
    recipe: PathLike | None = None,
    settings: Mapping[str, Any] | None = None,
    task: type[FinetuneTask] = FinetuneTask,
    resume: bool = False,
    track: Sequence[str] = (),
    progress: Progress = silent,
) -> Tuned:
    """Tune a model on captures of an actor or of another rig, as ``deitalk finetune``.

    Parameters
    ----------
    dataset : path
        Dataset folder of captures.
    out : path
        Run folder, new or empty unless `resume`; the model is its ``best``.
    base : str, optional
        Model to tune, by default ``default``: a name, a folder, or org/name on the hub.
    rig : str, optional
        Another rig than that of the dataset folder, by name or file.
    mapping : path, optional
        Table of the rig's curves to the board, which carries emotions that captures lack.
    leave_out : str, optional
        Take or actor to test on, never learnt from.
    recipe : path, optional
        YAML of settings, such as ``configs/finetune.yaml``.
    settings : mapping, optional
        Single settings by dotted name, such as ``{"train.steps": 160}``.
    task : type
        `deitalk.training.tuning.task.FinetuneTask`, or a class of yours with another loss.
    resume : bool
        Continue the run folder; begin it if it is new.
    track : sequence of str
        Trackers of accelerate that get the numbers too: ``tensorboard``, whose events are in the
        run folder, ``wandb``, ``mlflow`` …; a continued run stays one run there.
    progress : callable
        Called with the step, the number of steps and values of both.

    Returns
    -------
    Tuned

    Raises
    ------
    DataError, ConfigError, CheckpointError, MissingError, rig.errors.TargetError
        One line each.
    """
    config = settings_of(
        dataset,
        base=base,
        rig=rig,
        mapping=mapping,
        leave_out=leave_out,
        recipe=recipe,
        settings=settings,
    )
    options: dict[str, Any] = {"resume": resume, "track": track}
    return run_tuning(config, dataset, out, task=task, progress=progress, **options)


def run_tuning(config: "FinetuneConfig", dataset: PathLike, out: PathLike, **options: Any) -> Tuned:
    """Tune with settings of `settings_of`; `options` and errors as `finetune`."""
    scores = tune(config, Path(dataset), Path(out), **options)
    report = json.loads((Path(out) / "report.json").read_text(encoding="utf-8"))
    best, warnings = Path(out) / "best", warnings_of(scores)
    if find_spec("onnx") is None:
        warnings.append(NO_GRAPH.format(best))
    return Tuned(best, scores, report["delivered"], report["conventions"], tuple(warnings))


def settings_of(
    dataset: PathLike,
    *,
    base: str | None = None,
    rig: str | None = None,
    mapping: PathLike | None = None,
    leave_out: str | None = None,
    recipe: PathLike | None = None,
    settings: Mapping[str, Any] | None = None,
    overrides: Sequence[str] = (),
) -> "FinetuneConfig":
    """Settings of a tuning; parameters and errors as `finetune`.

    `overrides` are texts ``section.key=value``, which win.
    """
    given = {
        "model.control_set": rig_of_dataset(Path(dataset), rig),
        "tune.map": None if mapping is None else str(mapping),
        "tune.leave_out": leave_out,
        **(settings or {}),
    }
    named = [f"{key}={json.dumps(value)}" for key, value in given.items() if value is not None]
    path = None if recipe is None else Path(recipe)
    return read_recipe(path, [*named, *overrides], base=base)
