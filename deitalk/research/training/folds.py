"""Every take or every actor left out in turn: how well a tuned model does on what it never saw.

Of minutes of captures one test take says little, and depends on which. Each fold is a run folder
(see `deitalk.training.run_folder`)::

    OUT/<take or actor>/     tuned on all others, tested on this one
    OUT/features/            of the frozen frontend, for all of them
    OUT/folds.json, OUT/folds.md
"""

import json
import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.config.finetuning import FinetuneConfig
from deitalk.data.captures.splits import names_of
from deitalk.data.clips import read_clips
from deitalk.data.frozen_features import FrozenFeatures
from deitalk.errors import DataError
from deitalk.evaluation.report import as_json, table, turned
from deitalk.training.trainer import Progress, silent
from deitalk.training.tuning.task import ABOUT, finetune
from rig.errors import quoted
from rig.files import begin_folder, claim, replace_recorded

KINDS = ("takes", "actors")
KIND = "folds"
"""Kind of the folder in its manifest."""


def tune_folds(
    config: FinetuneConfig,
    data: Path,
    out: Path,
    kind: str,
    *,
    resume: bool = False,
    track: Sequence[str] = (),
    progress: Progress = silent,
) -> dict[str, Any]:
    """Tune a model without each take or actor, and test it there.

    Parameters
    ----------
    config : FinetuneConfig
        From `deitalk.training.tuning.recipe.read_recipe`; `TuneConfig.leave_out` is set by fold.
    data : Path
        Dataset folder of captures.
    out : Path
        Folder of the runs.
    kind : {"takes", "actors"}
        What is left out in turn.
    resume : bool
        Continue the folds that were begun.
    track : sequence of str
        As for `finetune`, of each fold.
    progress : callable
        Called with the step among those of all folds.

    Returns
    -------
    dict
        ``base``, ``start``, ``part``, ``base_sha256``: what was tuned; ``mean``: scores of each
        system, means over the folds; ``folds``: the tuned model's by fold; ``controls``: scores of
        each control that moves, means over the folds.

    Raises
    ------
    DataError
        If `kind` is another, there are fewer than two takes or actors, or two of them would have
        one folder; and as `finetune`.
    """
    if kind not in KINDS:
        raise DataError(f"`folds={kind}` must be one of {', '.join(KINDS)}", parameter="folds")
    if config.tune.leave_out is not None:
        raise DataError("folds leave out each in turn: no `leave_out`", parameter="leave_out")
    names = names_of(read_clips(data), kind)
    if len(names) < 2:
        raise DataError(
            f"{data}: folds of {kind} need two; here is {names[0]} alone", parameter="folds"
        )
    _check_folders(data, names)
    is_frozen = config.tune.part != "all"
    features = FrozenFeatures(config.tune.base, out / "features") if is_frozen else None
    run = partial(finetune, data=data, resume=resume, track=track, frozen_features=features)
    with claim(out):
        begin_folder(out, kind=KIND)
        reports = {
            name: _fold(run, config, out, name, _part(progress, place, len(names)))
            for place, name in enumerate(names)
        }
        result = _joined(reports)
        replace_recorded(out, "folds.json", as_json(result))
        replace_recorded(out, "folds.md", _markdown(result, kind))
    return result


def _part(progress: Progress, done: int, folds: int) -> Progress:
    """Progress of a fold as a part of that of all."""
    return lambda step, total, values: progress(done * total + step, folds * total, values)


def _fold(
    run: Callable[..., Any], config: FinetuneConfig, out: Path, name: str, progress: Progress
) -> dict[str, Any]:
    """Report of one fold, as ``report.json`` has it."""
    folder = out / _as_file(name)
    tune = config.tune.model_copy(update={"leave_out": name})
    fold = config.model_copy(update={"tune": tune})
    run(fold, out=folder, progress=progress)
    report: dict[str, Any] = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    return report


def _check_folders(data: Path, names: Sequence[str]) -> None:
    """Names that differ in case or signs only would share a run folder, and its scores."""
    first: dict[str, str] = {}
    for name in names:
        other = first.setdefault(_as_file(name).lower(), name)
        if other != name:
            raise DataError(
                f"{data}: {quoted(other)} and {quoted(name)} would have one folder of runs; "
                "rename one",
                parameter="folds",
            )


def _as_file(name: str) -> str:
    """A name without separators of folders."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name).lstrip(".") or "_"


def _joined(reports: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Means over the folds, and the tuned model's scores of each."""
    first = next(iter(reports.values()))
    scores = [report["scores"] for report in reports.values()]
    controls = [report["controls"] for report in reports.values()]
    return {
        **{name: first[name] for name in (*ABOUT, "base_sha256")},
        "mean": _means(scores),
        "folds": {name: report["scores"]["after"] for name, report in reports.items()},
        "controls": _means(controls),
    }


def _means(tables: list[dict[str, dict[str, float | None]]]) -> dict[str, dict[str, float]]:
    """Mean of every cell over the tables that have it."""
    rows = dict.fromkeys(row for cells in tables for row in cells)
    means = {}
    for row in rows:
        names = dict.fromkeys(name for cells in tables for name in cells.get(row, {}))
        values = {name: [cells.get(row, {}).get(name) for cells in tables] for name in names}
        means[row] = {name: _mean(each) for name, each in values.items()}
    return means


def _mean(values: list[float | None]) -> float:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else math.nan


def _markdown(result: dict[str, Any], kind: str) -> str:
    lines = [
        f"# {len(result['folds'])} folds",
        "",
        f"Models tuned without one of the {kind}, on that one; means over the folds. The scores "
        "are those of a run's report.md.",
        "",
        *table("", result["mean"]),
        "",
        "The tuned models:",
        "",
        *table("", result["folds"]),
        "",
        "Controls that move, means over the folds:",
        "",
        *table("", turned(result["controls"])),
        "",
    ]
    return "\n".join(lines)
