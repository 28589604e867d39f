"""Conventions of takes: which relate the face to the sound alike, told from other differences."""

import numpy as np
import pytest

from deitalk.data.captures.conventions import TakeProducts, find_conventions, name_styles

NAMES = ("jaw", "oh", "pucker", "smile")
MOVING = np.array([True, True, True, False])
ALL = np.ones(4, bool)
ROUND_BY = {"oh": (1.0, 0.0), "pucker": (0.0, 1.0), "both": (0.5, 0.5), "near": (1.0, 0.3)}


def take(rng, how, frames=900, noise=0.05, rest=0.0, gain=1.0, known=ALL, size=6):
    """A take whose jaw opens and whose lips round by one control, or another."""
    mouth = rng.normal(size=(frames, size)).astype(np.float32)
    oh, pucker = ROUND_BY[how]
    rounding = 0.2 * mouth[:, 1]
    columns = (0.2 * mouth[:, 0], oh * rounding, pucker * rounding, np.zeros(frames))
    curves = gain * np.stack(columns, axis=1) + noise * rng.normal(size=(frames, 4)) + rest
    products = TakeProducts()
    products.add(mouth, curves.astype(np.float32), known)
    return products


@pytest.mark.parametrize(
    ("hows", "wanted"),
    [
        (("oh", "pucker", "oh", "pucker"), [{0, 2}, {1, 3}]),
        (("oh", "oh", "oh", "pucker", "pucker"), [{0, 1, 2}, {3, 4}]),
        (("oh", "oh", "pucker"), [{0, 1}, {2}]),
        (("oh",) * 5, []),
        (("oh", "pucker"), [{0}, {1}]),
        (("pucker", "pucker"), []),
        (("oh",), []),
        (("both",) * 3, []),
    ],
)
def test_takes_that_round_alike_share_a_convention(rng, hows, wanted):
    takes = {f"t{place}": take(rng, how) for place, how in enumerate(hows)}
    found = find_conventions(takes, NAMES, MOVING)
    assert [set(one.takes) for one in found] == [{f"t{i}" for i in places} for places in wanted]
    for one in found:
        assert one.controls == (hows[int(one.takes[0][1:])],), "and what they move more"


def test_a_take_may_help_to_predict_others_of_another_convention(rng):
    """Of many predictors halves tell little: a near convention's frames are better than none."""
    hows = ("oh", "oh", "near", "pucker", "pucker")
    takes = {f"t{i}": take(rng, how, noise=0.1, size=60) for i, how in enumerate(hows)}
    found = find_conventions(takes, NAMES, MOVING)
    assert sorted(sorted(one.takes) for one in found) == [["t0", "t1"], ["t2"], ["t3", "t4"]]


@pytest.mark.parametrize(
    "other",
    [{"rest": 0.4}, {"noise": 0.15}, {"frames": 300}, {"frames": 100}, {"gain": 1.05}],
)
def test_other_poses_noise_lengths_and_sizes_are_no_convention(rng, other):
    takes = {f"t{place}": take(rng, "oh", **(other if place == 1 else {})) for place in range(4)}
    assert find_conventions(takes, NAMES, MOVING) == []


def test_controls_that_a_take_does_not_hold_do_not_count(rng):
    """All but one take hold pucker; without it the takes are alike but for oh."""
    hidden = np.array([True, True, False, True])
    takes = {f"t{i}": take(rng, how) for i, how in enumerate(("oh", "pucker", "oh", "pucker"))}
    takes["t4"] = take(rng, "pucker", known=hidden)
    found = find_conventions(takes, NAMES, MOVING)
    assert [set(one.takes) for one in found] == [{"t1", "t3", "t4"}, {"t0", "t2"}]


def test_styles_of_actors_and_of_takes_that_are_not_learnt(rng):
    """Anna has two conventions, in which a held-out and an angry take find their place."""
    anna = {f"t{i}": take(rng, how) for i, how in enumerate(("oh", "pucker", "oh", "pucker"))}
    takes = {
        ("anna", "neutral"): anna | {"held": take(rng, "pucker")},
        ("anna", "angry"): {"loud": take(rng, "oh", gain=1.5)},
        ("ben", "neutral"): {f"b{i}": take(rng, "oh") for i in range(3)},
    }
    learnt = {(*group, name) for group, own in takes.items() for name in own if name != "held"}
    conventions, styles = name_styles(takes, learnt, NAMES, MOVING)
    assert {name: set(one.takes) for name, one in conventions.items()} == {
        "anna-1": {"t0", "t2"}, "anna-2": {"t1", "t3"},
    }  # fmt: skip
    assert styles["anna", "neutral", "held"] == "anna-2"
    assert styles["anna", "angry", "loud"] == "anna-1"
    assert not any(actor == "ben" for actor, _, _ in styles)
