"""Blinks and gaze against published human ranges."""

import numpy as np
import pytest

from deitalk.postprocess.life.blinks import BEGIN, CLOSES, DEPTH, OPENS, Blinks, blink_ends, closure
from deitalk.postprocess.life.character import Seeds
from deitalk.postprocess.life.gaze import AVERSION_DEGREES, AVERSION_SECONDS, Gaze, vergence
from deitalk.postprocess.life.voice import Phrase, Voice

MINUTES = 20
ONE, FIRST = np.arange(1), np.zeros(1, int)


def key(seed, part):
    return np.array([Seeds((0, 0, seed)).key(part)], np.uint64)


def talk(seconds=MINUTES * 60):
    """Phrases of 2.4 s with pauses of 0.6 s, without accents."""
    n_frames = int(seconds * 30)
    phrases = tuple(Phrase(i + 9, i + 81, False) for i in range(0, n_frames - 90, 90))
    return Voice(n_frames, np.zeros(n_frames, np.float32), (), phrases)


def silence(seconds):
    return Voice(seconds * 30, np.zeros(seconds * 30, np.float32), (), ())


def lids_of(seed=0, seconds=3.2, spread=0.55):
    return Blinks(key(seed, "blinks"), np.array([seconds]), np.array([spread]))


def plan_blinks(voice, seed=0, **settings):
    """Blinks of a take, sorted [shape=(N, 6)]."""
    found = lids_of(seed, **settings)
    found.cue(voice.cues())
    found._draw(ONE, np.array([voice.n_frames / 30]))
    return found.blinks.rows[found.blinks.rows[:, BEGIN].argsort()]


def gaze_of(voice, seed=0):
    gaze = Gaze(key(seed, "gaze"), np.zeros(1))
    gaze.cue(voice.cues(), lids_of(seed))
    return gaze


def looks_of(voice, seed=0, distance=65.0):
    """Degrees to the left and up, and vergence [shape=(T, 3)]."""
    distances = np.full((1, voice.n_frames), distance)
    return gaze_of(voice, seed).play(ONE, FIRST, voice.n_frames, distances)[0]


def saccades(looks):
    """Steps of at least a degree that are faster than 20 degrees a second."""
    fast = np.hypot(*np.diff(looks[:, :2], axis=0).T) * 30 > 20
    edges = np.flatnonzero(np.diff(np.pad(fast.astype(int), 1))).reshape(-1, 2)
    sizes = np.array([np.hypot(*(looks[b, :2] - looks[a, :2])) for a, b in edges])
    return sizes[sizes >= 1]


@pytest.fixture(scope="module")
def blinks():
    return plan_blinks(talk())


def test_blinks_are_as_frequent_as_in_conversation(blinks):
    assert 10.5 < len(blinks) / MINUTES < 32.5  # Doughty 2001: 95 % of adults


def test_intervals_are_log_normal_as_in_people(blinks):
    intervals = np.diff(blinks[:, BEGIN])
    logarithms = np.log(intervals[intervals > 0.6])
    assert np.exp(logarithms.mean()) == pytest.approx(3.2, rel=0.25)
    assert 0.35 < logarithms.std() < 0.8
    assert np.mean(intervals) > np.median(intervals)


def test_durations_are_those_of_people(blinks):
    durations = blink_ends(blinks) - blinks[:, BEGIN]
    assert 0.1 < durations.min()
    assert durations.max() < 0.5  # Caffier et al. 2003
    assert (blinks[:, OPENS] > blinks[:, CLOSES]).all()
    full = blinks[blinks[:, DEPTH] == 1][:200].copy()
    full[:, BEGIN] = 0
    shapes = closure(full, np.tile(np.arange(0, 0.6, 0.001), (len(full), 1)))
    assert 0.12 < np.median((shapes > 0.5).sum(axis=1) / 1000) < 0.24  # six readers on video


def test_blinks_come_at_ends_of_phrases(blinks):
    ends = np.array([phrase.stop for phrase in talk().phrases]) / 30
    after = blinks[:, BEGIN, None] - ends
    near = ((after > -0.1) & (after < 0.35)).any(axis=1).mean()
    assert near > 2 * 0.45 / 3  # twice the share by chance: a window of 0.45 s every 3 s


def test_some_blinks_are_incomplete_and_some_double(blinks):
    assert 0.1 < (blinks[:, DEPTH] < 1).mean() < 0.3
    intervals = np.diff(blinks[:, BEGIN])
    assert 0.01 < (intervals < 0.6).mean() < 0.12
    assert (blinks[1:, BEGIN] >= blink_ends(blinks)[:-1] - 1e-9).all(), "none begins in another"


def test_a_full_blink_is_shut_in_some_frame():
    for start in np.linspace(1, 1.033, 12):
        one = lids_of()
        one.next[:] = np.inf
        one.blinks.append(ONE, np.array([[start, 0.085, 1 / 30, 0.19, 1.0, 0.0]]))
        lids = one.play(ONE, FIRST, 90)[0]
        assert lids.max() == pytest.approx(1, abs=1e-4)
        assert lids[:28].max() == lids[45:].max() == 0


def test_no_two_of_60_takes_blink_alike_and_equal_seeds_do():
    tracks = [lids_of(seed).play(ONE, FIRST, 240)[0] for seed in range(60)]
    firsts = [np.argmax(track[:, 0] > 0.5) for track in tracks]
    assert np.ptp(firsts) > 45
    assert len({track.tobytes() for track in tracks}) == 60
    assert lids_of(5).play(ONE, FIRST, 240).tobytes() == tracks[5].tobytes()
    looks = [looks_of(talk(8), seed).tobytes() for seed in (1, 1, 2)]
    assert looks[0] == looks[1] != looks[2]


def test_interval_follows_the_settings():
    few, many = (plan_blinks(talk(600), seconds=seconds) for seconds in (9.0, 2.0))
    assert len(few) < 0.45 * len(many)


@pytest.mark.parametrize("voice", [talk(300), silence(300)], ids=["talking", "silent"])
@pytest.mark.parametrize("seed", range(4))
def test_saccades_are_as_frequent_as_captured_ones(voice, seed):
    """At least 45 a minute, at most the 141 of the liveliest of five captured takes."""
    sizes = saccades(looks_of(voice, seed))
    assert 45 <= len(sizes) / 5 <= 141
    assert 1.5 < np.median(sizes) < 6


def test_saccades_follow_the_main_sequence():
    """Of 12 degrees two frames at most, and none goes further than its place."""
    looks = looks_of(talk(300))[:, :2]
    steps = np.hypot(*np.diff(looks, axis=0).T)
    fast = steps * 30 > 20
    edges = np.flatnonzero(np.diff(np.pad(fast.astype(int), 1))).reshape(-1, 2)
    assert max(b - a for a, b in edges) <= 3
    still = steps[~fast]
    assert np.median(still) * 30 < 2, "between them the eyes drift slowly"


@pytest.mark.parametrize("seed", range(6))
def test_aversions_are_5_to_12_degrees_at_most_2_seconds_and_come_back(seed):
    voice = talk(300)
    gaze = gaze_of(voice, seed)
    rows = gaze.aversions.rows
    sizes, lengths = np.hypot(*rows[:, 2:].T), rows[:, 1] - rows[:, 0]
    assert AVERSION_DEGREES[0] <= sizes.min() < sizes.max() <= AVERSION_DEGREES[1]
    assert AVERSION_SECONDS[2] - 1e-9 <= lengths.min() < lengths.max() <= 2
    assert 4 < len(rows) / 5 < 20  # a minute
    looks = looks_of(voice, seed)
    away = np.hypot(*looks[:, :2].T)
    middles = np.round(rows[:, :2].mean(axis=1) * 30).astype(int)
    assert (away[middles] > 3).all()
    assert 0.05 < (away > 4.5).mean() < 0.35
    out = np.flatnonzero(np.diff(np.pad((away > 4.5).astype(int), 1))).reshape(-1, 2)
    assert max(b - a for a, b in out) <= 60


def test_aversions_are_in_pauses_and_at_starts_of_phrases():
    starts = gaze_of(talk(300)).aversions.rows[:, 0] * 30
    in_pause = (starts % 90 > 75) | (starts % 90 < 18)  # pauses: 81 to 99
    assert in_pause.all()


def test_some_aversions_are_within_long_phrases():
    """Every 4 to 5 s of speech at most (Andrist et al. 2014)."""
    phrases = tuple(Phrase(start, start + 600, False) for start in range(30, 18_000, 660))
    voice = Voice(18_060, np.zeros(18_060, np.float32), (), phrases)
    starts = gaze_of(voice).aversions.rows[:, 0] * 30
    within = np.array([any(p.start + 60 < s < p.stop for p in phrases) for s in starts])
    assert 1 < within.sum() / (20 * len(phrases) / 60) < 12  # a minute of speech


def test_eyes_meet_at_the_listeners_distance_and_further_off_in_thought():
    """63 mm between the eyes: 2.77 degrees each at 65 cm."""
    assert vergence(65.0) == pytest.approx(2.774, abs=1e-3)
    looks = looks_of(talk(300))
    away = np.hypot(*looks[:, :2].T) > 6
    assert np.median(looks[~away, 2]) == pytest.approx(2.774, abs=1e-3)
    assert np.median(looks[away, 2]) < 1
    far = looks_of(silence(60), distance=130.0)
    assert far[:, 2] == pytest.approx(vergence(130.0), abs=1e-6)
    assert np.ptp(far[:, 0]) < 0.75 * np.ptp(looks_of(silence(60))[:, 0]), "a face is smaller there"
