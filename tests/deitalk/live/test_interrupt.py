"""A voice that is interrupted: the mouth shuts in a tenth of a second, the rest stays."""

import numpy as np
import pytest

from deitalk import LiveAnimator
from deitalk.errors import AudioError, ConfigError
from deitalk.live.stream import CLOSING_FRAMES
from tests.deitalk.live.conftest import RATE, mouth_from_rest
from tests.errors import one_line

FACE = ("CTRL_L_mouth_cornerPull.ty", "CTRL_R_brow_down.ty", "CTRL_L_eye_cheekRaise.ty")
PLACES = (0.5, 0.65, 1.0, 1.3, 2.5)
"""Seconds of the voice at which it is interrupted: in syllables, at their edges, in a pause."""


def speak(tiny, voice, seconds, **options):
    animator = LiveAnimator(tiny, "happy", **options)
    frames = animator.feed(voice[: round(seconds * RATE)])
    return animator, frames, animator.head


@pytest.mark.parametrize("seconds", PLACES)
@pytest.mark.parametrize("back", [1, 8])
def test_mouth_shuts_in_a_tenth_of_a_second(tiny, voice, seconds, back):
    """Whatever was said, and whichever of the frames that were given is on the screen."""
    animator, before, head = speak(tiny, voice, seconds)
    shown = before[-back]
    given = {} if back == 1 else {"shown": shown, "head": head[-back]}
    animator.interrupt(**given)
    (frames,) = animator.read()
    assert len(frames) >= CLOSING_FRAMES  # at once, without more sound
    rest = mouth_from_rest(animator, frames)
    assert rest[CLOSING_FRAMES - 1 :].max() < 1e-6
    assert rest[0] <= max(
        mouth_from_rest(animator, shown[None])[0], mouth_from_rest(animator, frames).max()
    )
    places = [animator.names.index(name) for name in FACE]
    assert np.abs(frames[:, places] - shown[places]).max() < 1e-6
    turn = np.abs(np.diff(np.concatenate((head[-back][None], animator.head)), axis=0))
    assert turn[:, :3].max() <= 1


@pytest.mark.parametrize("seconds", PLACES)
def test_sound_that_comes_next_begins_at_the_frame_that_is_returned(tiny, voice, seconds):
    animator, before, _ = speak(tiny, voice, seconds)
    place = animator.interrupt()
    after = [animator.read()[0], animator.feed(voice[: 2 * RATE]), animator.finish()]
    count = len(before) + sum(map(len, after))
    assert abs(count - place - 60) <= 1
    later = np.concatenate(after)[place - len(before) :]
    assert mouth_from_rest(animator, later[:45]).max() > 0.05  # it speaks again


@pytest.mark.parametrize("size", [400, 7777])
def test_pieces_of_the_sound_after_it_change_nothing(tiny, voice, size):
    found, again = [], voice[:RATE]
    for step in (len(again), size):
        animator, _, _ = speak(tiny, voice, 1.1)
        animator.interrupt()
        parts = [animator.read()[0]]
        parts += [animator.feed(again[k : k + step]) for k in range(0, len(again), step)]
        found.append(np.concatenate((*parts, animator.finish())))
    assert found[0].shape == found[1].shape
    # Rounding of matrix products of other sizes, which the rule of contacts enlarges.
    assert np.abs(found[0] - found[1]).max() < 1e-4


def test_other_voices_go_on(tiny, voice):
    both, alone = (LiveAnimator(tiny, streams=2, seed=3) for _ in range(2))
    for animator in (both, alone):
        animator.feed([voice[:RATE], voice[:RATE]])
    both.interrupt(1)
    both.read()
    alone.read()
    rest = np.zeros(0, np.float32)
    found, wanted = (a.feed([voice[RATE:], rest])[0] for a in (both, alone))
    assert np.abs(found - wanted).max() < 1e-5


def test_the_expression_goes_on_from_where_it_stayed(tiny, voice):
    animator, before, _ = speak(tiny, voice, 1.1)
    animator.interrupt()
    parts = [before, animator.read()[0], animator.feed(voice), animator.finish()]
    step = np.abs(np.diff(np.concatenate(parts), axis=0))
    places = [animator.names.index(name) for name in FACE]
    at = len(before) - 1
    around = step[at : at + 40, places]
    assert around.max() <= step[:at, places].max()


def test_a_second_interruption_is_as_the_first(tiny, voice):
    animator, _, _ = speak(tiny, voice, 1.0)
    for _ in range(3):
        animator.interrupt()
        (frames,) = animator.read()
        assert mouth_from_rest(animator, frames)[CLOSING_FRAMES - 1 :].max() < 1e-6
        animator.feed(voice[: RATE // 5])


def test_before_any_sound_there_is_nothing_to_interrupt(tiny, voice):
    animator = LiveAnimator(tiny)
    assert animator.interrupt() == 0
    whole = LiveAnimator(tiny)
    found, wanted = (np.concatenate((a.feed(voice), a.finish())) for a in (animator, whole))
    assert np.array_equal(found, wanted)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"shown": np.zeros(3)}, "185"),
        ({"shown": np.full(185, np.nan)}, "finite"),
        ({"shown": np.zeros(185), "head": np.zeros(2)}, "6"),
    ],
)
def test_a_frame_that_is_none_is_refused(tiny, voice, given, words):
    animator, _, _ = speak(tiny, voice, 0.5)
    with one_line(ConfigError, match=words):
        animator.interrupt(**given)


def test_a_voice_that_has_ended_is_not_interrupted(tiny, voice):
    animator, _, _ = speak(tiny, voice, 0.5)
    animator.finish()
    with one_line(AudioError, match="ended"):
        animator.interrupt()
