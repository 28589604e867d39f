"""Figure of the evaluation: closures, channels, styles, noise."""

from pathlib import Path
from typing import Any

import numpy as np

from deitalk.emotions import EMOTIONS
from deitalk.evaluation.figures import drawing


def draw_evaluation(report: dict[str, Any], path: Path) -> None:
    """Draw a report of `deitalk.research.evaluation.curves.evaluate`.

    Parameters
    ----------
    report : dict
        Groups, phones, styles and noise; the panel of a missing part is empty.
    path : Path
        .png, .svg or .pdf.

    Raises
    ------
    MissingError
        If matplotlib is not installed.
    """
    with drawing(path, (13, 8), dpi=100) as figure:
        axes = figure.subplots(2, 2)
        _phones(axes[0, 0], report["phones"])
        _channels(axes[0, 1], report["groups"])
        _distances(axes[1, 0], report.get("styles", {}))
        _noise(axes[1, 1], report.get("noise", {}))


def _bars(axis: Any, title: str, series: dict[str, dict[str, float]]) -> None:
    """Draw grouped bars: one colour per series, one group per name.

    Series whose labels have spaces are parts of others, and left out.
    """
    series = {label: values for label, values in series.items() if " " not in label}
    axis.set_title(title, loc="left")
    names = list(dict.fromkeys(name for values in series.values() for name in values))
    width = 0.8 / max(len(series), 1)
    for i, (label, values) in enumerate(series.items()):
        heights = [values.get(name, np.nan) for name in names]
        axis.bar(np.arange(len(names)) + i * width, heights, width, label=label)
    axis.set_xticks(np.arange(len(names)) + 0.4 - width / 2, names, rotation=40, ha="right")
    axis.set_ylim(0, 1.15)  # room for the legend
    if series:
        axis.legend(fontsize=7, frameon=False, loc="upper center", ncols=len(series))


def _phones(axis: Any, groups: dict[str, Any]) -> None:
    series = {
        name: {p: s["hits"] for phones in gestures.values() for p, s in phones.items() if s["n"]}
        for name, gestures in groups.items()
    }
    _bars(axis, "hit rate at 5 % false alarms over the counter-examples", series)


def _channels(axis: Any, groups: dict[str, dict[str, Any]]) -> None:
    series = {
        name: {k.removeprefix("r "): v for k, v in scores.items() if k.startswith("r ")}
        for name, scores in groups.items()
    }
    _bars(axis, "correlation with the procedural target, per channel", series)


def _distances(axis: Any, groups: dict[str, Any]) -> None:
    matrix = np.zeros((len(EMOTIONS), len(EMOTIONS)))
    for scores in groups.values():
        for pair, value in scores["distances"].items():
            i, j = (EMOTIONS.index(name) for name in pair.split("-"))
            matrix[[i, j], [j, i]] += value / len(groups)
    axis.imshow(matrix, cmap="viridis", vmax=1.5 * matrix.max() or 1.0)
    axis.set_xticks(range(len(EMOTIONS)), EMOTIONS)
    axis.set_yticks(range(len(EMOTIONS)), EMOTIONS)
    for (i, j), value in np.ndenumerate(matrix):
        axis.text(j, i, f"{value:.2f}", ha="center", va="center", color="w")
    axis.set_title("distance of two styles' mean faces, control units", loc="left")


def _noise(axis: Any, steps: dict[str, dict[str, float]]) -> None:
    for name in ("bilabial_window_auc", "bilabial_hits_at_5_percent", "jaw_r"):
        axis.plot([scores[name] for scores in steps.values()], marker="o", label=name)
    axis.set_xticks(range(len(steps)), list(steps))
    axis.set_ylim(0, 1)
    axis.legend(fontsize=7, frameon=False)
    axis.set_title("in noise", loc="left")
