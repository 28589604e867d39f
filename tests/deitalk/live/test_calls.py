"""How the work of a call grows with the number of streams, counted in calls of functions."""

import sys

import numpy as np
import torch

from deitalk.live.animator import LiveAnimator

MOST_GROWTH = 1.3
"""Of the calls of Python functions and of built-in ones from 4 to 64 streams: sound is taken and
curves are handed out one after the other, all else is computed for all streams at once."""


def calls(animator, pieces) -> float:
    """Mean number of calls of functions in a `feed`."""
    count = 0

    def counted(frame, event, argument):
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(counted)
    try:
        for piece in pieces:
            animator.feed(piece)
    finally:
        sys.setprofile(None)
    return count / len(pieces)


def test_calls_of_functions_grow_little_with_the_streams(tiny, voice):
    found = {}
    for streams in (4, 64):
        animator = LiveAnimator(tiny, "happy", streams=streams)
        rows = [np.roll(voice, 37 * k) for k in range(streams)]
        pieces = [[row[at : at + 1600] for row in rows] for at in range(0, 14_400, 1600)]
        for piece in pieces[:5]:
            animator.feed(piece)
        found[streams] = calls(animator, pieces[5:])
    assert found[64] <= MOST_GROWTH * found[4]


def test_state_stays_on_the_device_of_torch(tiny, voice):
    """Of the network and of the rules: else it crosses to a GPU and back in each call."""
    animator = LiveAnimator(tiny, "happy", streams=3)
    for at in range(0, 6400, 1600):
        animator.feed([voice[at : at + 1600]] * 3)
    animator.reset(1)
    animator.feed([voice[:1600]] * 3)
    kept = (*animator.state, animator.due[0])
    assert {type(part) for part in kept} == {torch.Tensor}
    assert {part.device for part in kept} == {animator.network.model.device}
