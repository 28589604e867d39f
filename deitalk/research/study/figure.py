"""Figure of a study: shares of choices with their intervals."""

from pathlib import Path
from typing import Any

from deitalk.evaluation.figures import drawing


def draw(report: dict[str, Any], path: Path) -> None:
    """Draw the shares of a report of `deitalk.research.study.report.report_study`.

    Parameters
    ----------
    report : dict
        A panel a task; a row a pair, or a system where three are side by side.
    path : Path
        .png, .svg or .pdf.

    Raises
    ------
    MissingError
        If matplotlib is not installed.
    """
    tasks = report["tasks"]
    most = max((len(s["pairs"] or s["chosen"]) for s in tasks.values()), default=1)
    with drawing(path, (5 * max(len(tasks), 1), 1.2 + 0.5 * most), dpi=110) as figure:
        for axis, (task, scores) in zip(
            figure.subplots(1, max(len(tasks), 1), squeeze=False)[0], tasks.items(), strict=True
        ):
            _panel(axis, task, scores)


def _panel(axis: Any, task: str, scores: dict[str, Any]) -> None:
    rows = scores["pairs"] or scores["chosen"]
    chance = 0.5 if scores["pairs"] else 1 / 3
    for place, share in enumerate(rows.values()):
        axis.plot([share["low"], share["high"]], [place, place], color="C0", linewidth=2)
        axis.plot(share["share"], place, "o", color="C0")
    axis.axvline(chance, color="0.6", linestyle="--", linewidth=1)
    axis.set_yticks(range(len(rows)), list(rows))
    axis.set_ylim(len(rows) - 0.5, -0.5)
    axis.set_xlim(0, 1)
    axis.set_xlabel("share of the choices, 95 % interval")
    axis.set_title(task, loc="left")
