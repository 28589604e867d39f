"""Statistics of choices against published and hand-worked values."""

import numpy as np
import pytest

from deitalk.research.study.statistics import agreement, share_of, strengths


def test_share_has_the_exact_interval_of_clopper_and_pearson():
    """8 of 10: .4439 to .9748 (tables of exact binomial limits); p = 2 · 56 / 1024."""
    share = share_of(8, 10)
    assert share.share == 0.8
    assert (share.low, share.high) == pytest.approx((0.4439, 0.9748), abs=1e-4)
    assert share.p == pytest.approx(112 / 1024)
    assert np.isnan(share_of(0, 0).share)


def test_agreement_is_that_of_krippendorffs_example():
    """Krippendorff 2011, example C: four observers, twelve units, nominal: .743."""
    table = """
        1 2 3 3 2 1 4 1 2 . . .
        1 2 3 3 2 2 4 1 2 5 . 3
        . 3 3 3 2 3 4 2 2 5 1 .
        1 2 3 3 2 4 4 1 2 5 1 .
    """
    rows = [line.split() for line in table.strip().splitlines()]
    units = {k: [row[k] for row in rows if row[k] != "."] for k in range(12)}
    assert agreement(units) == pytest.approx(0.743, abs=5e-4)


def test_agreement_of_equal_and_of_opposite_ratings():
    assert agreement({k: [k % 2, k % 2] for k in range(10)}) == 1
    independent = {k: [k % 2, k // 2 % 2] for k in range(200)}
    assert agreement(independent) == pytest.approx(0, abs=0.01)
    assert np.isnan(agreement({0: [1], 1: [2]}))


@pytest.mark.parametrize("size", [2, 3])
def test_strengths_of_simulated_raters_are_recovered(size):
    """Raters choose by Luce's model with strengths 1, 0 and -1."""
    true = np.array([1.0, 0.0, -1.0])
    rng = np.random.default_rng(3)
    by_rater = {}
    for rater in range(60):
        rows = []
        for _ in range(20):
            shown = rng.permutation(3)[:size]
            odds = np.exp(true[shown])
            rows.append((shown.tolist(), int(rng.choice(shown, p=odds / odds.sum()))))
        by_rater[str(rater)] = rows
    best, low, high = strengths(by_rater, 3)
    np.testing.assert_allclose(best, true, atol=0.15)
    assert (low < true).all() and (true < high).all()
    assert (high - low < 0.6).all()


def test_strength_of_a_system_that_always_wins_is_finite():
    best = strengths({"a": [([0, 1], 0)] * 10}, 2).best
    assert 1 < best[0] < 5 and best[0] == pytest.approx(-best[1])
