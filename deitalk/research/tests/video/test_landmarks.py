"""Files of landmarks, and landmarks put on 30 frames per second without inventing any."""

import numpy as np
import pytest

from deitalk.errors import DataError
from deitalk.research.video.landmarks import PLACE, FaceTrack, at_rig_frames, read_landmarks
from tests.errors import one_line


def moving(times, speed=1.0):
    """A track whose points all lie at (time * speed, number, 0)."""
    points = np.zeros((len(times), len(PLACE), 3), np.float32)
    points[..., 0] = (np.asarray(times) * speed)[:, None]
    return FaceTrack(points, np.asarray(times, float))


@pytest.mark.parametrize("fps", [15, 24, 25, 29.97, 30, 50, 60])
def test_any_rate_becomes_30_hertz_in_time(fps):
    even, seen = at_rig_frames(moving(np.arange(int(2 * fps)) / fps), "a.mp4")
    np.testing.assert_allclose(even.times, np.arange(len(even.times)) / 30)
    np.testing.assert_allclose(even.points[:, 0, 0], even.times, atol=1e-5)
    assert seen.all() and len(seen) >= 2 * 30 - 3


def test_uneven_times_of_a_phone_are_followed():
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.02, 0.05, 60))
    even, seen = at_rig_frames(moving(times), "a.mp4")
    inside = even.times >= times[0]
    np.testing.assert_allclose(even.points[inside, 0, 0], even.times[inside], atol=1e-5)
    assert seen[inside].all() and not seen[: int(times[0] * 30) - 1].any()


def test_frames_without_a_face_are_marked_and_flickers_bridged():
    track = moving(np.arange(90) / 30)
    track.points[10:12] = np.nan  # a twentieth of a second
    track.points[40:60] = np.nan
    even, seen = at_rig_frames(track, "a.mp4")
    assert seen[:40].all() and seen[60:].all() and not seen[40:60].any()
    np.testing.assert_allclose(even.points[10:12, 0, 0], even.times[10:12], atol=1e-5)
    assert np.isfinite(even.points).all()


@pytest.mark.parametrize(
    ("fps", "n_seen", "message"),
    [(8, 30, "8 frames per second"), (30, 5, "a face is in 5 of 60 frames")],
)
def test_slow_or_faceless_videos_are_refused(fps, n_seen, message):
    track = moving(np.arange(60) / fps)
    track.points[n_seen:] = np.nan
    with pytest.raises(DataError, match=message):
        at_rig_frames(track, "a.mp4")


def arrays(**changes):
    mesh = np.full((20, 478, 3), 0.5, np.float32)
    mesh[:, 200:] = 0.25
    good = {"landmarks": mesh, "size": np.array([720, 1280]), "fps": 30.0}
    return {k: v for k, v in (good | changes).items() if v is not None}


def test_file_of_landmarks_is_in_pixels(tmp_path):
    np.savez(tmp_path / "a.npz", **arrays())
    track = read_landmarks(tmp_path / "a.npz")
    np.testing.assert_allclose(track.points[3, 0], [360, 640, 360])
    np.testing.assert_allclose(track.times[:2], [0, 1 / 30])


@pytest.mark.parametrize("value", [0.5, 1e30])
def test_frame_whose_points_are_no_face_is_one_without_a_face(tmp_path, value):
    """All points in one place, or far outside any picture."""
    given = arrays()
    given["landmarks"][7] = value
    np.savez(tmp_path / "a.npz", **given)
    seen = np.isfinite(read_landmarks(tmp_path / "a.npz").points).all(axis=(1, 2))
    assert list(np.flatnonzero(~seen)) == [7]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"landmarks": np.zeros((20, 68, 2), np.float32)}, r"\(frames, 478 or 468, 3\), not"),
        ({"landmarks": np.zeros((20, 478, 3), int)}, "floating-point"),
        ({"size": None}, "needs size"),
        ({"size": np.array([720, -1])}, "needs size"),
        ({"fps": None}, "needs times in seconds"),
        ({"fps": 0.0}, "needs times in seconds"),
        ({"times": np.zeros(20), "fps": None}, "times must rise"),
        ({"times": np.arange(19.0), "fps": None}, "needs times in seconds"),
    ],
)
def test_damaged_file_of_landmarks_is_one_line(tmp_path, changes, message):
    np.savez(tmp_path / "a.npz", **arrays(**changes))
    with one_line(DataError, match=message):
        read_landmarks(tmp_path / "a.npz")
