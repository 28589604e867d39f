"""Curves as a sequence of frames, a mapping of controls, an array and a table."""

import numpy as np
import pytest

from rig import RigCurves
from rig.errors import ControlError, CurveError

NAMES = ("a", "b", "c")


@pytest.fixture
def curves():
    values = np.arange(18, dtype=np.float32).reshape(6, 3)
    emotion = np.eye(9, dtype=np.float32)[np.zeros(6, int)]
    return RigCurves(values, NAMES, 30, emotion=emotion, control_set="x@1")


@pytest.mark.parametrize("place", [0, 5, -1, -6, np.int64(2), True])
def test_a_number_is_a_frame(curves, place):
    np.testing.assert_array_equal(curves[place], curves.values[int(place)])


@pytest.mark.parametrize("place", [6, -7, 10**12])
def test_a_frame_beyond_the_end_is_an_index_error(curves, place):
    with pytest.raises(IndexError, match=f"frame {place} of 6"):
        curves[place]


@pytest.mark.parametrize(
    ("part", "rows", "fps"),
    [
        (slice(None), range(6), 30),
        (slice(1, 4), range(1, 4), 30),
        (slice(-2, None), range(4, 6), 30),
        (slice(None, None, 2), range(0, 6, 2), 15),
        (slice(1, None, 3), range(1, 6, 3), 10),
        (slice(0, 99), range(6), 30),
    ],
)
def test_a_slice_has_its_frames_tracks_and_rate(curves, part, rows, fps):
    found = curves[part]
    assert isinstance(found, RigCurves) and found.fps == fps and found.names == NAMES
    np.testing.assert_array_equal(found.values, curves.values[list(rows)])
    np.testing.assert_array_equal(found.emotion, curves.emotion[list(rows)])


@pytest.mark.parametrize("key", [1.5, None, (0, 1), [0, 1], ("a", "b"), slice(None, None, -1)])
def test_another_key_is_one_line(curves, key):
    with pytest.raises(CurveError) as caught:
        curves[key]
    assert "\n" not in str(caught.value) and "frames" in str(caught.value)


def test_frames_are_iterated_and_names_are_contained(curves):
    assert [row.tolist() for row in curves] == curves.values.tolist()
    assert [row.tolist() for row in reversed(curves)] == curves.values[::-1].tolist()
    assert "a" in curves and "z" not in curves and 0 not in curves
    np.testing.assert_array_equal(curves["b"], curves.values[:, 1])
    with pytest.raises(ControlError, match="'z' is not among these 3"):
        curves["z"]


def test_arrays_of_curves_are_their_values(curves):
    assert np.asarray(curves) is curves.values
    assert np.array(curves).shape == (6, 3) and np.array(curves).flags.writeable
    assert np.asarray(curves, np.float64).dtype == np.float64
    np.testing.assert_array_equal(np.mean(curves, axis=0), curves.values.mean(axis=0))


def test_a_table_has_the_controls_over_time(curves):
    table = curves.to_pandas()
    assert list(table.columns) == list(NAMES) and table.index.name == "time"
    np.testing.assert_allclose(table.index, np.arange(6) / 30)
    np.testing.assert_array_equal(table.to_numpy(), curves.values)
    table["a"] = 0.0
    assert curves.values[1, 0] == 3
