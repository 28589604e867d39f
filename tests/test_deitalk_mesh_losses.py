"""Eq. 7-8 in closed form, and weights that give every term the same say."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from deitalk.deformation_decoder import Deformation
from deitalk.mesh_losses import TERMS, AutomaticWeights, difference_loss, mesh_terms, value_loss

ONE = torch.ones(2)


def pairs(*numbers):
    return torch.tensor(numbers, dtype=torch.float64).reshape(-1, 2, 2)


def test_losses_by_hand():
    target = pairs(0, 0, 0, 0)
    predicted = pairs(1, 2, 3, 2)  # frame t - 1: (1, 2); frame t: (3, 2)
    assert value_loss(predicted, target, ONE) == (1 + 4 + 9 + 4) / 4
    assert difference_loss(predicted, target, ONE) == ((3 - 1) ** 2 + 0) / 2
    weights = torch.tensor([2.0, 0.0])
    assert value_loss(predicted, target, weights) == (4 * 1 + 4 * 9) / 4
    assert difference_loss(predicted, target, weights) == 4 * 4 / 2


@given(st.floats(-100, 100), st.integers(0, 1000))
def test_difference_does_not_see_a_constant_offset(offset, seed):
    torch.manual_seed(seed)
    a, b = torch.randn(2, 3, 2, 4, dtype=torch.float64)
    weights = torch.rand(4, dtype=torch.float64)
    shift = offset * torch.randn(1, 1, 4, dtype=torch.float64)
    before, after = (difference_loss(x, b, weights) for x in (a, a + shift))
    assert after.item() == pytest.approx(before.item(), rel=1e-6)
    if abs(offset) > 10:
        assert value_loss(a + shift, b, weights) > value_loss(a, b, weights)


def test_each_term_sees_its_own_branch():
    zero = Deformation(torch.zeros(1, 2, 6), torch.zeros(1, 2, 3))
    constant_s = Deformation(torch.ones(1, 2, 6), torch.zeros(1, 2, 3))
    jump_r = Deformation(torch.zeros(1, 2, 6), torch.tensor([[[0.0] * 3, [2.0] * 3]]))
    weights = torch.ones(6), torch.ones(3)
    parts = {k: float(v) for k, v in mesh_terms(constant_s, zero, weights).items()}
    assert parts == dict(zip(TERMS, (1, 0, 0, 0), strict=True))
    parts = {k: float(v) for k, v in mesh_terms(jump_r, zero, weights).items()}
    assert parts == dict(zip(TERMS, (0, 0, 2, 4), strict=True))


def test_weights_follow_the_stated_form():
    balance = AutomaticWeights(("a", "b"), decay=0.9)
    history = [(2.0, 0.1), (4.0, 0.3), (1.0, 0.2)]
    moment = np.zeros(2)
    for t, terms in enumerate(history, start=1):
        moment = 0.9 * moment + 0.1 * np.square(terms)
        expected = np.sum(terms / (np.sqrt(moment / (1 - 0.9**t)) + 1e-8))
        total = balance({"a": torch.tensor(terms[0]), "b": torch.tensor(terms[1])})
        assert total.item() == pytest.approx(expected, rel=1e-6)


def test_a_steady_term_weighs_one_whatever_its_unit():
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


def test_evaluation_and_bad_steps_leave_the_means():
    balance = AutomaticWeights(("a",))
    balance({"a": torch.tensor(3.0)})
    before = balance.second_moment.clone()
    balance({"a": torch.tensor(float("nan"))})
    balance.eval()
    balance({"a": torch.tensor(30.0)})
    assert torch.equal(balance.second_moment, before)
    assert balance({"a": torch.tensor(6.0)}).item() == pytest.approx(2, rel=1e-6)


def test_state_goes_with_a_checkpoint():
    one, two = AutomaticWeights(("a",)), AutomaticWeights(("a",))
    for value in (1.0, 5.0):
        one({"a": torch.tensor(value)})
    two.load_state_dict(one.state_dict())
    assert one({"a": torch.tensor(2.0)}) == two({"a": torch.tensor(2.0)})
