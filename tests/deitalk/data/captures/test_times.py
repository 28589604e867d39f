"""Times of captured tables: seconds, stamps, rates, and time codes of every count."""

import json
from itertools import cycle

import pytest

from deitalk.data.captures.take import read_capture
from rig import read_curves
from rig.errors import UserError
from rig.validation.files import validate
from tests.deitalk.data.captures.shape_tables import (
    SHAPES,
    apple,
    assert_same,
    frames,
    live_link,
    table,
    text,
)

STAMPS = {
    "seconds": (lambda t: f"{t:.6f}", "time", ""),
    "three digits": (lambda t: f"{t:.3f}", "time", ""),
    "since 1970": (lambda t: f"{1.7e9 + t:.4f}", "timestamp", ""),
    "milliseconds": (lambda t: f"{1000 * t:.0f}", "time", "milliseconds"),
    "named": (lambda t: f"{1000 * t:.3f}", "Timestamp (ms)", "milliseconds"),
    "camel": (lambda t: f"{1000 * t:.0f}", "timestampMs", "milliseconds"),
    "microseconds": (lambda t: f"{1e6 * t:.0f}", "timestamp_us", "microseconds"),
    "unnamed microseconds": (lambda t: f"{1e6 * t:.0f}", "t", "microseconds"),
    "nanoseconds": (lambda t: f"{1e9 * (t + 5):.0f}", "timestamp", "nanoseconds"),
    "hours": (lambda t: f"10:11:{12 + t:06.3f}", "time", ""),
    "dates": (lambda t: f"2024-05-01 10:11:{12 + t:09.6f}", "timestamp", ""),
    "ISO": (lambda t: f"2024-05-01T10:11:{12 + t:09.6f}Z", "time", ""),
    "time codes": (lambda t: f"10:11:{12 + int(t + 1e-9):02d}:{round(t % 1 * 30) % 30:02d}", "Timecode", "count 30"),
}  # fmt: skip


@pytest.mark.parametrize("name", STAMPS)
def test_stamps_of_time(tmp_path, name):
    stamp, head, note = STAMPS[name]
    times, values = frames(30)
    (tmp_path / "a.csv").write_text(text(table(times, values, head=head, stamp=stamp)))
    assert_same(tmp_path / "a.csv", 30, note=note, tolerance=1e-2)


RATES = [24, 24000 / 1001, 25, 30000 / 1001, 30, 48, 50, 60, 90, 120, 240]


@pytest.mark.parametrize(("fps", "unit"), [*zip(RATES, cycle((1, 1000, 1e6))), (30, 1), (60, 1)])
def test_rates_of_tables(tmp_path, fps, unit):
    rows = table(*frames(fps), stamp=lambda t: f"{unit * t:.6f}")
    (tmp_path / "a.csv").write_text(text(rows))
    assert_same(tmp_path / "a.csv", fps)


@pytest.mark.parametrize(
    ("stamp", "expected"),
    [
        (lambda t: f"{round(30 * t)}", "numbers of frames"),
        (lambda t: f"{30 * t * 0.001:.4f}", "frames are 0.001 apart"),
        (lambda t: f"{30 * t * 10:.1f}", ""),
        (lambda t: f"{30 * t * 2:.1f}", "frames are 2 apart"),
        (lambda t: f"{10 - t:.4f}", "comes not after"),
        (lambda t: f"soon {t}", "'soon 0.0'"),
    ],
)
def test_times_of_no_capture_are_refused_and_a_rate_given_is_used(tmp_path, stamp, expected):
    path = tmp_path / "a.csv"
    path.write_text(text(table(*frames(30), stamp=stamp)))
    if not expected:  # 10 ms
        assert read_capture(path).curves.fps == 100
        return
    for read in (read_capture, read_curves):
        with pytest.raises(UserError, match=expected):
            read(path)
    if "frames" in expected:
        assert read_curves(path, fps=30).fps == 30


def test_rates_that_disagree_with_the_times_are_told(tmp_path):
    times, values = frames(30)
    rows = [
        {"time": t, "blendShapes": dict(zip(map(apple, SHAPES), v[:52].tolist(), strict=True))}
        for t, v in zip(times.tolist(), values, strict=True)
    ]
    (tmp_path / "a.json").write_text(json.dumps({"fps": 60, "frames": rows}))
    assert_same(tmp_path / "a.json", 30, note="its times say 30 Hz, not 60")
    (tmp_path / "b.csv").write_text(text(table(times, values)))
    assert (
        "its times say 30 Hz, not 60: they count" in read_capture(tmp_path / "b.csv", fps=60).notes
    )
    curves = read_curves(tmp_path / "b.csv", fps=60, control_set=None)
    assert curves.fps == 60 and "read at 60 Hz as given; its times say 30" in curves.notes


CLOCKS = [
    (count, fps)
    for count in (24, 25, 30, 48, 50, 60, 120)
    for fps in (count, count / 2, count / 4)
    if fps >= 12
] + [(60, 24), (60, 25), (30, 60), (24, 60), (25, 60), (60, 30000 / 1001), (60, 24000 / 1001)]


@pytest.mark.parametrize(
    ("count", "fps", "start"),
    [(*clock, start) for clock, start in zip(CLOCKS, cycle((0.0, 36672.4, 86399.0)))],
)
def test_frame_fields_of_every_count(tmp_path, count, fps, start):
    start = round(start * count) / count
    (tmp_path / "a.csv").write_text(text(live_link(*frames(fps), count, start=start)))
    curves, capture = assert_same(tmp_path / "a.csv", fps, tolerance=4e-3)
    note = "" if count in (30, 60) else f"count {count} frames a second"
    assert note in "; ".join(curves.notes)
    assert capture.start == pytest.approx(start % 86400, abs=1e-3)
    if note:
        found = validate(tmp_path / "a.csv").findings
        assert any(f.level == "error" and note in f.text for f in found)


def test_one_frame_a_count_is_the_counted_rate(tmp_path):
    """Thousandths that run on, as some programs write them, are no time."""
    times, values = frames(24)
    rows = live_link(times, values, 24)
    for i, row in enumerate(rows[1:], 1):
        row[0] = f"{row[0][:-4]}.{i:03d}"
    (tmp_path / "a.csv").write_text(text(rows))
    assert_same(tmp_path / "a.csv", 24)


@pytest.mark.parametrize("count", [30, 60])
@pytest.mark.parametrize(
    ("mark", "start"),
    [
        (";", 0.0),
        (";", 58.9),
        (";", 3599.0),
        (";", 599.5),
        (";", 36672.4),
        (":", 58.9),
        (":", 7738),
    ],
)
def test_drop_frame(tmp_path, count, start, mark):
    fps = count * 1000 / 1001
    start = round(start * fps) / fps
    rows = live_link(*frames(fps), count, drop=True, start=start)
    rows = [[str(row[0]).replace(";", mark), *row[1:]] for row in rows]
    (tmp_path / "a.csv").write_text(text(rows))
    _, capture = assert_same(tmp_path / "a.csv", fps, tolerance=4e-3, note="drop-frame")
    assert capture.start == pytest.approx(start, abs=2e-3)


def test_drop_frame_of_another_count_is_refused(tmp_path):
    rows = live_link(*frames(25), 25)
    (tmp_path / "a.csv").write_text(text(rows).replace(":00.000,", ";00.000,"))
    with pytest.raises(UserError, match="count 25 frames a second; drop frame counts 30 or 60"):
        read_curves(tmp_path / "a.csv")
