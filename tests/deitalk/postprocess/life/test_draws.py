"""Random numbers, noise and events that are functions of keys, in any blocks and batches."""

import numpy as np
import pytest

from deitalk.postprocess.life.draws import Swells, by_rank, normals, smooth_noise, uniforms

KEYS = np.array([3, 1 << 60, 12345], np.uint64)


def test_numbers_are_uniform_and_those_of_their_key_and_place():
    shares = uniforms(KEYS[:1], np.arange(20_000), 3)
    assert shares.shape == (20_000, 3)
    assert 0 < shares.min() and shares.max() < 1
    assert shares.mean(axis=0) == pytest.approx([0.5] * 3, abs=0.01)
    assert shares.std(axis=0) == pytest.approx([12**-0.5] * 3, rel=0.02)
    assert np.abs(np.corrcoef(shares.T) - np.eye(3)).max() < 0.03
    assert abs(np.corrcoef(shares[1:, 0], shares[:-1, 0])[0, 1]) < 0.03
    others = uniforms(KEYS[1:2], np.arange(20_000), 3)
    assert abs(np.corrcoef(shares[:, 0], others[:, 0])[0, 1]) < 0.03
    together = uniforms(KEYS[:, None], np.array([[7, -2]]), 2)
    for k in range(3):
        for j, place in enumerate((7, -2)):
            one = uniforms(KEYS[k : k + 1], np.array([place]), 2)
            np.testing.assert_array_equal(together[k, j], one[0])
    assert normals(shares).std() == pytest.approx(1, rel=0.02)


@pytest.mark.parametrize("seconds", [0.1, 0.7])
def test_noise_has_its_spread_and_the_speed_of_its_gaussian(seconds):
    times = np.arange(21_000)[None] / 30
    spread, sigmas = np.array([2.0, 0.5]), np.full(2, seconds)
    values = smooth_noise(KEYS[:1], times, spread, sigmas)[0]
    assert values.std(axis=0) == pytest.approx([2.0, 0.5], rel=0.15)
    speed = 30 * np.diff(values, axis=0).std(axis=0) / [2.0, 0.5]
    assert speed == pytest.approx([2**-0.5 / seconds] * 2, rel=0.15)
    part = smooth_noise(KEYS[:1], times[:, 500:507], spread, sigmas)[0]
    np.testing.assert_array_equal(part, values[500:507])


@pytest.mark.parametrize("piece", [1, 7, 90])
def test_swells_are_played_alike_in_any_pieces(piece):
    """A full swell is at 1 while it is held, and nothing before its begin and after its end."""

    def play(size):
        swells = Swells(2)
        stream, peak = np.array([0, 1]), np.array([1.0, 2.0])
        known = np.full(2, -np.inf)
        swells.add(stream, peak, (0.5, 0.2, 0.4), np.array([[1.0, 0.0], [0.0, -2.0]]), known)
        both = np.arange(2)
        starts = range(0, 90, size)
        rows = [swells.play(both, np.full(2, at), min(size, 90 - at)) for at in starts]
        assert not len(swells.stream)
        return np.concatenate(rows, axis=1)

    found = play(piece)
    np.testing.assert_array_equal(found, play(90))
    assert found[0, 30:36, 0] == pytest.approx(1) and found[1, 61, 1] == pytest.approx(-2)
    assert not found[0, :16].any() and not found[0, 49:].any() and not found[0, :, 1].any()


def test_what_is_known_late_begins_late_and_may_rise_faster():
    known = np.array([0.9])
    for shortest, peak in ((None, 1.4), (0.2, 1.1)):
        swells = Swells(1)
        swells.add(
            np.array([0]), np.array([1.0]), (0.5, 0.0, 0.4), np.ones((1, 1)), known, shortest
        )
        track = swells.play(np.arange(1), np.zeros(1, int), 90)[0, :, 0]
        assert not track[:28].any() and track.argmax() == pytest.approx(30 * peak, abs=1)


def test_events_are_ranked_within_their_streams():
    ranks = [found.tolist() for found in by_rank(np.array([2, 0, 2, 2, 0]))]
    assert [sorted(found) for found in ranks] == [[0, 1], [2, 4], [3]]
    assert list(by_rank(np.zeros(0, int))) == []
