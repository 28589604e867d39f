"""Which clips every rater compares, in which order, and on which side.

The tasks are those of the two papers: the whole face, the lips (everything above the nose covered),
the emotion (everything below it covered) and how strongly it is shown (DEITalk §4.4); raters can
play at half speed, answer only after all clips have been played, and pass trials with an obvious
answer (SDFA §5.3).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, permutations
from typing import Any

import numpy as np

from deitalk.errors import DataError

TASKS = {
    "realism": "Which face looks more real?",
    "lips": "Which mouth fits the speech better?",
    "emotion": "Which face shows the emotion of the voice better?",
    "intensity": "Which face follows better how strongly the voice is moved?",
}
"""Question of every task. Of ``lips`` the upper half of the picture is covered, of ``emotion`` the
lower half."""
CHECKS = 3
"""Trials with an obvious answer that a rater gets."""
CHECK, PRACTICE = "check", "practice"
MOST_SYSTEMS = 6
MOST_TRIALS = 400
"""Trials of one rater."""


@dataclass(frozen=True)
class Trial:
    """Systems that are compared on one item in one task."""

    id: str
    item: str
    task: str
    systems: tuple[str, ...]


def all_trials(
    systems: Sequence[str], items: Sequence[str], tasks: Sequence[str], size: int
) -> list[Trial]:
    """Every item in every task, with every combination of `size` systems.

    Raises
    ------
    DataError
        If a task is unknown, `size` is neither 2 nor 3, or there are too few or too many systems.
    """
    unknown = [task for task in tasks if task not in TASKS]
    if unknown or not tasks:
        raise DataError(f"tasks {list(tasks)} must be of {', '.join(TASKS)}")
    if size not in (2, 3) or not size <= len(systems) <= MOST_SYSTEMS:
        raise DataError(
            f"{len(systems)} systems, {size} at a time: needs 2 or 3 at a time, of at least as "
            f"many and at most {MOST_SYSTEMS} systems"
        )
    return [
        Trial(f"{item}/{task}/{'+'.join(group)}", item, task, group)
        for item in items
        for task in tasks
        for group in combinations(systems, size)
    ]


def plan_raters(
    trials: Sequence[Trial], n_raters: int, *, most: int | None, seed: int
) -> list[list[tuple[Trial, tuple[str, ...]]]]:
    """Trials of every rater, with the systems from left to right.

    All trials are shown equally often, to within one; over the raters that see a trial every order
    of its systems is shown equally often, to within one. The sequence is random per rater.

    Parameters
    ----------
    trials : sequence of Trial
        From `all_trials`.
    n_raters : int
        Number of sequences.
    most : int or None
        Trials of one rater; all if None.
    seed : int
        Seed of the sequences.

    Raises
    ------
    DataError
        If a rater would get more than `MOST_TRIALS`.
    """
    count = len(trials) if most is None else min(most, len(trials))
    if count > MOST_TRIALS:
        raise DataError(
            f"{count} trials for every rater are too many; at most {MOST_TRIALS}: `most`"
        )
    rng = np.random.default_rng(seed)
    line = rng.permutation(len(trials))
    first = rng.integers(6, size=len(trials))  # the order with which each trial begins
    shown = np.zeros(len(trials), int)
    plans = []
    for rater in range(n_raters):
        chosen = [int(line[(rater * count + k) % len(trials)]) for k in range(count)]
        plan = []
        for place in rng.permutation(chosen):
            trial = trials[place]
            orders = list(permutations(trial.systems))
            plan.append((trial, orders[(first[place] + shown[place]) % len(orders)]))
            shown[place] += 1
        plans.append(plan)
    return plans


def page_rows(
    plan: Sequence[tuple[Trial, tuple[str, ...]]],
    clips: dict[tuple[str, str], str],
    frozen: dict[str, str],
    rng: np.random.Generator,
) -> list[dict[str, Any]]:
    """Rows of the page for one rater: a practice trial, the plan, and checks between.

    Parameters
    ----------
    plan : sequence
        From `plan_raters`.
    clips : dict
        Blind name of the clip of an item and a system.
    frozen : dict
        Blind name of an item's clip whose face does not move.
    rng : Generator
        Places and sides of the checks.
    """
    rows = [
        {
            "kind": "trial",
            "task": t.task,
            "item": t.item,
            "clips": [clips[t.item, s] for s in order],
        }
        for t, order in plan
    ]
    names = sorted({trial.item for trial, _ in plan} & set(frozen))
    if not names:
        return rows
    for _ in range(CHECKS):
        rows.insert(int(rng.integers(1, len(rows) + 1)), _obvious(CHECK, plan, clips, frozen, rng))
    return [_obvious(PRACTICE, plan, clips, frozen, rng), *rows]


def _obvious(
    kind: str,
    plan: Sequence[tuple[Trial, tuple[str, ...]]],
    clips: dict[tuple[str, str], str],
    frozen: dict[str, str],
    rng: np.random.Generator,
) -> dict[str, Any]:
    """A face that moves against one that does not."""
    usable = [trial for trial, _ in plan if trial.item in frozen]
    trial = usable[int(rng.integers(len(usable)))]
    pair = [clips[trial.item, trial.systems[0]], frozen[trial.item]]
    if rng.random() < 0.5:
        pair.reverse()
    return {"kind": kind, "task": "realism", "item": trial.item, "clips": pair}
