"""Reports of the evaluation: Markdown tables, and JSON without NaN."""

import json
import math
from collections.abc import Sequence
from typing import Any


def as_json(report: dict[str, Any]) -> str:
    """JSON; values that are not finite are null."""
    return json.dumps(_known(report), indent=1) + "\n"


def _known(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _known(item) for key, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def as_markdown(report: dict[str, Any]) -> str:
    """Markdown tables of scores per group, phones, emotions, modified prosody and noise."""
    parts = [
        f"Split: {report['split']}. LPE over {report['lpe_set']}; EPE over {report['epe_set']}; "
        "both in squared control units.",
        "",
        *table("", report["groups"]),
        *_phones(report.get("phones", {})),
        *_emotions(report.get("emotions", {})),
    ]
    if "lively" in report:
        parts += ["", "Takes of raised against lowered prosody of one recording:", ""]
        parts += table("", report["lively"])
    if "noise" in report:
        parts += ["", "In noise:", "", *table("", report["noise"])]
    if "captured" in report:
        parts += ["", "Smoothness of the captured curves:", ""]
        parts += [f"- {name}: {_cell(value)}" for name, value in report["captured"].items()]
    return "\n".join(parts) + "\n"


def table(corner: str, columns: dict[str, dict[str, Any]]) -> list[str]:
    """Table with a column per key and a row per name of any column."""
    names = list(dict.fromkeys(name for column in columns.values() for name in column))
    rows = [[name, *(column.get(name) for column in columns.values())] for name in names]
    return _rows([corner, *columns], rows)


def _rows(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[str]:
    lines = ["| " + " | ".join(header) + " |", "|---" * len(header) + "|"]
    return lines + ["| " + " | ".join(_cell(cell) for cell in row) + " |" for row in rows]


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    return f"{value:.4g}" if isinstance(value, int | float) else str(value)


def _phones(groups: dict[str, Any]) -> list[str]:
    if not groups:
        return []
    rows = [
        [name, gesture, phone, score["n"], score["hits"], score["auc"]]
        for name, gestures in groups.items()
        for gesture, phones in gestures.items()
        for phone, score in phones.items()
        if score["n"]
    ]
    title = "By phone; hit rate at 5 % false alarms over the counter-examples:"
    return ["", title, "", *_rows(["", "gesture", "phone", "n", "found", "AUC"], rows)]


def _emotions(groups: dict[str, Any]) -> list[str]:
    lines: list[str] = []
    for name, scores in groups.items():
        lines += [
            "",
            f"Emotions on {scores['recordings']} recordings of {name}: "
            f"{scores['recognised']:.0%} recognised, neutral stays in "
            f"{scores['neutral_stays']:.0%}. Given emotion in rows, recognised in columns:",
            "",
            *_rows(["", *scores["named"]], [[k, *v.values()] for k, v in scores["named"].items()]),
            "",
            "Factor on the neutral range of the mouth's opening:",
            "",
            *table(
                "",
                {
                    "predicted intensity": scores["range"],
                    "intensity 1": scores["range_strong"],
                    "intensity 1, jaw alone": scores["range_jaw"],
                },
            ),
            "",
            "Distance of two faces (control units, Euclidean, mean of the frames):",
            "",
            *[f"- {pair}: {value:.3f}" for pair, value in scores["distances"].items()],
        ]
    return lines
