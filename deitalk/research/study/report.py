"""The report of a study: preferences with intervals, strengths, agreement, exclusions."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

from deitalk.evaluation.report import table
from deitalk.research.study.answers import Answers, Choice
from deitalk.research.study.statistics import Share, agreement, share_of, strengths


def report_study(key: Mapping[str, Any], answers: Answers) -> dict[str, Any]:
    """Preferences of every task.

    Parameters
    ----------
    key : mapping
        From `deitalk.research.study.answers.read_key`.
    answers : Answers
        From `read_answers`.

    Returns
    -------
    dict
        ``raters``, ``excluded``; ``tasks``: per task ``pairs`` (``first over second``: `Share`),
        ``chosen`` (per system, of the trials that show it, chance 1 over the number side by side),
        ``strengths`` (per system, Luce's log strength with its interval over raters),
        ``left`` (share of the leftmost) and ``agreement``.
    """
    systems = list(key["systems"])
    tasks = [t for t in key["tasks"] if any(c.task == t for c in answers.choices)]
    return {
        "study": key["study"],
        "systems": systems,
        "raters": answers.raters,
        "excluded": answers.excluded,
        "tasks": {
            task: _task(systems, [c for c in answers.choices if c.task == task]) for task in tasks
        },
    }


def _task(systems: Sequence[str], choices: Sequence[Choice]) -> dict[str, Any]:
    size = len(choices[0].systems)
    places = {name: k for k, name in enumerate(systems)}
    by_rater: dict[str, list[tuple[list[int], int]]] = {}
    units: dict[Any, list[str]] = {}
    for choice in choices:
        row = ([places[name] for name in choice.systems], places[choice.chosen])
        by_rater.setdefault(choice.rater, []).append(row)
        units.setdefault((choice.item, frozenset(choice.systems)), []).append(choice.chosen)
    best, low, high = strengths(by_rater, len(systems))
    return {
        "choices": len(choices),
        "pairs": {
            f"{a} over {b}": _share(
                [c for c in choices if set(c.systems) == {a, b}], a, 0.5
            )._asdict()
            for a, b in combinations(systems, 2)
            if size == 2
        },
        "chosen": {
            name: _share([c for c in choices if name in c.systems], name, 1 / size)._asdict()
            for name in systems
        },
        "strengths": {
            name: {"strength": best[k], "low": low[k], "high": high[k]}
            for k, name in enumerate(systems)
        },
        "left": share_of(
            sum(c.chosen == c.systems[0] for c in choices), len(choices), 1 / size
        )._asdict(),
        "agreement": agreement(units),
    }


def _share(choices: Sequence[Choice], name: str, chance: float) -> Share:
    return share_of(sum(c.chosen == name for c in choices), len(choices), chance)


def as_markdown(report: Mapping[str, Any]) -> str:
    """The report as tables."""
    lines = [f"# Study {report['study']}", "", f"{report['raters']} raters."]
    if report["excluded"]:
        lines += ["", f"Left out: {len(report['excluded'])}."]
        lines += [f"- {name}: {reason}" for name, reason in report["excluded"].items()]
    lines += [
        "",
        "Shares with exact 95 % intervals and two-sided p (choices as independent); strengths with "
        "95 % intervals over raters.",
    ]
    for task, scores in report["tasks"].items():
        lines += ["", f"## {task}", ""]
        lines += table("", scores["pairs"] or scores["chosen"])
        lines += ["", *table("", scores["strengths"])]
        left, alpha = scores["left"], scores["agreement"]
        lines += [
            "",
            f"{scores['choices']} choices; leftmost chosen in {left['share']:.0%} "
            f"(p {left['p']:.2g}); agreement of raters, Krippendorff's alpha: {alpha:.2f}",
        ]
    return "\n".join(lines) + "\n"
