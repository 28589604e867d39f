"""Faults of channels, each made by hand, and the pose at rest."""

import numpy as np
import pytest

from deitalk.data.captures.channels import asymmetry, channel_faults, swapped_takes
from deitalk.data.captures.rest_pose import rest_pose, without_rest
from deitalk.data.captures.survey import MOST_FRAMES, Frames
from rig import RigCurves, default_controls

CONTROLS = default_controls()
KNOWN = np.ones(len(CONTROLS), bool)
JAW = CONTROLS.index("CTRL_C_jaw.ty")
T = 300


@pytest.fixture
def face(rng) -> np.ndarray:
    """Slow movement of all controls around the middle of their ranges."""
    t = np.arange(T)[:, None] / 30
    phase = rng.uniform(0, 6, len(CONTROLS))
    middle = (CONTROLS.minimum + CONTROLS.maximum) / 2
    size = (CONTROLS.maximum - CONTROLS.minimum) / 5
    values = (middle + size * np.sin(2 * t + phase)).astype(np.float32)
    for one, other in (("CTRL_L_eye.tx", "CTRL_R_eye.tx"), ("CTRL_C_jaw.tx", "CTRL_C_mouth.tx")):
        values[:, CONTROLS.index(other)] = values[:, CONTROLS.index(one)]
    return values


def faults(values, speaking=None):
    return channel_faults(
        values, 30, KNOWN, CONTROLS, np.ones(T, bool) if speaking is None else speaking
    )


def test_channel_at_the_end_of_its_range_is_clipped(face):
    face[50:80, JAW] = CONTROLS.maximum[JAW]
    assert faults(face).clipped == ("CTRL_C_jaw.ty",)
    face[:, JAW] = CONTROLS.rest[JAW]
    assert faults(face).clipped == ()


def test_noise_is_jitter(face, rng):
    face[:, JAW] = 0.5 + 0.1 * rng.standard_normal(T)
    assert faults(face).jittering == ("CTRL_C_jaw.ty",)


def test_face_that_stands_still_in_speech_is_frozen(face):
    face[100:131] = face[100]
    assert faults(face).frozen_seconds == pytest.approx(1.0)
    silent = np.ones(T, bool)
    silent[95:140] = False
    assert faults(face, silent).frozen_seconds == 0


def test_gaze_apart_and_jaw_against_mouth_are_negative(face):
    for name in ("CTRL_R_eye.tx", "CTRL_C_mouth.tx"):
        face[:, CONTROLS.index(name)] *= -1
    found = faults(face)
    assert found.gaze < -0.5 and found.sideways < -0.5


def test_take_with_the_mirrored_asymmetry_of_the_others_is_swapped(face):
    face[:, CONTROLS.index("CTRL_L_mouth_cornerPull.ty")] += 0.2
    own = asymmetry(face, KNOWN, CONTROLS)
    assert swapped_takes([own, own, -own, own]) == [2]
    assert swapped_takes([own, own, own]) == []
    assert swapped_takes([own, -own]) == []


def test_rest_pose_is_the_median_of_silence_and_ignores_held_expressions():
    pose = CONTROLS.rest.copy()
    pose[JAW] += 0.1
    smile = CONTROLS.index("CTRL_L_mouth_cornerPull.ty")
    happy = pose.copy()
    happy[smile] += 0.5
    gaze = CONTROLS.index("CTRL_L_eye.ty")
    pose[gaze] = happy[gaze] = -0.4
    silent = {"neutral": np.tile(pose, (100, 1)), "happy": np.tile(happy, (100, 1))}
    found = rest_pose(silent, {"neutral": 30, "happy": 30}, CONTROLS)
    assert found is not None
    moved = {CONTROLS.names[i]: found[i] for i in np.flatnonzero(found != CONTROLS.rest)}
    assert moved == {"CTRL_C_jaw.ty": pytest.approx(0.1)}
    assert rest_pose({"sad": np.tile(pose, (50, 1))}, {"sad": 30}, CONTROLS) is None


def test_hours_of_silence_take_the_memory_of_minutes():
    """Kept frames are spread over all of them: those of a ramp have its median."""
    frames, count = Frames(), 100 * MOST_FRAMES
    for part in np.split(np.linspace(0, 1, count, dtype=np.float32)[:, None], 2500):
        frames.add(part)
        assert frames.count <= MOST_FRAMES
    assert len(frames.rows) == frames.count >= MOST_FRAMES // 2
    assert np.median(frames.rows) == pytest.approx(0.5, abs=0.01)


def test_rest_pose_goes_to_rest_and_the_ends_of_the_range_stay():
    pose = CONTROLS.rest.copy()
    pose[JAW] = 0.2
    values = np.tile(CONTROLS.rest, (4, 1))
    values[:, JAW] = [0.2, 1.0, 0.6, 0.1]
    curves = RigCurves(values, CONTROLS.names, fps=30)
    mended = without_rest(curves, pose, KNOWN, CONTROLS)
    # (0.6 - 0.2) of the 0.8 up to the end
    np.testing.assert_allclose(mended["CTRL_C_jaw.ty"], [0, 1, 0.5, 0], atol=1e-6)
    same = without_rest(curves, pose, ~KNOWN, CONTROLS)
    np.testing.assert_array_equal(same.values, curves.values)
