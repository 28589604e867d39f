"""Blinks and gaze against published human ranges."""

import numpy as np
import pytest

from deitalk.config.rules import Idle
from deitalk.postprocess.life.eyes import AVERSION_DEGREES, Blink, Blinks, Gaze
from deitalk.postprocess.life.voice import Phrase, Voice
from tests.each import each

MINUTES = 20


def generator(seed=0):
    return np.random.default_rng(seed)


def talk(seconds=MINUTES * 60):
    """Phrases of 2.4 s with pauses of 0.6 s, without accents."""
    n_frames = int(seconds * 30)
    phrases = tuple(Phrase(i + 9, i + 81, False) for i in range(0, n_frames - 90, 90))
    return Voice(n_frames, np.zeros(n_frames, np.float32), (), phrases)


def lids_of(voice, rng, idle=Idle()):
    """The blinks of a take, all drawn."""
    found = Blinks(rng, idle, end=(voice.n_frames - 1) / 30 - 0.5)
    for cue in voice.cues():
        found.cue(cue)
    found.draw_until(voice.n_frames / 30)
    return found


def plan_blinks(voice, rng, idle=Idle()):
    return [blink for blink, _ in lids_of(voice, rng, idle).blinks]


def gaze_of(voice, rng):
    """The gaze of a take, and its aversions: start, stop, degrees."""
    found, aversions = Gaze(rng, end=(voice.n_frames - 1) / 30), []
    for cue in voice.cues():
        before = found.averted
        found.cue(cue)
        if found.averted not in (before, None):
            aversions.append((found.next_look, found.averted[0], *found.averted[1].tolist()))
    return found, aversions


def plan_aversions(voice, rng):
    return gaze_of(voice, rng)[1]


@pytest.fixture(scope="module")
def blinks():
    return plan_blinks(talk(), generator())


def test_blinks_are_as_frequent_as_in_conversation(blinks):
    assert 10.5 < len(blinks) / MINUTES < 32.5  # Doughty 2001: 95 % of adults


def test_intervals_are_log_normal_as_in_people(blinks):
    intervals = np.diff([blink.time for blink in blinks])
    logarithms = np.log(intervals[intervals > 0.6])
    assert np.exp(logarithms.mean()) == pytest.approx(3.2, rel=0.25)
    assert 0.35 < logarithms.std() < 0.8
    assert np.mean(intervals) > np.median(intervals)


def test_durations_are_those_of_people(blinks):
    durations = np.array([blink.end - blink.time for blink in blinks])
    assert 0.1 < durations.min()
    assert durations.max() < 0.5  # Caffier et al. 2003
    assert all(blink.opening > blink.closing for blink in blinks)
    times = np.arange(0, 0.6, 0.001)
    full = [b._replace(time=0.0).closure(times) for b in blinks if b.depth == 1][:200]
    half = [(shape > 0.5).sum() / 1000 for shape in full]
    assert 0.12 < np.median(half) < 0.24  # six readers on video


def test_blinks_come_at_ends_of_phrases(blinks):
    voice = talk()
    ends = np.array([phrase.stop for phrase in voice.phrases]) / 30
    times = np.array([blink.time for blink in blinks])
    after = times[:, None] - ends
    near = ((after > -0.1) & (after < 0.35)).any(axis=1).mean()
    assert near > 2 * 0.45 / 3  # twice the share by chance: a window of 0.45 s every 3 s


def test_some_blinks_are_incomplete_and_some_double(blinks):
    partial = np.mean([blink.depth < 1 for blink in blinks])
    assert 0.1 < partial < 0.3
    intervals = np.diff([blink.time for blink in blinks])
    assert 0.01 < (intervals < 0.6).mean() < 0.12


def test_a_full_blink_is_shut_in_some_frame():
    for start in np.linspace(1, 1.033, 12):
        one = Blinks(generator(), end=0.0)
        one.blinks = [(Blink(start, 0.085, 1 / 30, 0.19, 1.0), 0.0)]
        lids = one.at(0, 90)
        assert lids.max() == pytest.approx(1, abs=1e-4)
        assert lids[:28].max() == lids[45:].max() == 0


def test_no_two_of_60_takes_blink_alike():
    tracks = [lids_of(talk(8), generator(i)).at(0, 240) for i in range(60)]
    firsts = [np.argmax(track[:, 0] > 0.5) for track in tracks]
    assert np.ptp(firsts) > 45
    assert len({track.tobytes() for track in tracks}) == 60


def test_equal_generators_give_equal_eyes():
    voice = talk(20)
    for seed, is_equal in ((5, True), (6, False)):
        same = plan_blinks(voice, generator(5)) == plan_blinks(voice, generator(seed))
        looks = plan_aversions(voice, generator(5)) == plan_aversions(voice, generator(seed))
        assert same is is_equal
        assert looks is is_equal


def test_interval_follows_the_settings():
    few = plan_blinks(talk(600), generator(), Idle(interval_seconds=9.0))
    many = plan_blinks(talk(600), generator(), Idle(interval_seconds=2.0))
    assert len(few) < 0.45 * len(many)


@each("seed", range(8))
@each("n_frames", [1, 14, 40, 200, 601])
def test_eyes_are_still_before_the_end(n_frames, seed):
    voice = talk(n_frames / 30)
    lids = lids_of(voice, generator(seed)).at(0, n_frames)
    gaze = gaze_of(voice, generator(seed))[0].at(0, n_frames)
    assert lids.shape == gaze.shape == (n_frames, 2)
    assert not lids[-15:].any()
    assert not gaze[-14:].any()


def test_aversions_are_5_to_12_degrees_and_come_back():
    voice = talk(300)
    found, aversions = gaze_of(voice, generator())
    sizes = np.array([np.hypot(side, up) for _, _, side, up in aversions])
    assert AVERSION_DEGREES[0] <= sizes.min() < sizes.max() <= AVERSION_DEGREES[1]
    assert 4 < len(aversions) / 5 < 20  # a minute
    size = np.hypot(*found.at(0, voice.n_frames).T)
    for start, stop, *_ in aversions:
        middle = round((start + stop) / 2 * 30)
        assert size[middle] > 3
    assert 0.1 < (size > 4).mean() < 0.4
    assert np.median(size) < 2


def test_aversions_are_in_pauses_and_at_starts_of_phrases():
    voice = talk(300)
    starts = np.array([start for start, *_ in plan_aversions(voice, generator())]) * 30
    in_pause = (starts % 90 > 75) | (starts % 90 < 15)  # pauses: 81 to 99
    assert in_pause.all()


def test_some_aversions_are_within_long_phrases():
    """Every 5 s of speech at most (Andrist et al. 2014)."""
    phrases = tuple(Phrase(start, start + 600, False) for start in range(30, 18_000, 660))
    voice = Voice(18_060, np.zeros(18_060, np.float32), (), phrases)
    starts = np.array([start for start, *_ in plan_aversions(voice, generator())]) * 30
    within = np.array([any(p.start + 60 < s < p.stop for p in phrases) for s in starts])
    assert 1 < within.sum() / (20 * len(phrases) / 60) < 12  # a minute of speech


def test_fixations_hold_micro_saccades():
    gaze = Gaze(generator(), end=1799 / 30).at(0, 1800)
    steps = np.hypot(*np.diff(gaze, axis=0).T)
    per_second = (steps[30:-30] > 0.05).sum() / 58
    assert 1 < per_second < 6
    assert np.median(steps) == 0
    assert np.hypot(*gaze.T).max() < 5
