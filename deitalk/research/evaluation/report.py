"""Reports of evaluations as Markdown and JSON, with the hash of what they measured."""

import hashlib
from importlib import resources
from pathlib import Path
from typing import Any

from deitalk.audio.frames import FRAME_RATE
from deitalk.evaluation.report import as_json, cell, rows_of, table
from deitalk.research.evaluation.ridge import losses
from rig.files import atomic_write

MOST_PHONES = 6
"""Sounds of each group in the table of shut lips."""


def write_json(path: Path | None, report: dict[str, Any]) -> None:
    """Write a report as JSON; nothing without a path."""
    if path is not None:
        with atomic_write(path) as beside:
            beside.write_text(as_json(report), encoding="utf-8")


def identified(model: str) -> dict[str, str]:
    """Name and hash of the weights of a model, for its reports."""
    from deitalk.models.folder import model_folder, weights_hash

    return {"model": model, "sha256": weights_hash(model_folder(model))}


def shipped(package: str, name: str) -> dict[str, dict[str, str]]:
    """Hash of a file of the package, for reports of what it holds."""
    content = resources.files(package).joinpath(name).read_bytes()
    return {"files": {f"{package.replace('.', '/')}/{name}": hashlib.sha256(content).hexdigest()}}


def as_markdown(report: dict[str, Any]) -> str:
    """Markdown tables of scores per group, phones, styles, modified prosody and noise."""
    parts = [
        f"Split: {report['split']}. LPE over {report['lpe_set']}; EPE over {report['epe_set']}, of "
        "acted takes; both in squared control units.",
        "",
        "As `deitalk animate` returns them:",
        "",
        *table("", report["groups"]),
        "",
        "The network alone:",
        "",
        *table("", report["network"]),
        *_ridge(report),
        *_phones(report.get("phones", {})),
        *_shut(report.get("shut", {})),
        *_styles(report.get("styles", {})),
    ]
    if "contours" in report:
        parts += ["", "Rank correlation with the contour of modified recordings:", ""]
        parts += table("", report["contours"])
    if "noise" in report:
        parts += ["", "In noise:", "", *table("", report["noise"])]
    if "captured" in report:
        parts += ["", "Smoothness of the captured curves:", ""]
        parts += [f"- {name}: {cell(value)}" for name, value in report["captured"].items()]
    return "\n".join(parts) + "\n"


def _ridge(report: dict[str, Any]) -> list[str]:
    """Contacts by ridge regressions, and where the curves lie below the one on own features."""
    lines: list[str] = []
    for name, groups in report.get("ridge", {}).items():
        title = f"Contacts by a ridge regression of features ({name}):"
        lines += ["", title, "", *table("", groups)]
    return [*lines, "", losses(report["groups"], report["ridge"]["own"])] if lines else []


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
    return ["", title, "", *rows_of(["", "gesture", "phone", "n", "found", "AUC"], rows)]


def _shut(groups: dict[str, Any]) -> list[str]:
    """The sounds on which the lips are shut most, of those with a second of frames."""
    rows = [
        [name, phone, score["n"], score["shut"]]
        for name, phones in groups.items()
        for phone, score in sorted(phones.items(), key=lambda item: -item[1]["shut"])[:MOST_PHONES]
        if score["n"] >= FRAME_RATE
    ]
    if not rows:
        return []
    title = "Share of frames with shut lips on sounds other than p b m f v; the highest:"
    return ["", title, "", *rows_of(["", "phone", "frames", "shut"], rows)]


def _styles(groups: dict[str, Any]) -> list[str]:
    lines: list[str] = []
    for name, scores in groups.items():
        lines += [
            "",
            f"Styles on {scores['recordings']} recordings of {name}: spread over recordings and "
            "distance of mean faces in control units; range: factors on the neutral range of the "
            "opening of the embedded head's lips.",
            "",
            *table("", scores["styles"]),
        ]
    return lines
