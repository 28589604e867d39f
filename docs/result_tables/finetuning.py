"""Tables of docs/finetuning.md."""

from result_tables.commands import LIP_SPEAKERS
from result_tables.common import Group, report, short, table

FOLDS = ("error_of_mean_pose", "error_at_best_gain", "mean_r", "range")
"""Scores of a fine-tuning on what it never saw."""

FACEGOOD_JAW = "mouth_stretch_c"


def facegood() -> str:
    """A rig of its own, each take left out in turn."""
    named, one = report("facegood"), report("facegood-one")
    systems = {"tuned, hands named": named["mean"]["after"], "one actor": one["mean"]["after"]}
    rs = [short(found["controls"][FACEGOOD_JAW]["after_r"]) for found in (named, one)]
    jaw = [f"r of `{FACEGOOD_JAW}`", *rs, "–", "–"]
    title = f"mean of the folds, from weights {named['base_sha256'][:8]}…"
    return table([*_systems(title, systems | _baselines(one["mean"])), jaw])


def captured_lips() -> str:
    """Measured lips as a rig, speakers left out."""
    systems = {}
    for speaker in LIP_SPEAKERS:
        found = report(f"captured-lips-{speaker}")
        systems[f"{speaker}, tuned"] = found["scores"]["after"]
        systems[f"{speaker}, loudness"] = found["scores"]["loudness"]
    return table(_systems(f"left out, from weights {found['base_sha256'][:8]}…", systems))


def from_nothing() -> str:
    """A left-out take: the tuned model, and its network from random weights on the same data."""
    take, found = "2_01", report("facegood-nothing")["scores"]
    systems = {"tuned": report("facegood-one")["folds"][take], "from nothing": found["after"]}
    return table(_systems(f"{take} left out", systems | _baselines(found)))


def _baselines(scores: dict[str, Group]) -> dict[str, Group]:
    return {name: scores[name] for name in ("loudness", "mean pose")}


def _systems(title: str, systems: dict[str, Group]) -> list[list[str]]:
    """Scores down, systems across."""
    rows = [[f"`{s}`", *(_known(scores[s]) for scores in systems.values())] for s in FOLDS]
    return [[title, *systems], *rows]


def _known(value: float | None) -> str:
    return "–" if value is None else short(value)
