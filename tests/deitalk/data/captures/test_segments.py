"""Cutting of takes: clips are short, hold all speech, and no border lies in it."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deitalk.data.captures.segments import LISTENING_SECONDS, cut_at_silences

RATE = 30


@st.composite
def activity(draw) -> np.ndarray:
    """Speech of 0.1 to 8 s and pauses of 0.2 to 20 s, in turn."""
    parts = draw(st.lists(st.tuples(st.integers(3, 240), st.integers(7, 600)), max_size=12))
    frames = [np.zeros(draw(st.integers(1, 100)))]
    for speech, pause in parts:
        frames += [np.ones(speech), np.zeros(pause)]
    return np.concatenate(frames)


def covered(spans, n_frames: int) -> np.ndarray:
    t = np.arange(n_frames) / RATE
    return np.any([(t >= a - 1e-6) & (t < b - 1e-6) for a, b in spans] or [t < 0], axis=0)


@given(activity(), st.booleans())
@settings(max_examples=60)
def test_clips_are_short_and_their_borders_lie_in_pauses(speaking, keep):
    seconds = len(speaking) / RATE
    spans = cut_at_silences(speaking, np.zeros(len(speaking)), seconds, keep_listening=keep)
    for start, stop in spans:
        assert 0 <= start < stop <= seconds + 1e-9 and stop - start <= 15 + 1e-6
        for border in (start, stop):
            frame = int(border * RATE - 1e-6)
            inside = 0 < border < seconds - 1e-6
            assert not (inside and speaking[frame] and speaking[min(frame + 1, len(speaking) - 1)])
    assert all(a[1] <= b[0] + 1e-9 for a, b in pairwise(spans))


@given(activity())
@settings(max_examples=60)
def test_all_speech_is_kept_and_long_pauses_are_not(speaking):
    spans = cut_at_silences(speaking, np.zeros(len(speaking)), len(speaking) / RATE)
    inside = covered(spans, len(speaking))
    runs = np.flatnonzero(np.diff(np.concatenate([[0], speaking, [0]])))
    long_enough = np.zeros(len(speaking), bool)
    for a, b in runs.reshape(-1, 2):
        long_enough[a:b] = b - a >= 15
    assert inside[long_enough].all()
    pauses = np.flatnonzero(np.diff(np.concatenate([[0], 1 - speaking, [0]]))).reshape(-1, 2)
    for a, b in pauses:
        if b - a > (LISTENING_SECONDS + 0.1) * RATE:
            assert not inside[(a + b) // 2]


def test_listening_parts_are_kept_if_wanted():
    speaking = np.concatenate([np.ones(60), np.zeros(40 * RATE), np.ones(60)])
    spans = cut_at_silences(speaking, np.zeros(len(speaking)), 44.0, keep_listening=True)
    assert covered(spans, len(speaking)).all()


def test_speech_without_pause_is_cut_where_it_is_quietest():
    speaking = np.ones(20 * RATE)
    level = np.full(20 * RATE, -20.0)
    level[int(10.5 * RATE) : int(10.8 * RATE)] = -35.0
    (first, second) = cut_at_silences(speaking, level, 20.0)
    assert first[1] == pytest.approx(10.65, abs=0.15) and second[0] == first[1]
