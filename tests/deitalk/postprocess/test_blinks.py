"""Blinks and gaze."""

import numpy as np
import pytest

from deitalk.postprocess.blinks import add_idle_motion, blink_track, gaze_track
from rig import default_controls


def generator(seed=0):
    return np.random.default_rng(seed)


def test_blinks_shut_and_open_again():
    track = blink_track(1800, 30, generator())
    shut = np.flatnonzero(track == 1)
    assert len(shut) >= 8
    for frame in shut:
        assert track[frame - 3] == 0
        assert track[frame + 5] == 0
        assert (np.diff(track[frame - 3 : frame + 1]) > 0).all()
        assert (np.diff(track[frame : frame + 6]) < 0).all()
    assert track.min() == 0
    assert track.max() == 1


def test_blinks_are_as_frequent_as_in_speech():
    per_minute = (blink_track(30 * 60 * 30, 30, generator()) == 1).sum() / 30
    assert 12 < per_minute < 26  # adults in conversation: 10 to 32 a minute


def test_equal_seeds_give_equal_tracks():
    for track in (blink_track, gaze_track):
        assert np.array_equal(track(900, 30, generator(5)), track(900, 30, generator(5)))
        assert not np.array_equal(track(900, 30, generator(5)), track(900, 30, generator(6)))


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("n_frames", [1, 14, 40, 200, 601])
def test_eyes_are_still_before_the_end(n_frames, seed):
    assert not blink_track(n_frames, 30, generator(seed))[-15:].any()
    assert not gaze_track(n_frames, 30, generator(seed))[-15:].any()


def test_gaze_is_small_and_returns_without_a_jump():
    track = gaze_track(9000, 30, generator())
    assert track[:, 0].std() == pytest.approx(0.037, abs=0.01)
    assert np.abs(track).max() < 0.2
    assert np.abs(np.diff(track[-30:], axis=0)).max() < 0.12


def test_idle_motion_moves_eyes_only():
    controls = default_controls()
    curves = np.tile(controls.rest, (600, 1))
    before = curves.copy()
    add_idle_motion(curves, controls, fps=30, rng=generator())
    moved = {controls.names[i] for i in np.flatnonzero((curves != before).any(axis=0))}
    eyes = {f"CTRL_{s}_eye{part}" for s in "LR" for part in ("_blink.ty", ".tx", ".ty")}
    assert moved == eyes
    assert np.array_equal(curves[-15:], before[-15:])


def test_half_shut_lids_blink_to_shut_and_no_further():
    controls = default_controls()
    curves = np.tile(controls.rest, (900, 1))
    lid = controls.index("CTRL_L_eye_blink.ty")
    curves[:, lid] = 0.4
    add_idle_motion(curves, controls, fps=30, rng=generator())
    assert curves[:, lid].max() == pytest.approx(1)
    assert curves[:, lid].min() == pytest.approx(0.4)
