"""Closures: phones and curves with scores by hand. Frame i is at i / 30 s."""

import numpy as np
import pytest

from deitalk.evaluation.validation import closure_scores, summarise_closures
from deitalk.research.evaluation.clip_scores import held_closures

B = (0.3, 0.4, "B")  # frames 9 to 11; widened 7 to 14


def curve(values, n_frames=40):
    lips = np.zeros(n_frames, np.float32)
    for frame, value in values.items():
        lips[frame] = value
    return lips


@pytest.mark.parametrize(("frame", "counts"), [(6, 0), (7, 1), (10, 1), (14, 1), (15, 0)])
def test_closure_is_widened_by_two_frames(frame, counts):
    scores = closure_scores(curve({frame: 0.8}), [B])
    assert scores.closures == pytest.approx([0.8 * counts])


@pytest.mark.parametrize(
    ("vowel", "clear"),
    [
        ((0.0, 0.23, "AH"), True),  # 70 ms before the closure
        ((0.0, 0.25, "AH"), False),  # 50 ms
        ((0.47, 0.7, "IY"), True),
        ((0.45, 0.7, "IY"), False),
        ((0.47, 0.7, "S"), False),  # no vowel
    ],
)
def test_vowels_near_closures_are_excluded(vowel, clear):
    assert len(closure_scores(curve({}), [B, vowel]).vowels) == clear


def test_closure_is_held_from_two_frames_in_a_row():
    assert held_closures(curve({9: 0.9, 10: 0.95}), [B]) == [True]
    assert held_closures(curve({9: 0.95, 11: 0.95}), [B]) == [False]
    assert held_closures(curve({9: 0.89, 10: 1.0}), [B]) == [False]
    assert held_closures(curve({9: 1.0, 10: 1.0}), [(0.3, 0.4, "F")]) == []


def test_summary_of_two_clips_by_hand():
    # closures 1 and 0.2; vowel 0.5: one of two is found, and one of two pairs is in order
    one = closure_scores(curve({9: 1.0, 10: 1.0, 20: 0.5}), [B, (0.6, 0.8, "AA")])
    other = closure_scores(curve({9: 0.2}), [B])
    summary = summarise_closures([one, other], [True, False])
    assert (summary.n_closures, summary.n_vowels) == (2, 1)
    assert summary.hit_rate == 0.5
    assert summary.window_auc == 0.5
    assert summary.reached == 1  # of those found
    # inside 1 1 0 | 0.2 0 0, outside 0.5 and five zeros
    wins = [(p > n) + (p == n) / 2 for p in (1, 1, 0, 0.2, 0, 0) for n in (0.5, 0, 0, 0, 0, 0)]
    assert summary.frame_auc == pytest.approx(np.mean(wins))
