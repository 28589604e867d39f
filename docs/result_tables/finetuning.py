"""Tables of docs/finetuning.md."""

from result_tables.commands import LIP_SPEAKERS
from result_tables.common import Group, report, short, table

FOLDS = ("error_of_mean_pose", "error_at_best_gain", "mean_r", "range")
"""Scores of a fine-tuning on what it never saw."""


def captured_lips() -> str:
    """Measured lips as a rig, speakers left out; FACEGOOD's takes, left out in turn."""
    systems = {}
    for speaker in LIP_SPEAKERS:
        found = report(f"captured-lips-{speaker}")
        systems[f"{speaker}, tuned"] = found["scores"]["after"]
        systems[f"{speaker}, loudness"] = found["scores"]["loudness"]
    takes = report("facegood")["mean"]
    systems |= {
        "FACEGOOD, nearest style": takes["after"],
        "FACEGOOD, mean style": takes["after, mean style"],
        "FACEGOOD, loudness": takes["loudness"],
    }
    return table(_systems(f"left out, from weights {found['base_sha256'][:8]}…", systems))


def _systems(title: str, systems: dict[str, Group]) -> list[list[str]]:
    """Scores down, systems across."""
    rows = [[f"`{s}`", *(_known(scores[s]) for scores in systems.values())] for s in FOLDS]
    return [[title, *systems], *rows]


def _known(value: float | None) -> str:
    return "–" if value is None else short(value)
