"""The laws of the gates: open in speech, smooth, at rest in silence and at the end."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from deitalk.audio.voice_activity import speech_activity
from deitalk.postprocess.voice_intensity import expression_gate, mouth_gate
from tests.deitalk.audio.test_voice_activity import placed
from tests.each import each

masks = st.lists(st.tuples(st.booleans(), st.integers(1, 120)), min_size=1, max_size=8).map(
    lambda runs: np.concatenate([np.full(n, float(b)) for b, n in runs])
)


@given(masks)
def test_gates_are_open_in_speech_and_move_smoothly(activity):
    for gate, fastest in ((mouth_gate(activity), 0.36), (expression_gate(activity), 0.17)):
        assert gate.dtype == np.float32
        assert gate.shape == activity.shape
        assert (gate[activity == 1] == 1).all()
        assert gate.min() >= 0
        assert np.abs(np.diff(gate)).max(initial=0) <= fastest


@given(masks)
def test_gates_without_speech_are_shut(activity):
    assert not mouth_gate(0 * activity).any()
    assert not expression_gate(0 * activity).any()


def test_mouth_gate_opens_before_speech_and_closes_after_it():
    activity = np.zeros(60)
    activity[20:30] = 1
    gate = mouth_gate(activity)
    assert np.flatnonzero(gate).tolist() == list(range(15, 40))  # 0.17 s before, 0.33 s after
    assert (np.diff(gate[14:21]) > 0).all()
    assert (np.diff(gate[29:41]) < 0).all()


@each("pause", [10, 16, 30, 100])
def test_mouth_gate_is_shut_in_pauses(pause):
    activity = np.concatenate([np.ones(20), np.zeros(pause), np.ones(20)])
    shut = mouth_gate(activity)[20 : 20 + pause] == 0
    assert shut.sum() == max(0, pause - 15)  # but for 10 closing and 5 opening frames


def test_expression_gate_stays_open_in_pauses_of_a_second_and_a_half():
    activity = np.concatenate([np.ones(20), np.zeros(45), np.ones(20)])
    assert (expression_gate(activity) == 1).all()


def test_expression_gate_decays_in_long_pauses_and_rises_before_speech():
    activity = np.concatenate([np.ones(20), np.zeros(150), np.ones(20)])
    gate = expression_gate(activity)
    assert (gate[:64] == 1).all()
    assert (gate[95:157] == 0).all()
    assert (np.diff(gate[157:171]) > 0).all()


@each("trailing", [18, 25, 45, 60, 74, 75, 90, 300])
def test_gates_are_shut_at_the_end_of_trailing_silence(trailing):
    activity = np.concatenate([np.zeros(20), np.ones(20), np.zeros(trailing)])
    gate = expression_gate(activity)
    assert gate[-1] == 0
    assert mouth_gate(activity)[-1] == 0
    assert (np.diff(gate[40:]) <= 0).all()


def test_expression_of_a_clip_cut_in_speech_stays():
    assert expression_gate(np.concatenate([np.ones(20), np.zeros(6)]))[-1] == 1


@each("trailing_seconds", [0.6, 1.0, 3.0])
def test_gates_of_a_waveform_are_shut_at_its_end(rng, trailing_seconds):
    waveform, _ = placed(rng, [-0.5, 2, -trailing_seconds])
    activity = speech_activity(waveform)
    assert mouth_gate(activity)[-1] == 0
    assert expression_gate(activity)[-1] == 0
