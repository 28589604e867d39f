"""Trials of raters: balance of trials, of sides and of checks."""

from collections import Counter

import numpy as np
import pytest

from deitalk.errors import DataError
from deitalk.research.study.design import (
    CHECK,
    CHECKS,
    PRACTICE,
    all_trials,
    page_rows,
    plan_raters,
)

ITEMS = ["a", "b", "c"]


@pytest.mark.parametrize(("size", "n"), [(2, 3), (3, 1)])
def test_trials_are_every_combination_in_every_task(size, n):
    trials = all_trials(["x", "y", "z"], ITEMS, ["lips", "emotion"], size)
    assert len(trials) == len({t.id for t in trials}) == 3 * 2 * n


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("most", [None, 5])
def test_trials_and_sides_are_balanced_over_raters(size, most):
    trials = all_trials(["x", "y", "z"], ITEMS, ["lips"], size)
    plans = plan_raters(trials, 36, most=most, seed=4)
    shown = Counter(trial.id for plan in plans for trial, _ in plan)
    assert max(shown.values()) - min(shown.values()) <= 1
    for trial in trials:
        orders = Counter(order for plan in plans for t, order in plan if t == trial)
        assert len(orders) == (2 if size == 2 else 6)
        assert max(orders.values()) - min(orders.values()) <= 1
    for plan in plans:
        assert len({trial.id for trial, _ in plan}) == len(plan)


def test_sequences_differ_between_raters_and_repeat_for_a_seed():
    trials = all_trials(["x", "y"], ITEMS, ["lips", "emotion"], 2)
    plans = plan_raters(trials, 2, most=None, seed=1)
    assert [t.id for t, _ in plans[0]] != [t.id for t, _ in plans[1]]
    assert plans == plan_raters(trials, 2, most=None, seed=1)


def test_page_begins_with_practice_and_has_checks_of_a_still_face():
    trials = all_trials(["x", "y"], ITEMS, ["lips"], 2)
    clips = {(item, s): f"{item}-{s}" for item in ITEMS for s in "xy"}
    frozen = {item: f"{item}-still" for item in ITEMS}
    [plan] = plan_raters(trials, 1, most=None, seed=0)
    rows = page_rows(plan, clips, frozen, np.random.default_rng(0))
    kinds = [row["kind"] for row in rows]
    assert kinds[0] == PRACTICE and kinds[1] == "trial" and kinds.count(CHECK) == CHECKS
    for row in rows:
        stills = sum(name.endswith("still") for name in row["clips"])
        assert stills == (row["kind"] != "trial")
        assert len({name.split("-")[0] for name in row["clips"]}) == 1
    assert [row["kind"] for row in page_rows(plan, clips, {}, np.random.default_rng(0))] == [
        "trial"
    ] * 3


@pytest.mark.parametrize(
    ("systems", "tasks", "size", "message"),
    [
        (["x"], ["lips"], 2, "1 systems, 2 at a time"),
        (["x", "y"], ["lips"], 3, "2 systems, 3 at a time"),
        (["x", "y"], ["beauty"], 2, "must be of realism"),
        (["x", "y"], [], 2, "must be of realism"),
    ],
)
def test_all_trials_rejects_what_cannot_be_compared(systems, tasks, size, message):
    with pytest.raises(DataError, match=message):
        all_trials(systems, ITEMS, tasks, size)


def test_plan_rejects_more_trials_than_a_person_can_do():
    trials = all_trials(["x", "y"], [str(i) for i in range(500)], ["lips"], 2)
    with pytest.raises(DataError, match="at most 400"):
        plan_raters(trials, 1, most=None, seed=0)
