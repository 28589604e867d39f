"""LPE and EPE by hand; rank statistics against brute force."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deitalk.evaluation.scores import (
    area_under_curve,
    correlation,
    emotion_parameter_error,
    hit_rate,
    lip_parameter_error,
    parameter_error,
)
from rig import default_controls

SCORES = st.lists(st.integers(0, 6), min_size=1, max_size=30)  # small integers: many ties


def test_parameter_error_by_hand():
    target = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    predicted = np.array([[0.1, 0.9, -0.3], [0.8, 1.0, 1.0]])
    # the largest square in columns 0 and 2: 0.09 then 0.04; column 1 is not in the set
    assert parameter_error(target, predicted, np.array([0, 2])) == pytest.approx((0.09 + 0.04) / 2)


def test_each_error_uses_its_own_controls():
    controls = default_controls()
    target = np.zeros((4, len(controls.names)))
    lips, brows = target.copy(), target.copy()
    lips[:, controls.index("CTRL_L_mouth_lipsTogetherU.ty")] = 0.5
    brows[:, controls.index("CTRL_L_brow_down.ty")] = [0.0, 0.2, 0.0, 0.0]
    assert lip_parameter_error(target, lips, controls) == pytest.approx(0.25)
    assert emotion_parameter_error(target, lips, controls) == 0
    assert emotion_parameter_error(target, brows, controls) == pytest.approx(0.04 / 4)
    assert lip_parameter_error(target, brows, controls) == 0


@given(SCORES, SCORES)
def test_area_against_all_pairs(positive, negative):
    wins = [(p > n) + (p == n) / 2 for p in positive for n in negative]
    area = area_under_curve(np.array(positive, float), np.array(negative, float))
    assert area == pytest.approx(np.mean(wins))


def test_hit_rate_by_hand():
    negative = np.arange(101.0)  # five of 101 lie above 95
    assert hit_rate(np.array([95.0, 95.5, 96.0, 3.0]), negative) == 0.5
    assert hit_rate(np.array([95.0, 95.5, 96.0, 3.0]), negative, false_alarms=0.5) == 0.75


def test_correlation_by_hand():
    a = np.array([1.0, 2.0, 3.0, 4.0])
    assert correlation(a, 5 - 2 * a) == pytest.approx(-1)
    # means 2.5 and 2: products -1.5*-2 + -.5*1 + .5*2 + 1.5*-1 = 2, norms 5 and 10
    assert correlation(a, np.array([0.0, 3.0, 4.0, 1.0])) == pytest.approx(2 / np.sqrt(50))
    assert np.isnan(correlation(a, np.ones(4)))
