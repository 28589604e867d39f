"""Ablations: variants of a configuration, trained with several seeds and scored.

A variant is a file of a few lines: a base configuration and overrides (``configs/ablations/``).
``ablate`` trains every variant in a folder of its own and resumes what was interrupted::

    OUT/<variant>/seed0/      a run folder (see `deitalk.training.run_folder`)
    OUT/<variant>/seed0/report.json    its evaluation; a run that has one is done
    OUT/ablations.json, OUT/ablations.md

Variants of a mesh model share the meshes that the first run builds of the dataset folder.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.config.curves import Config
from deitalk.config.finetuning import FinetuneConfig
from deitalk.config.load import AnyConfig, load_config
from deitalk.config.yaml_files import read_yaml
from deitalk.data.frozen_features import FrozenFeatures
from deitalk.errors import ConfigError, DataError
from deitalk.evaluation.report import as_json
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.mesh_model import MeshModel
from deitalk.research.config import MeshTrainingConfig, TrainingConfig, read_training
from deitalk.research.evaluation.curves import evaluate
from deitalk.research.meshes.scores import evaluate_mesh
from deitalk.research.meshes.training import train_mesh
from deitalk.research.training.curves import train_curves
from rig.files import atomic_write, begin_folder, claim, replace_recorded

METRICS = {
    "lpe": "LPE", "epe": "EPE", "bilabial_window_auc": "bilabial AUC",
    "bilabial_hits_at_5_percent": "bilabials found", "jaw_r": "jaw r",
    "articulation_r": "mean r", "intensity_rho": "intensity Spearman",
    "jerk_per_speed": "jerk / speed", "separation": "style separation",
}  # fmt: skip
"""Scores of curves that are in the tables, and their titles there."""
MESH_METRICS = {
    "lips_mm": "lips, mm", "still_mm": "at rest, mm", "bilabial_closed": "p b m closed",
    "unsealed_bilabial_closed": "closed before the seal",
    "unsealed_bilabial_gap_mm": "median gap before the seal, mm", "vowel_closed": "vowels closed",
}  # fmt: skip
"""The same of meshes."""
PREDICTIONS = {"network": "the network alone", "groups": "with the rules of the model"}
"""Parts of the evaluation that are compared: rules after a network hide what it lacks."""
MESHES = {"groups": "meshes"}
FULL = "full"
"""The variant that comes first in the table."""
KIND = "ablations"
"""Kind of the folder in its manifest."""
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Variant:
    """One configuration to train."""

    name: str
    base: Path
    overrides: tuple[str, ...]

    def config(self, seed: int, steps: int | None, common: Sequence[str] = ()) -> AnyConfig:
        """Configuration of one run; `common` are overrides that every variant has."""
        run = [f"name={self.name}", f"train.seed={seed}"]
        if steps is not None:
            run += [f"train.steps={steps}"]
        return read_training(self.base, [*common, *self.overrides, *run])


def read_variants(folder: Path) -> list[Variant]:
    """Variants of a folder, `FULL` first.

    Raises
    ------
    ConfigError
        If there is none, a file is not a base and a list of overrides, or some are of curves
        and some of meshes.
    """
    files = sorted(folder.glob("*.yaml"), key=lambda path: (path.stem != FULL, path.stem))
    if not files:
        raise ConfigError(f"{folder}: holds no .yaml; each gives a base and overrides")
    variants = [_variant(path) for path in files]
    configs = [variant.config(0, None) for variant in variants]
    is_tuning = any(isinstance(config, FinetuneConfig) for config in configs)
    if is_tuning or len({isinstance(config, Config) for config in configs}) > 1:
        raise ConfigError(f"{folder}: base all variants on configurations of curves, or of meshes")
    return variants


def _variant(path: Path) -> Variant:
    tree = read_yaml(path)
    if not isinstance(tree, dict) or set(tree) != {"base", "overrides"}:
        raise ConfigError(f"{path}: needs two keys, base (a file) and overrides (a list)")
    base, overrides = tree["base"], tree["overrides"]
    if not isinstance(base, str) or not isinstance(overrides, list):
        raise ConfigError(f"{path}: base={base!r} must be a file, overrides={overrides!r} a list")
    variant = Variant(path.stem, path.parent / base, tuple(map(str, overrides)))
    variant.config(0, None)  # a wrong key is an error before hours of training
    return variant


def ablate(
    variants: Sequence[Variant],
    data: Path,
    out: Path,
    *,
    steps: int | None = None,
    seeds: int = 3,
    split: str = "test",
    most: int | None = None,
    probes: int = 4,
    overrides: Sequence[str] = (),
    progress: Progress = lambda run, share: None,
) -> dict[str, Any]:
    """Train and evaluate every variant with every seed; finished runs are not repeated.

    Parameters
    ----------
    variants : sequence of Variant
        From `read_variants`.
    data : Path
        Dataset folder.
    out : Path
        Folder of the runs and of the table.
    steps : int or None
        Steps of every run; None: as configured.
    seeds : int
        Runs of every variant.
    split, most, probes
        As for `deitalk.research.evaluation.curves.evaluate`.
    overrides : sequence of str
        For all variants, such as ``data.noise_folder=noise``.
    progress : callable
        Called with the run and the share of its training that is done.

    Returns
    -------
    dict
        Variant: {prediction: {source: {metric: {mean, sd, n}}}}, predictions being `PREDICTIONS`;
        written to `out` too.

    Raises
    ------
    ConfigError, DataError
        If `out` holds runs with other settings, or the data lacks a split.
    rig.errors.TargetError
        If `out` holds what no ablation wrote, its table was edited, or another process writes
        there.
    """
    with claim(out):
        begin_folder(out, kind=KIND)
        options = {"split": split, "most": most, "probes": probes}
        return _ablate(variants, data, out, steps, seeds, options, overrides, progress)


def _ablate(
    variants: Sequence[Variant],
    data: Path,
    out: Path,
    steps: int | None,
    seeds: int,
    options: dict[str, Any],
    overrides: Sequence[str],
    progress: Progress,
) -> dict[str, Any]:
    """Every run and the table, in a folder that is held; one seed after another."""
    reports: dict[str, list[dict[str, Any]]] = {variant.name: [] for variant in variants}
    table: dict[str, Any] = {}
    frozen_features = lru_cache(FrozenFeatures)  # computed once for all runs
    options = {"data": str(data.resolve()), **options}
    for seed in range(seeds):
        for variant in variants:
            folder = out / variant.name / f"seed{seed}"
            config = variant.config(seed, steps, overrides)
            meshes = out / variants[0].name / "seed0" / "meshes"
            source = meshes if isinstance(config, MeshTrainingConfig) and meshes.is_dir() else data
            report = _report(folder, config, source, options, progress, frozen_features)
            reports[variant.name].append(report)
            table[variant.name] = _summary(reports[variant.name])
            _write(out, table, options["split"], seed + 1)
    return table


def _report(
    folder: Path,
    config: AnyConfig,
    source: Path,
    options: dict[str, Any],
    progress: Progress,
    frozen_features: Callable[[str], FrozenFeatures],
) -> dict[str, Any]:
    """The evaluation of one run: read, or made; `source` trains it."""
    path = folder / "report.json"
    name = f"{folder.parent.name} {folder.name}"
    if path.is_file():
        return _finished(path, config, options)
    _train(folder, config, source, frozen_features, lambda share: progress(name, share))
    report = _evaluate(folder / "best", config, options)
    with atomic_write(path) as beside:
        beside.write_text(as_json(report | {"asked": options}), encoding="utf-8")
    loaded: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return loaded


def _evaluate(model: Path, config: AnyConfig, options: dict[str, Any]) -> dict[str, Any]:
    data = Path(options["data"])
    chosen = {key: options[key] for key in ("split", "most")}
    if isinstance(config, MeshTrainingConfig):
        return evaluate_mesh(require_model(model, MeshModel), data, **chosen)
    return evaluate(require_model(model, DEITalk), data, probes=options["probes"], **chosen)


def _finished(path: Path, config: AnyConfig, options: dict[str, Any]) -> dict[str, Any]:
    """Read a finished report; check that it is of the same settings."""
    try:
        report: dict[str, Any] = dict(json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, TypeError, RecursionError):
        raise DataError(f"{path}: no evaluation; remove it to evaluate the run again") from None
    if load_config(path.parent / "config.yaml") != config or report.get("asked") != options:
        raise DataError(
            f"{path.parent}: was trained or evaluated with other settings; "
            "use the same settings, or name another folder"
        )
    return report


def _train(
    folder: Path,
    config: AnyConfig,
    data: Path,
    frozen_features: Callable[[str], FrozenFeatures],
    progress: Callable[[float], None],
) -> None:
    def report_step(step: int, total: int, _values: Any) -> None:
        progress(step / total)

    if isinstance(config, MeshTrainingConfig):
        train_mesh(config, data, folder, resume=True, progress=report_step)
        return
    assert isinstance(config, TrainingConfig)
    frozen = config.train.frozen_frontend
    features = None if frozen is None else frozen_features(frozen)
    train_curves(config, data, folder, resume=True, frozen_features=features, progress=report_step)


def _summary(reports: Sequence[dict[str, Any]]) -> dict[str, dict[str, dict[str, Any]]]:
    """Mean and standard deviation over the seeds, per prediction and source."""
    predictions, metrics = _shown(reports[0])
    return {
        prediction: {
            source: {metric: _spread(reports, prediction, source, metric) for metric in metrics}
            for source in reports[0]["groups"]
        }
        for prediction in predictions
    }


def _shown(report: dict[str, Any]) -> tuple[dict[str, str], dict[str, str]]:
    """Titles of the predictions and of the metrics of a report or of a row of the table."""
    return (PREDICTIONS, METRICS) if "network" in report else (MESHES, MESH_METRICS)


def _spread(
    reports: Sequence[dict[str, Any]], prediction: str, source: str, metric: str
) -> dict[str, float]:
    values = [_value(report, prediction, source, metric) for report in reports]
    finite = [value for value in values if value is not None]
    if not finite:
        return {"mean": float("nan"), "sd": float("nan"), "n": 0}
    sd = float(np.std(finite, ddof=1)) if len(finite) > 1 else float("nan")
    return {"mean": float(np.mean(finite)), "sd": sd, "n": len(finite)}


def _value(report: dict[str, Any], prediction: str, source: str, metric: str) -> float | None:
    """A score; the separation of styles is that of the two nearest, with the model's rules."""
    if metric == "separation":
        styles = report.get("styles", {}).get(source, {}).get("styles", {})
        known = [style["separation"] for style in styles.values() if style["separation"]]
        return min(known) if known and prediction == "groups" else None
    value: float | None = report[prediction].get(source, {}).get(metric)
    return value


def _write(out: Path, table: dict[str, Any], split: str, seeds: int) -> None:
    replace_recorded(out, "ablations.json", as_json(table))
    replace_recorded(out, "ablations.md", as_markdown(table, split, seeds))


def as_markdown(table: dict[str, Any], split: str, seeds: int) -> str:
    """Two tables a source: variants down, metrics across, mean ± standard deviation."""
    lines = [f"Split: {split}; {seeds} seeds, mean ± standard deviation."]
    predictions, metrics = _shown(next(iter(table.values())))
    first = next(iter(predictions))
    sources = list(dict.fromkeys(source for scores in table.values() for source in scores[first]))
    for source in sources:
        for prediction, title in predictions.items():
            lines += ["", f"## {source}, {title}", "", "| | " + " | ".join(metrics.values()) + " |"]
            lines.append("|---" * (len(metrics) + 1) + "|")
            for name, scores in table.items():
                row = scores[prediction].get(source, {})
                cells = [_cell(row.get(metric)) for metric in metrics]
                lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _cell(score: dict[str, float] | None) -> str:
    if score is None or not score["n"]:
        return "–"
    shown = f"{score['mean']:.3g}"
    return shown if score["n"] < 2 else f"{shown} ± {score['sd']:.2g}"
