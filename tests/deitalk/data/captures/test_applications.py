"""Captures of MediaPipe and of other applications."""

import json

import numpy as np
import pytest

from deitalk.data.captures.take import read_capture
from rig import read_curves
from rig.errors import UserError
from rig.validation.files import validate
from tests.deitalk.data.captures.shape_tables import (
    NAMES,
    SHAPES,
    apple,
    assert_same,
    cells,
    frames,
    motion,
    sides,
    table,
    text,
)


def mediapipe_frames(times, values, key="timestamp", unit=1000):
    return [
        {key: round(unit * t), "blendshapes": categories(v)}
        for t, v in zip(times.tolist(), values, strict=True)
    ]


def categories(row, label="categoryName", score="score"):
    found = [{"index": 0, score: 1e-5, label: "_neutral", "displayName": ""}]
    return found + [
        {"index": i, score: float(row[i]), label: apple(name), "displayName": ""}
        for i, name in enumerate(SHAPES[:51], 1)
        for i in [i - 1]
    ]


def results(times, values):
    pairs = list(zip((1000 * times).round().astype(int).tolist(), values, strict=True))
    snake_case = [
        {"timestamp_ms": t, "face_blendshapes": [categories(v, "category_name")]} for t, v in pairs
    ]
    return {
        "objects": mediapipe_frames(times, values),
        "microseconds": mediapipe_frames(times, values, "timestamp_us", 1e6),
        "results of JavaScript": [
            {"timestampMs": t, "faceBlendshapes": [{"categories": categories(v), "headIndex": -1}]}
            for t, v in pairs
        ],
        "results of Python": snake_case,
        "an object of frames": {"fps": 30, "frames": [{"blendshapes": categories(v)} for _, v in pairs]},
        "categories of frames": {"frames": [{"time": t / 1000, "categories": categories(v)} for t, v in pairs]},
        "lists with a rate": {"fps": 30, "blendshapes": [categories(v) for _, v in pairs]},
        "lists with times": {
            "timestamps": [t for t, _ in pairs], "results": [categories(v) for _, v in pairs],
        },
        "names and rows": {
            "names": ["_neutral", *map(apple, SHAPES[:51])],
            "frames": [[0, *v[:51].tolist()] for _, v in pairs],
            "timestamps": [t for t, _ in pairs],
        },
        "objects of weights": [
            {"timestamp": t, **dict(zip(map(apple, SHAPES[:51]), v[:51].tolist(), strict=True))}
            for t, v in pairs
        ],
    }  # fmt: skip


@pytest.mark.parametrize("layout", results(*frames(30, 0.1)))
def test_results_of_mediapipe(tmp_path, layout):
    path = tmp_path / "a.json"
    path.write_text(json.dumps(results(*frames(30))[layout]))
    capture = read_capture(path)
    assert capture.curves.fps == pytest.approx(30, abs=1e-3)
    jaw = motion(capture.curves.times)[:, NAMES.index("JawOpen")]
    assert np.abs(capture.curves["CTRL_C_jaw.ty"] - jaw).max() < 1e-2
    assert any("lacks 1 column, not known: 'TongueOut'" in note for note in capture.notes)
    if layout not in ("names and rows", "objects of weights"):
        assert read_curves(path).fps == pytest.approx(30, abs=1e-3)


def test_lists_without_a_rate_ask_for_one(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(json.dumps([categories(v) for v in frames(30)[1]]))
    with pytest.raises(UserError, match="give `fps`"):
        read_capture(path)
    assert read_capture(path, fps=30).curves.fps == 30
    with pytest.raises(UserError, match="`source_fps`"):
        read_curves(path)
    assert read_curves(path, fps=30).fps == 30


def test_columns_of_mediapipe(tmp_path):
    times, values = frames(30)
    rows = table(times, values, SHAPES[:51])
    rows = [[row[0], "_neutral" if i == 0 else "0.1", *row[1:]] for i, row in enumerate(rows)]
    (tmp_path / "a.csv").write_text(text(rows))
    assert_same(tmp_path / "a.csv", 30, columns=slice(0, 51), note="'TongueOut'")


@pytest.mark.parametrize(("unit", "factor"), [(1000, 1), (1000, 100), (1, 1)])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_text_of_face_cap(tmp_path, unit, factor, end):
    times, values = frames(60)
    lines = ['info,"demo"', ",".join(["bs", *(apple(sides(n, "_L", "_R")) for n in SHAPES)])]
    for t, v in zip(times, values, strict=True):
        lines.append(",".join(["k", f"{unit * t:.4f}", *["0"] * 10, *cells(factor * v[:52])]))
    lines[40] = ",".join(lines[40].split(",")[:12])  # no face
    (tmp_path / "a.txt").write_text(end.join(lines))
    note = "percent" if factor == 100 else "1 of 150 rows are without a face"
    assert_same(tmp_path / "a.txt", 60, note=note, tolerance=5e-3)
    assert validate(tmp_path / "a.txt").ok


def test_a_renamed_column_is_named_and_other_columns_are_left_out(tmp_path):
    times, values = frames(30)
    names = [*SHAPES[:51], "confidence"]
    (tmp_path / "a.csv").write_text(text(table(times, values, names)))
    _, capture = assert_same(tmp_path / "a.csv", 30, columns=slice(0, 51))
    assert "1 column is left out: 'confidence'" in capture.notes
    for wrong in ("TongeOut", "tongueOut2"):
        names[51] = wrong
        (tmp_path / "a.csv").write_text(text(table(times, values, names)))
        for read in (read_capture, read_curves):
            with pytest.raises(UserError, match=f"'{wrong}' is unknown and 'TongueOut' is missing"):
                read(tmp_path / "a.csv")
