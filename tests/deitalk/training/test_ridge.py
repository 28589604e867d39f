"""The straight line that a tuning begins with, against least squares of one large matrix."""

import numpy as np
import pytest
import torch

from deitalk.training.tuning import ridge
from deitalk.training.tuning.ridge import Capture, fit_ridge, take_folds
from tests.deitalk.training.conftest import small_decoder

EVERY = np.ones(2, bool)


def captures(rng, maps, *, noise=0.0, clips=4, frames=200):
    """Clips of two takes of each actor, whose curves are a map of the features, and noise."""
    labels, rows = [], []
    for actor, (weight, bias) in maps.items():
        for k in range(clips):
            x = rng.normal(2.0, 1.0, size=(frames, weight.shape[0])).astype(np.float32)
            y = x @ weight + bias + noise * rng.normal(size=(frames, weight.shape[1]))
            labels.append(Capture(f"{actor}{k % 2}", actor, EVERY))
            rows.append((x, y.astype(np.float32)))
    return labels, rows


def least_squares(labels, rows, shared, own):
    """Maps of two actors by one least-squares problem: the penalties are rows of it."""
    x = np.concatenate([x for x, _ in rows]).astype(float)
    y = np.concatenate([y for _, y in rows]).astype(float)
    of = np.repeat([label.actor for label in labels], [len(x) for x, _ in rows])
    size = x.shape[1]
    is_of = [(of == name).astype(float)[:, None] for name in ("ann", "bob")]
    inner = [mask * (x - x[mask[:, 0] > 0].mean(axis=0)) for mask in is_of]
    scale = np.sqrt(sum((part**2).sum(axis=0) for part in inner))
    design = np.concatenate((x, *(mask * x for mask in is_of), *is_of), axis=1)
    held = np.zeros((3 * size, design.shape[1]))
    held[:, : 3 * size] = np.diag(
        np.concatenate([shared**0.5 * scale, own**0.5 * scale, own**0.5 * scale])
    )
    target = np.concatenate((y, np.zeros((3 * size, y.shape[1]))))
    found = np.linalg.lstsq(np.concatenate((design, held)), target, rcond=None)[0]
    common, ann, bob = (found[i * size : (i + 1) * size] for i in range(3))
    return [common + ann, common + bob], found[3 * size :]


def test_partly_pooled_actors_are_the_solution_of_one_least_squares_problem(rng, monkeypatch):
    monkeypatch.setattr(ridge, "SHARED", (0.5,))
    monkeypatch.setattr(ridge, "OWN", (3.0,))
    maps = {name: (rng.normal(size=(5, 2)), rng.normal(size=2)) for name in ("ann", "bob")}
    labels, rows = captures(rng, maps, noise=0.3)
    found = fit_ridge(labels, rows.__getitem__, ("ann", "bob"), EVERY)
    weights, biases = least_squares(labels, rows, 0.5, 1.5)
    for place in range(2):
        np.testing.assert_allclose(
            found.weight[0] + found.weight[place + 1], weights[place].T, atol=1e-4
        )
        np.testing.assert_allclose(found.bias[0] + found.bias[place + 1], biases[place], atol=1e-3)


def test_a_stranger_gets_the_mean_of_the_actors(rng):
    maps = {name: (rng.normal(size=(5, 2)), rng.normal(size=2)) for name in ("ann", "bob")}
    labels, rows = captures(rng, maps)
    found = fit_ridge(labels, rows.__getitem__, ("ann", "absent", "bob"), EVERY)
    np.testing.assert_allclose(found.weight[1] + found.weight[3], 0, atol=1e-9)
    np.testing.assert_allclose(found.bias[1] + found.bias[3], 0, atol=1e-9)
    assert not found.weight[2].any() and not found.bias[2].any()


def test_a_stranger_to_three_actors_gets_what_they_share(rng, monkeypatch):
    """All follow the first feature; the second moves each their own way, so that it is held for a
    stranger. The third control has neither, but other offsets, whose mean is a stranger's."""
    monkeypatch.setattr(ridge, "SHARED", (0.001, 100.0))
    names = ("ann", "bob", "eve")
    maps = {
        name: (np.array([[1.0, 0.0, 0.0], [0.0, way, 0.0]]), np.array([0.0, 0.0, offset]))
        for name, way, offset in zip(names, (1.0, -1.0, 2.0), (1.0, 2.0, 6.0), strict=True)
    }
    labels, rows = captures(rng, maps, noise=0.1)
    labels = [label._replace(known=np.ones(3, bool)) for label in labels]
    found = fit_ridge(labels, rows.__getitem__, names, np.ones(3, bool))
    np.testing.assert_allclose(found.weight[0, 0], [1, 0], atol=0.02)
    assert np.abs(found.weight[0, 1]).max() < 0.02
    assert found.bias[0, 2] == pytest.approx(3, abs=0.05)
    for place, (weight, bias) in enumerate(maps.values()):
        own = found.weight[0] + found.weight[place + 1]
        np.testing.assert_allclose(own, weight.T, atol=0.02)
        assert found.bias[0, 2] + found.bias[place + 1, 2] == pytest.approx(bias[2], abs=0.1)


def test_conventions_have_penalties_of_their_own_and_their_mean_without_a_name(rng, monkeypatch):
    """One follows the features, the second the same with the other sign, the third none of them:
    only the noise of the third is held. None is a new actor, for whom nothing is shared."""
    monkeypatch.setattr(ridge, "SHARED", (0.01, 100.0))
    monkeypatch.setattr(ridge, "OWN", (0.01, 1.0))
    weights = {"a-1": 1.0, "a-2": -0.5, "a-3": 0.0}
    maps = {name: (np.full((5, 1), w), np.zeros(1)) for name, w in weights.items()}
    labels, rows = captures(rng, maps, frames=40)
    labels = [label._replace(known=np.ones(1, bool)) for label in labels]
    rows = [
        (x, y if label.actor != "a-3" else rng.normal(size=y.shape).astype(np.float32))
        for label, (x, y) in zip(labels, rows, strict=True)
    ]
    one = np.ones(1, bool)
    found = fit_ridge(labels, rows.__getitem__, tuple(weights), one, new_actors=False)
    own = (found.weight[0] + found.weight[1:])[:, 0]
    np.testing.assert_allclose(own[0], 1, atol=0.05)
    np.testing.assert_allclose(own[1], -0.5, atol=0.05)
    assert np.abs(own[2]).max() < 0.02
    np.testing.assert_allclose(found.weight[0, 0], own.mean(axis=0), atol=1e-9)
    new = fit_ridge(labels, rows.__getitem__, tuple(weights), one).weight[0, 0]
    assert np.abs(new).max() < 0.1


def test_penalty_is_that_which_predicts_takes_best(rng, monkeypatch):
    """The first control follows the features, the second is noise: held, but for its mean."""
    monkeypatch.setattr(ridge, "SHARED", (0.001, 100.0))
    weight = np.column_stack((np.ones(5), np.zeros(5)))
    labels, rows = captures(rng, {"ann": (weight, np.array([0.0, 4.0]))}, frames=30)
    rows = [(x, y + np.float32([0, 1]) * rng.normal(size=y.shape).astype("f4")) for x, y in rows]
    found = fit_ridge(labels, rows.__getitem__, (), EVERY)
    np.testing.assert_allclose(found.weight[0, 0], 1, atol=0.01)
    assert np.abs(found.weight[0, 1]).max() < 0.02
    mean = np.concatenate([x for x, _ in rows]).mean(axis=0) @ found.weight[0, 1] + found.bias[0, 1]
    assert mean == pytest.approx(np.concatenate([y for _, y in rows])[:, 1].mean(), abs=1e-3)


def test_clips_teach_only_what_they_show(rng):
    weight, bias = rng.normal(size=(5, 2)), np.array([0.5, -0.5])
    labels, rows = captures(rng, {"ann": (weight, bias)})
    expected = fit_ridge(labels, rows.__getitem__, (), EVERY)
    hidden = Capture("c", "ann", np.array([True, False]))
    wrong = (rows[0][0], rows[0][1] * np.float32([1, -50]))
    found = fit_ridge([*labels, hidden], [*rows, wrong].__getitem__, (), EVERY)
    np.testing.assert_allclose(found.weight[:, 1], expected.weight[:, 1])
    none = fit_ridge(labels, rows.__getitem__, (), np.array([False, True]))
    assert not none.weight[:, 0].any() and not none.bias[:, 0].any()


@pytest.mark.parametrize("n_first", [2, 5, 6])
def test_clips_that_are_added_are_read_alone(rng, n_first):
    """Unless the clips before them are in other folds with them."""
    maps = {"ann": (rng.normal(size=(5, 2)), np.zeros(2))}
    labels, rows = captures(rng, maps, noise=0.5, clips=8)
    labels = [label._replace(take=f"{i // 2}") for i, label in enumerate(labels)]
    labels[0] = labels[0]._replace(known=np.array([False, True]))
    sums, read = {}, []
    fit_ridge(labels[:n_first], rows.__getitem__, ("ann",), EVERY, sums)
    found = fit_ridge(labels, lambda i: read.append(i) or rows[i], ("ann",), EVERY, sums)
    wanted = fit_ridge(labels, rows.__getitem__, ("ann",), EVERY)
    for one, other in zip(found[:3], wanted[:3], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9)
    assert min(read) == (0 if n_first == 2 else n_first)


def test_folds_are_takes_or_parts_of_them():
    assert take_folds([("a", "x"), ("b", "x"), ("a", "x"), ("c", "y"), ("d", "y")]) == [
        0, 1, 0, 0, 1,
    ]  # fmt: skip
    assert take_folds([("a", "x")] * 8) == [0, 0, 1, 1, 2, 2, 3, 3]
    assert take_folds([("a", "x"), ("a", "x"), ("b", "y"), ("c", "y")]) == [0, 1, 0, 1]
    assert take_folds([(name, name) for name in "abcde"], 2) == [0, 1, 0, 1, 0]


def test_maps_without_a_fold_are_those_of_the_other_clips(rng, monkeypatch):
    """With one penalty to choose from, they are the maps that the others alone give."""
    monkeypatch.setattr(ridge, "SHARED", (0.1,))
    monkeypatch.setattr(ridge, "OWN", (1.0,))
    maps = {name: (rng.normal(size=(5, 2)), rng.normal(size=2)) for name in ("ann", "bob")}
    labels, rows = captures(rng, maps, noise=0.3)
    found = fit_ridge(labels, rows.__getitem__, ("ann", "bob"), EVERY)
    assert found.folds == (0, 1) * 4 and len(found.held) == 2
    for fold, held in enumerate(found.held):
        places = [i for i in range(8) if found.folds[i] != fold]
        others = [labels[i] for i in places]
        wanted = fit_ridge(others, [rows[i] for i in places].__getitem__, ("ann", "bob"), EVERY)
        np.testing.assert_allclose(held.weight, wanted.weight, atol=1e-4)
        np.testing.assert_allclose(held.bias, wanted.bias, atol=1e-3)


def test_many_actors_have_one_map_and_an_offset_of_each(rng, monkeypatch):
    """That of one least-squares problem; no actor adds to what is kept of the clips but offsets."""
    monkeypatch.setattr(ridge, "SHARED", (0.5,))
    names = [f"a{place}" for place in range(ridge.MANY + 1)]
    common = rng.normal(size=(5, 2))
    maps = {n: (common + 0.1 * rng.normal(size=(5, 2)), rng.normal(size=2)) for n in names}
    labels, rows = captures(rng, maps, noise=0.1)
    sums = {}
    found = fit_ridge(labels, rows.__getitem__, names, EVERY, sums)
    assert max(found.folds) == 1 and not found.weight[1:].any()
    assert [each.squares.shape[:2] for each in sums.values()] == [(2, ridge.GROUPS)]

    x, y = (np.concatenate([row[k] for row in rows]).astype(float) for k in (0, 1))
    of = np.repeat([label.actor for label in labels], [len(x) for x, _ in rows])
    is_of = np.stack([of == name for name in names], axis=1).astype(float)
    means = np.linalg.lstsq(is_of, x, rcond=None)[0]
    scale = np.square(x - is_of @ means).sum(axis=0)
    held = np.diag(np.concatenate((np.sqrt(0.5 * scale), np.zeros(len(names)))))[:5]
    design = np.concatenate((np.concatenate((x, is_of), axis=1), held))
    wanted = np.linalg.lstsq(design, np.concatenate((y, np.zeros((5, 2)))), rcond=None)[0]
    np.testing.assert_allclose(found.weight[0], wanted[:5].T, atol=1e-4)
    np.testing.assert_allclose(found.bias[0] + found.bias[1:], wanted[5:], atol=1e-3)


def test_the_map_of_many_actors_is_that_which_predicts_strangers_best(rng, monkeypatch):
    """The second control moves each their own way, so that it is held."""
    monkeypatch.setattr(ridge, "SHARED", (0.001, 100.0))
    names = [f"a{place}" for place in range(2 * ridge.MANY)]
    ways = {n: np.array([[1.0, 0.0], [0.0, (-1.0) ** (k // 4)]]) for k, n in enumerate(names)}
    maps = {n: (way, np.zeros(2)) for n, way in ways.items()}
    labels, rows = captures(rng, maps, noise=0.1, frames=50)
    found = fit_ridge(labels, rows.__getitem__, names, EVERY)
    np.testing.assert_allclose(found.weight[0, 0], [1, 0], atol=0.02)
    assert np.abs(found.weight[0, 1]).max() < 0.05


def test_a_control_that_no_map_predicts_better_may_stay_as_it_is(rng):
    """The first swings about 0, the second follows the features; the third's mean is another."""
    weight = np.array([[0.0, 1.0, 0.0]] * 5)
    labels, rows = captures(rng, {"ann": (weight, np.array([0.0, 0.0, 2.0]))}, frames=2000)
    labels = [label._replace(known=np.ones(3, bool)) for label in labels]
    swing = np.float32([[1, 0, 0], [-1, 0, 0]] * 1000)
    rows = [(x, y + swing) for x, y in rows]
    found = fit_ridge(labels, rows.__getitem__, (), np.ones(3, bool), may_stay=True)
    assert found.stays.tolist() == [True, False, False]
    assert not found.weight[:, 0].any() and not found.bias[:, 0].any()
    assert all(not held.weight[:, 0].any() for held in found.held)


def test_maps_are_added_to_the_last_layers(rng):
    net = small_decoder(direct=True, actor_layers=True)
    maps = {name: (rng.normal(size=(7, 2)), rng.normal(size=2)) for name in ("ann", "bob")}
    labels, rows = captures(rng, maps)
    found = fit_ridge(labels, rows.__getitem__, ("ann", "bob"), EVERY)
    before = net.output.weight.detach().clone()
    found.add_to(net)
    np.testing.assert_allclose(
        (net.output.weight - before).detach(), found.weight[0], rtol=1e-5, atol=1e-6
    )
    x = rng.normal(size=(1, 6, 7)).astype(np.float32)
    plain = net.output(torch.from_numpy(x)).detach()
    second = torch.eye(7)[0] + torch.eye(7)[6]
    change = (net.curves(torch.from_numpy(x), second[None]) - plain).detach()
    np.testing.assert_allclose(change, x @ found.weight[2].T + found.bias[2], atol=1e-5)
