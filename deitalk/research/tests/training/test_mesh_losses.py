"""Eq. 7-8 in closed form, the lips' term, and the automatic weights of the terms."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from deitalk.research.meshes.gradient_bases import fit_basis
from deitalk.research.meshes.losses import (
    LIPS,
    AutomaticWeights,
    difference_loss,
    lip_loss,
    motion_terms,
    term_names,
    value_loss,
)

ONE = torch.ones(2)


def pairs(*numbers):
    return torch.tensor(numbers, dtype=torch.float64).reshape(-1, 2, 2)


def test_losses_by_hand():
    target = pairs(0, 0, 0, 0)
    predicted = pairs(1, 2, 3, 2)  # frame t - 1: (1, 2); frame t: (3, 2)
    assert value_loss(predicted, target, ONE) == (1 + 4 + 9 + 4) / 2
    assert difference_loss(predicted, target, ONE) == (3 - 1) ** 2
    deviations = torch.tensor([2.0, 0.0])
    assert value_loss(predicted, target, deviations) == (4 * 1 + 4 * 9) / 2
    assert difference_loss(predicted, target, deviations) == 4 * 4


def test_value_loss_of_coefficients_equals_that_of_triangles():
    """The value loss is the area-weighted squared error of the numbers themselves (Eq. 7)."""
    rng = np.random.default_rng(0)
    areas = rng.uniform(0.1, 3, 10)
    frames = rng.standard_normal((50, 6)) @ rng.standard_normal((6, 60))
    basis = fit_basis(frames, areas)
    one, other = (basis.project(frames[k : k + 8]).reshape(4, 2, -1) for k in (0, 20))
    given_, wanted = (basis.expand(rows) for rows in (one, other))
    numbers = (((given_ - wanted) * basis.weights) ** 2).sum(axis=-1).mean()
    arguments = (torch.from_numpy(rows) for rows in (one, other))
    deviations = torch.from_numpy(basis.deviations.astype(float))
    assert float(value_loss(*arguments, deviations)) == pytest.approx(numbers, rel=2e-3)


@given(st.floats(-100, 100), st.integers(0, 1000))
def test_difference_loss_ignores_a_constant_offset(offset, seed):
    torch.manual_seed(seed)
    a, b = torch.randn(2, 3, 2, 4, dtype=torch.float64)
    deviations = torch.rand(4, dtype=torch.float64)
    shift = offset * torch.randn(1, 1, 4, dtype=torch.float64)
    before, after = (difference_loss(x, b, deviations) for x in (a, a + shift))
    assert after.item() == pytest.approx(before.item(), rel=1e-6)
    if abs(offset) > 10:
        assert value_loss(a + shift, b, deviations) > value_loss(a, b, deviations)


def test_terms_depend_on_their_own_branch():
    zero = {"stretch": torch.zeros(1, 2, 6), "rotation": torch.zeros(1, 2, 3)}
    constant = zero | {"stretch": torch.ones(1, 2, 6)}
    jump = zero | {"rotation": torch.tensor([[[0.0] * 3, [2.0] * 3]])}
    deviations = {"stretch": torch.ones(6), "rotation": torch.ones(3)}
    names = term_names(list(zero), lips=False)
    parts = {k: float(v) for k, v in motion_terms(constant, zero, deviations).items()}
    assert parts == dict(zip(names, (6, 0, 0, 0), strict=True))
    parts = {k: float(v) for k, v in motion_terms(jump, zero, deviations).items()}
    assert parts == dict(zip(names, (0, 0, 6, 12), strict=True))
    assert term_names(["offsets"], lips=True) == ("offsets_value", "offsets_difference", LIPS)


def test_lip_loss_by_hand():
    """One frame, one pair that touches: both 3 mm aside is 9; 1 mm apart costs 4 times 1 more."""
    rest = torch.zeros(1, 1, 1, 3)
    shut = torch.zeros(1, 1, 2, 3)
    aside = shut + torch.tensor([3.0, 0, 0])
    assert lip_loss(aside, shut, rest) == 9
    apart = torch.tensor([[[[0.0, 0.5, 0], [0, -0.5, 0]]]])
    assert lip_loss(apart, shut, rest) == pytest.approx(0.25 + 4 * 1)
    wide = torch.tensor([[[[0.0, 9.0, 0], [0, 0, 0]]]])  # the same error where lips are 9 mm apart
    assert lip_loss(wide + apart, wide, rest) == pytest.approx(0.25 + 4 * 1 / 10)
    assert lip_loss(shut, shut, rest + 5) == 0


def test_automatic_weights_follow_the_stated_formula():
    balance = AutomaticWeights(("a", "b"), decay=0.9)
    history = [(2.0, 0.1), (4.0, 0.3), (1.0, 0.2)]
    moment = np.zeros(2)
    for t, terms in enumerate(history, start=1):
        moment = 0.9 * moment + 0.1 * np.square(terms)
        expected = np.sum(terms / (np.sqrt(moment / (1 - 0.9**t)) + 1e-8))
        total = balance({"a": torch.tensor(terms[0]), "b": torch.tensor(terms[1])})
        assert total.item() == pytest.approx(expected, rel=1e-6)


def test_constant_terms_weigh_one_in_any_unit():
    balance = AutomaticWeights(("small", "large"))
    for _ in range(5):
        small = torch.tensor(1e-5, requires_grad=True)
        large = torch.tensor(1e4, requires_grad=True)
        total = balance({"small": small, "large": large})
    assert total.item() == pytest.approx(2, rel=2e-3)
    total.backward()
    assert float(small.grad * small.detach()) == pytest.approx(
        1, rel=2e-3
    )  # v is no part of the gradient
    assert float(large.grad * large.detach()) == pytest.approx(1, rel=1e-3)


def test_automatic_weights_are_restored_from_their_state():
    one, two = AutomaticWeights(("a",)), AutomaticWeights(("a",))
    for value in (1.0, 5.0):
        one({"a": torch.tensor(value)})
    two.load_state_dict(one.state_dict())
    assert one({"a": torch.tensor(2.0)}) == two({"a": torch.tensor(2.0)})
