"""The laws of silence: the mouth is shut in it, and a share of the expression stays.

A former law let the whole face be at rest in silence and at the end. People hold the expression
that they speak with before and after they speak.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deitalk.audio.voice_activity import speech_activity
from deitalk.config.rules import Gates
from deitalk.postprocess.gates import expression_share, mouth_gate
from tests.deitalk.audio.test_voice_activity import placed

REST = 0.5
masks = st.lists(st.tuples(st.booleans(), st.integers(1, 120)), min_size=1, max_size=8).map(
    lambda runs: np.concatenate([np.full(n, float(b)) for b, n in runs])
)


@given(masks)
def test_gates_are_open_in_speech_and_move_smoothly(activity):
    for gate, fastest in ((mouth_gate(activity), 0.36), (expression_share(activity, REST), 0.17)):
        assert gate.dtype == np.float32
        assert gate.shape == activity.shape
        assert (gate[activity == 1] == 1).all()
        assert gate.min() >= 0
        assert np.abs(np.diff(gate)).max(initial=0) <= fastest


@given(masks)
def test_gates_without_speech_are_shut(activity):
    assert not mouth_gate(0 * activity).any()
    assert not expression_share(0 * activity, REST).any()


@given(masks, st.floats(0, 1), st.floats(0, 1))
def test_more_rest_is_never_less_expression(activity, one, other):
    low, high = sorted((one, other))
    assert (expression_share(activity, low) <= expression_share(activity, high) + 1e-6).all()


def test_mouth_gate_opens_before_speech_and_closes_after_it():
    activity = np.zeros(60)
    activity[20:30] = 1
    gate = mouth_gate(activity)
    assert np.flatnonzero(gate).tolist() == list(range(15, 40))  # 0.17 s before, 0.33 s after
    assert (np.diff(gate[14:21]) > 0).all()
    assert (np.diff(gate[29:41]) < 0).all()


@pytest.mark.parametrize("pause", [10, 16, 30, 100])
def test_mouth_gate_is_shut_in_pauses(pause):
    activity = np.concatenate([np.ones(20), np.zeros(pause), np.ones(20)])
    shut = mouth_gate(activity)[20 : 20 + pause] == 0
    assert shut.sum() == max(0, pause - 15)  # but for 10 closing and 5 opening frames


@pytest.mark.parametrize("pause", [15, 30, 60, 90])
def test_expression_is_held_through_pauses(pause):
    """At the end of a pause of 3 s it is at 1/e of the way to the share that stays, or above."""
    activity = np.concatenate([np.ones(20), np.zeros(pause), np.ones(20)])
    share = expression_share(activity, REST)
    assert share.min() >= REST + (1 - REST) * np.exp(-pause / 75)
    assert share[20 + pause - 3] == 1, "the face has its expression before the voice"


@pytest.mark.parametrize("lead", [3, 15, 40, 100, 599])
def test_expression_begins_at_the_share_that_stays(lead):
    share = expression_share(np.concatenate([np.zeros(lead), np.ones(20)]), REST)
    assert share[0] == pytest.approx(1 if lead <= 3 else max(REST, share[0]), abs=1e-6)
    assert (np.diff(share) >= 0).all()
    assert (share[: max(lead - 18, 0)] == REST).all(), "it rises over the half second before"


@pytest.mark.parametrize("rest", [0, 0.3, 1])
def test_expression_after_speech_decays_to_the_share_that_stays(rest):
    share = expression_share(np.concatenate([np.ones(20), np.zeros(600)]), rest)
    after = share[20:]
    assert (np.diff(after) <= 0).all()
    assert after[14] >= 0.8, "half a second after the last word"
    assert after[74] == pytest.approx(rest + (1 - rest) / np.e, abs=1e-3)
    assert after[450] == pytest.approx(rest, abs=0.01)


def test_expression_goes_far_from_any_speech():
    gates = Gates(feeling_leaves=200, feeling_decays=30)
    share = expression_share(np.concatenate([np.zeros(400), np.ones(9), np.zeros(400)]), 1, gates)
    assert not share[:140].any() and (share[200:609] == 1).all() and not share[669:].any()
    assert np.abs(np.diff(share)).max() < 0.03


@pytest.mark.parametrize("trailing_seconds", [0.6, 1.0, 3.0])
def test_mouth_of_a_waveform_is_shut_at_its_end_and_its_expression_stays(rng, trailing_seconds):
    waveform, _ = placed(rng, [-0.5, 2, -trailing_seconds])
    activity = speech_activity(waveform)
    assert mouth_gate(activity)[-1] == 0
    assert expression_share(activity, REST)[-1] > REST
