"""Units of captured tables: percent, bytes, degrees and radians, or a line where they are none."""

import numpy as np
import pytest

from deitalk.data.captures.take import read_capture
from rig import read_curves
from rig.errors import UserError
from rig.validation.files import validate
from tests.deitalk.data.captures.shape_tables import (
    HEADS,
    NAMES,
    assert_same,
    both,
    frames,
    live_link,
    table,
    text,
)


def scaled(values, factor, digits=3, whole=False):
    values = values.copy()
    values[:, :52] *= factor
    return np.rint(values) if whole else values


@pytest.mark.parametrize("kind", ["arkit", "livelink"])
@pytest.mark.parametrize(
    ("factor", "whole", "note", "tolerance"),
    [
        (1, False, "", 2e-3),
        (100, False, "percent: divided by 100", 2e-3),
        (100, True, "percent: divided by 100", 6e-3),
        (255, True, "0 to 255: divided by 255", 3e-3),
    ],
)
def test_units_of_shapes(tmp_path, kind, factor, whole, note, tolerance):
    times, values = frames(30)
    many = scaled(values, factor, whole=whole)
    if kind == "livelink":
        many[:, 52:] = values[:, 52:]
    rows = table(times, many) if kind == "arkit" else live_link(times, many)
    (tmp_path / "a.csv").write_text(text(rows))
    assert_same(tmp_path / "a.csv", 30, tolerance=tolerance, note=note, columns=slice(0, 51))


def test_percent_a_little_beyond_both_ends(tmp_path):
    times, values = frames(30)
    many = 100 * values
    many[:, 3] -= 2.5
    many[:, 17] *= 1.3 / 0.95
    (tmp_path / "a.csv").write_text(text(table(times, many)))
    capture = read_capture(tmp_path / "a.csv")
    assert "percent: divided by 100" in capture.notes[0]
    assert any("clamped to their ranges" in note for note in capture.notes)


def test_whole_numbers_beyond_100_may_be_percent_or_bytes(tmp_path):
    times, values = frames(30)
    (tmp_path / "a.csv").write_text(text(table(times, np.rint(120 * values))))
    with pytest.raises(UserError, match="percent beyond 100, or 0 to 255"):
        read_capture(tmp_path / "a.csv")


def test_shapes_that_hardly_move_in_percent_are_named(tmp_path):
    """They may be of another unit; a gaze to one side has a still other side."""
    times, values = frames(30)
    values[:, NAMES.index("CheekPuff")] = 0.006 * np.sin(times)
    values[:, NAMES.index("EyeLookOutRight")] = 0.004 * np.sin(times)
    (tmp_path / "a.csv").write_text(text(table(times, 100 * values)))
    (note,) = read_capture(tmp_path / "a.csv").notes[:1]
    assert note == (
        "values are percent: divided by 100 (EyeLookOutRight, CheekPuff below 1.5 percent)"
    )


SPOILT = {
    "percent in some columns": lambda v: v * np.where(np.arange(61) % 2, 100, 1),
    "percent on one side": lambda v: v * np.where(["Left" in n for n in NAMES], 100, 1),
    "one value of 37": lambda v: np.where(np.arange(v.size).reshape(v.shape) == 17, 37, v),
    "thousands": lambda v: 5000 * v,
    "bytes with fractions": lambda v: 240 * v,
}


@pytest.mark.parametrize("name", SPOILT)
def test_values_of_no_unit_are_refused_in_one_line(tmp_path, name):
    times, values = frames(30)
    values[:, 52:] = 0
    (tmp_path / "a.csv").write_text(text(table(times, SPOILT[name](values))))
    for read in (read_capture, lambda path: read_curves(path, control_set=None)):
        with pytest.raises(UserError, match="far outside 0 to 1") as caught:
            read(tmp_path / "a.csv")
        assert "\n" not in str(caught.value)
    assert not validate(tmp_path / "a.csv").ok


ANGLES = {
    "radians": (1.0, 0, 50.0, ""),
    "degrees": (50.0, 0, 50.0, "head angles are degrees"),
    "degrees of 0 to 360": (50.0, 360, 50.0, "head angles are degrees"),
    "degrees in whole numbers": (50.0, 0, 50.0, "head angles are degrees"),
}


@pytest.mark.parametrize("suffix", [".csv", "_livelink.csv"])
@pytest.mark.parametrize("name", ANGLES)
def test_head_angles(tmp_path, name, suffix):
    factor, turn, _, note = ANGLES[name]
    times, values = frames(30)
    written = values.copy()
    written[:, HEADS] = values[:, HEADS] * factor
    if "whole" in name:
        written[:, HEADS] = np.rint(written[:, HEADS])
    if turn:
        written[:, HEADS] %= turn
    rows = live_link(times, written) if "livelink" in suffix else table(times, written, NAMES)
    path = tmp_path / f"a{suffix}"
    path.write_text(text(rows))
    curves, capture = both(path)
    wanted = values[:, HEADS] * [-50, 50, 50]
    for head in (read_curves(path).head, capture.curves.head):
        assert np.abs(head[:, :3] - wanted).max() < (0.6 if "whole" in name else 0.01)
    assert note in "; ".join(curves.notes) and note in "; ".join(capture.notes)
    if "livelink" in suffix and note:
        assert any(f.level == "error" and note in f.text for f in validate(path).findings)


def test_eyes_in_degrees(tmp_path):
    times, values = frames(30)
    eye = NAMES.index("LeftEyeYaw")
    values[:, eye] = np.radians(20) * np.sin(times)
    written = values.copy()
    written[:, eye] = np.degrees(values[:, eye])
    written[:, HEADS] = 50 * values[:, HEADS]
    (tmp_path / "a.csv").write_text(text(live_link(times, written)))
    curves = read_curves(tmp_path / "a.csv", control_set=None)
    assert np.abs(curves.values[:, 52:] - values[:, 52:]).max() < 1e-3


@pytest.mark.parametrize("degrees", [120, 750, 4000])
def test_a_head_turns_by_at_most_90_degrees(tmp_path, degrees):
    times, values = frames(30)
    values[40:, HEADS[0]] = degrees if degrees != 120 else -120
    (tmp_path / "a.csv").write_text(text(live_link(times, values)))
    for read in (read_capture, read_curves):
        with pytest.raises(UserError, match="at most 90"):
            read(tmp_path / "a.csv")
