"""Memory of a stream that does not end."""

import resource

import numpy as np
import pytest

from deitalk.live.animator import LiveAnimator

HOURS = 2


def kept(animator) -> int:
    """Numbers that a stream keeps."""
    stream = animator.streams[0]
    parts = [stream.sound.samples, *animator.state, *animator.past, *animator.due]
    return sum(np.asarray(part).size for part in parts)


def test_stream_keeps_no_more_after_half_a_minute_than_after_ten_seconds(tiny, voice):
    animator, sizes = LiveAnimator(tiny), []
    for k in range(12):
        animator.feed(voice)
        if k % 4 == 3:
            sizes.append(kept(animator))
    assert max(sizes) < 1.2 * sizes[0] + 20_000  # a second of sound more or less


@pytest.mark.slow
def test_two_hours_take_no_more_memory_than_two_minutes(voice):
    animator = LiveAnimator("live", emotion="happy")
    peak = 0
    for k in range(round(HOURS * 3600 / (len(voice) / 16_000))):
        assert len(animator.feed(voice))
        if k == 40:
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < peak + 20 * 1024
