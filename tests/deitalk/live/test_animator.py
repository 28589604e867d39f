"""Live frames: the same for any pieces of the sound, from a bounded look-ahead."""

import math

import numpy as np
import pytest
import torch

from deitalk.emotions import EMOTIONS
from deitalk.errors import AudioError, CheckpointError, EmotionError
from deitalk.live.animator import LiveAnimator
from deitalk.postprocess.control_groups import ControlGroups
from tests.deitalk.live.conftest import RATE

CLOSE = 3e-5  # rounding, of other sizes of the products of matrices


def in_pieces(animator, sound, rng, sizes=(1, 7, 160, 533, 1600, 9000)):
    found, at = [], 0
    while at < len(sound):
        size = int(rng.choice(sizes))
        found.append(animator.feed(sound[at : at + size]))
        at += size
    return np.concatenate([*found, animator.finish()])


def whole(network, sound, **options):
    animator = LiveAnimator(network, **options)
    return np.concatenate((animator.feed(sound), animator.finish()))


def test_pieces_of_any_size_give_the_frames_of_the_whole(looking, voice, rng):
    network, _ = looking
    expected = whole(network, voice, emotion="happy")
    assert expected.shape == (93, 185) and expected.std(axis=0).max() > 0.05
    animator = LiveAnimator(network, emotion="happy")
    for _ in range(2):
        animator.reset()
        assert np.abs(in_pieces(animator, voice, rng) - expected).max() < CLOSE


def test_streams_in_one_call_give_the_frames_of_each_alone(tiny, voice, rng):
    sounds = [voice, voice[5000:], 0.2 * voice[::-1].copy()]
    animator = LiveAnimator(tiny, streams=3, emotion="sad")
    animator.set(emotion="angry", stream=1)
    found, at = [[], [], []], [0, 0, 0]
    while any(at[k] < len(sounds[k]) for k in range(3)):
        sizes = rng.choice([0, 100, 1600, 4800], 3)
        pieces = [sounds[k][at[k] : at[k] + sizes[k]] for k in range(3)]
        at = [a + int(size) for a, size in zip(at, sizes, strict=True)]
        for k, frames in enumerate(animator.feed(pieces)):
            found[k].append(frames)
    for k, frames in enumerate(animator.finish()):
        alone = LiveAnimator(tiny, emotion="sad", seed=k)
        if k == 1:
            alone.set(emotion="angry")
        expected = np.concatenate((alone.feed(sounds[k]), alone.finish()))
        assert np.abs(np.concatenate([*found[k], frames]) - expected).max() < CLOSE


@pytest.mark.parametrize("second", [1.0, 2.03])
def test_frame_depends_on_no_sound_beyond_the_look_ahead(looking, voice, rng, second):
    network, most = looking
    changed = voice.copy()
    changed[round(second * RATE) :] = 0.2 * rng.standard_normal(len(voice) - round(second * RATE))
    animator = LiveAnimator(network, emotion="happy")
    first = animator.feed(voice)
    animator.reset()
    second_frames = animator.feed(changed)
    assert animator.lookahead_seconds <= most
    known = int((second - animator.lookahead_seconds) * 30) + 1
    assert np.array_equal(first[:known], second_frames[:known])
    assert np.abs(first[known + 3 :] - second_frames[known + 3 :]).max() > 0.01


def test_frames_are_given_as_soon_as_their_look_ahead_has_come(looking, voice):
    animator = LiveAnimator(looking[0])
    given = 0
    for stop in range(400, RATE, 400):
        given += len(animator.feed(voice[stop - 400 : stop]))
        known = math.floor((stop / RATE - animator.lookahead_seconds) * 30) + 1
        assert given == max(known, 0)


def test_changes_hold_from_the_sound_on_that_comes_next(tiny, voice, rng):
    plain = whole(tiny, voice, emotion="happy")
    animator, found = LiveAnimator(tiny, emotion="happy"), []
    for start in range(0, len(voice), 1600):
        if start == 16_000:
            animator.set(emotion="angry", intensity=2.0)
        found.append(animator.feed(voice[start : start + 1600]))
    frames = np.concatenate([*found, animator.finish()])
    assert np.abs(frames[:28] - plain[:28]).max() < CLOSE  # contacts are known two frames ahead
    assert np.abs(frames[36:50] - plain[36:50]).max() > 0.02
    angry = whole(tiny, voice, emotion="angry", intensity=2.0)
    controls = [i for i, n in enumerate(animator.names) if "_eye.t" not in n and "blink" not in n]
    settled = np.abs(frames[70:] - angry[70:])  # older than every layer's past
    assert settled[:, controls].max() < CLOSE
    assert settled.max() < 0.01  # the head's posture, which the eyes undo, comes slowly


def test_mouth_rests_in_silence(tiny):
    frames = whole(tiny, np.zeros(2 * RATE, np.float32), emotion="happy", life="off")
    mouth = ControlGroups(tiny.controls).follows_mouth
    assert np.abs(frames - tiny.controls.rest)[:, mouth].max() < 1e-6


@pytest.mark.parametrize("rest", [0.0, 1.0])
def test_expression_rests_in_silence_and_rest_changes_it(tiny, rest):
    """Before any speech as after it; over a fifth of a second."""
    live = LiveAnimator(tiny, "happy", rest=rest, life="off")
    neutral = whole(tiny, np.zeros(4 * RATE, np.float32), emotion="neutral", life="off")
    first = live.feed(np.zeros(2 * RATE, np.float32))
    live.set(rest=0.0)
    last = np.concatenate((live.feed(np.zeros(2 * RATE, np.float32)), live.finish()))
    smile = tiny.controls.index("CTRL_L_mouth_cornerPull.ty")
    shown = first[30, smile] - neutral[30, smile]
    assert shown == pytest.approx(rest * 2 * whole_smile(tiny), rel=0.05, abs=1e-3)
    assert np.abs(last[20:] - neutral[-len(last) + 20 :]).max() < 0.02
    shown = (np.concatenate((first, last)) - neutral)[:, smile]
    assert np.abs(np.diff(shown)).max() <= 0.2, "no jump"


def whole_smile(tiny):
    """Smile of half the share in silence."""
    frames = whole(tiny, np.zeros(2 * RATE, np.float32), emotion="happy", rest=0.5, life="off")
    plain = whole(tiny, np.zeros(2 * RATE, np.float32), emotion="happy", rest=0.0, life="off")
    smile = tiny.controls.index("CTRL_L_mouth_cornerPull.ty")
    return float(frames[30, smile] - plain[30, smile])


def test_other_rates_and_integers_are_read(tiny, voice):
    integers = np.round(voice * 32767).astype("<i2")
    expected = whole(tiny, integers / np.float32(32768))
    assert np.array_equal(whole(tiny, integers), expected)
    assert np.array_equal(whole(tiny, integers.tobytes()), expected)
    twice = np.repeat(voice, 2)
    assert len(whole(tiny, twice, sample_rate=2 * RATE)) == 93


@pytest.mark.parametrize("size", [1, 1601, 10**6])
def test_bytes_may_end_within_a_sample(tiny, voice, size):
    """A chunk of an HTTP body has any length; the byte is kept for the next call."""
    sent = np.round(voice[:1600] * 32767).astype("<i2").tobytes() + b"\x01"
    expected = whole(tiny, sent[:-1], life="off")
    animator = LiveAnimator(tiny, life="off")
    for _ in range(2):
        found = [animator.feed(sent[at : at + size]) for at in range(0, len(sent), size)]
        assert np.abs(np.concatenate([*found, animator.finish()]) - expected).max() < CLOSE
        animator.reset()  # forgets the last byte


def test_a_byte_is_kept_for_each_of_several_streams(tiny, voice):
    sent = np.round(voice[:4000] * 32767).astype("<i2").tobytes()
    expected = whole(tiny, sent, life="off")
    animator = LiveAnimator(tiny, streams=2, life="off")
    with pytest.raises(AudioError, match="finite"):
        animator.feed([sent[:1001], [float("nan")]])  # takes nothing of either
    found = [animator.feed([sent[:1001], sent[:0]]), animator.feed([sent[1001:], sent])]
    found.append(animator.finish())
    for stream in range(2):
        rows = np.concatenate([part[stream] for part in found])
        assert np.abs(rows - expected).max() < CLOSE


def test_blinks_are_those_of_the_seed(tiny):
    silence = np.zeros(10 * RATE, np.float32)
    lid = tiny.controls.index("CTRL_L_eye_blink.ty")
    first, same, other = (whole(tiny, silence, seed=seed)[:, lid] for seed in (1, 1, 2))
    assert np.array_equal(first, same) and not np.array_equal(first, other)
    assert first.max() > 0.9 and 1 <= np.sum(np.diff((first > 0.8).astype(int)) == 1) <= 8


def listened(tiny, heard, size, **options):
    """Head of a silent stream that hears a voice in pieces."""
    animator, heads = LiveAnimator(tiny, **options), []
    silence = np.zeros(len(heard), np.float32)
    for at in range(0, len(heard), size):
        animator.feed(silence[at : at + size], other=heard[at : at + size])
        heads.append(animator.head)
    animator.finish()
    return np.concatenate([*heads, animator.head])


def test_a_listener_nods_after_the_phrases_it_hears_in_any_pieces(tiny, voice):
    """Phrases of the voice end at 1.2 and 3.1 s."""
    heard = np.concatenate((voice, np.zeros(RATE, np.float32)))
    nods = 0.0
    for seed, size in enumerate((9602, 1600)):
        head = listened(tiny, heard, size, seed=seed)
        alone = listened(tiny, 0 * heard, 9602, seed=seed)
        nods = nods + (head - alone)[:, 1] / 2
    assert not nods[:36].any() and nods[40:60].min() < -0.5 and nods[96:].min() < -0.5
    np.testing.assert_allclose(listened(tiny, heard, 9602, seed=1), head, atol=1e-5)


def test_streams_hear_each_their_own(tiny, voice):
    silence, rows = np.zeros(len(voice), np.float32), []
    animator = LiveAnimator(tiny, streams=3)
    for at in range(0, len(voice), 1600):
        piece = slice(at, at + 1600)
        animator.feed([silence[piece]] * 3, other=[None, voice[piece], None])
        rows.append(animator.head)
    both = [np.concatenate([row[k] for row in rows]) for k in range(3)]
    alone = listened(tiny, voice, 1600, seed=1)[: len(both[1])]
    np.testing.assert_allclose(both[1], alone, atol=1e-5)
    with pytest.raises(AudioError, match="other samples of 2 streams; there are 3"):
        animator.feed([silence[:10]] * 3, other=[None, None])
    with pytest.raises(AudioError, match="other samples have 3 bytes"):
        animator.feed([silence[:10]] * 3, other=[b"abc", None, None])


def test_messages_name_the_value_and_the_way_out(tiny, voice):
    animator = LiveAnimator(tiny, streams=2)
    with pytest.raises(AudioError, match="3 streams; there are 2"):
        animator.feed([voice, voice, voice])
    with pytest.raises(AudioError, match="finite"):
        animator.feed([np.array([np.nan]), voice])
    with pytest.raises(AudioError, match="one row"):
        animator.feed([np.zeros((2, 2)), voice])
    animator.finish()
    with pytest.raises(AudioError, match="reset"):
        animator.feed([voice, voice])
    with pytest.raises(EmotionError):
        animator.set(emotion="merry")
    with pytest.raises(AudioError, match="streams=0"):
        LiveAnimator(tiny, streams=0)
    with pytest.raises(CheckpointError, match="whole clip"):
        LiveAnimator("default")


def test_network_alone_gives_the_curves_of_the_whole_clip(tiny, voice):
    frames = whole(tiny, voice, emotion="happy", rules=False)
    analysis = tiny.analyse(torch.from_numpy(voice), 93)
    styles = torch.zeros(93, 5)
    styles[:, EMOTIONS.index("happy")] = 1
    curves = tiny.decode(analysis, styles).numpy()
    low, high = tiny.controls.minimum, tiny.controls.maximum
    assert np.abs(frames - np.clip(curves, low, high)).max() < CLOSE
