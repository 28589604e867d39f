"""Rows of captured tables without a face."""

import json

import numpy as np
import pytest

from deitalk.data.captures.take import read_capture
from rig.errors import UserError
from tests.deitalk.data.captures.shape_tables import both, frames, live_link, motion, table, text
from tests.deitalk.data.captures.test_applications import mediapipe_frames

GAPS = [(0, 10), (20, 21), (30, 40), (70, 75), (0, 3)]


def without_face(rows, gaps, style):
    for start, stop in gaps:
        for row in rows[1 + start : 1 + stop]:
            if style == "short":
                del row[2:]
                row[1] = 0
                continue
            row[1] = 0
            if style == "empty":
                row[2:] = [""] * 61
            elif style == "nan":
                row[2:] = ["nan"] * 61
            elif style == "zeros":
                row[2:] = [0] * 61
            elif style == "shapes":
                row[2:54] = [""] * 52
    return rows


@pytest.mark.parametrize("style", ["empty", "nan", "zeros", "short", "shapes"])
def test_rows_without_a_face_are_time_without_a_frame(tmp_path, style):
    rows = without_face(live_link(*frames(30)), GAPS, style)
    (tmp_path / "a.csv").write_text(text(rows))
    curves, capture = both(tmp_path / "a.csv")
    assert len(curves) == 75
    gone = np.zeros(75, bool)
    for start, stop in GAPS:
        gone[start:stop] = True
    assert np.abs(curves.values[~gone, :52] - motion(curves.times)[~gone, :52]).max() < 2e-3
    assert "26 of 75 rows are without a face" in curves.notes
    assert capture.seen[10:70].all()  # a third of a second is bridged
    assert not capture.seen[:10].any() and not capture.seen[70:].any()


@pytest.mark.parametrize("kind", ["livelink", "arkit", "mediapipe"])
def test_long_gaps_are_left_out(tmp_path, kind):
    times, values = frames(30, 5)
    lost = slice(60, 105)
    if kind == "mediapipe":
        path = tmp_path / "a.json"
        data = mediapipe_frames(times, values)
        for frame in data[lost]:
            frame["blendshapes"] = []
        path.write_text(json.dumps(data))
    else:
        path = tmp_path / "a.csv"
        rows = table(times, values) if kind == "arkit" else live_link(times, values)
        first = 1 if kind == "arkit" else 2
        for row in rows[1:][lost]:
            row[first:] = [""] * len(row[first:])
        path.write_text(text(rows))
    curves, capture = both(path)
    assert len(curves) == 150 and not capture.seen[lost].any()
    assert capture.seen[:60].all() and capture.seen[105:].all()
    assert any("1.5 s without a frame, left out" in note for note in capture.notes)
    assert any("1.5 s without a frame: straight lines" in note for note in curves.notes)


def test_takes_without_any_face_are_refused(tmp_path):
    rows = without_face(live_link(*frames(30)), [(0, 75)], "empty")
    (tmp_path / "a.csv").write_text(text(rows))
    with pytest.raises(UserError, match="no row has a face"):
        read_capture(tmp_path / "a.csv")
