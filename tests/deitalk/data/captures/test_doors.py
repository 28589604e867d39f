"""Takes as other programs and spreadsheets leave them, at every door: the same curves, or a line.

Every row is one kind of file made of the same take. `read_capture` (`deitalk data import`) and
`read_curves` (convert, validate, retarget, preview, data check) read it.
"""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from deitalk.audio.load import load_audio, write_wav
from deitalk.data.captures.columns import read_mapping
from deitalk.data.captures.imported import import_captures
from deitalk.data.captures.labels import Labelling
from deitalk.data.captures.sources import find_takes
from deitalk.data.captures.take import paired, read_capture
from rig import read_curves, write_curves
from rig.conversion.arkit import ARKIT_ID, HEAD, arkit_controls
from rig.errors import UserError
from rig.validation.files import validate
from tests.command import deitalk, ran, refused
from tests.takes import bursts

NAMES = arkit_controls().names
SHAPES = NAMES[:52]
HEADS = [NAMES.index(name) for name in HEAD]
SECONDS = 2.5


def motion(times):
    """Values of all columns at given seconds [shape=(T, 61)]: smooth, every shape moves."""
    peak = np.linspace(0.1, 0.9, 52)
    swing = 0.5 - 0.5 * np.cos(2 * np.pi * (0.4 + 0.1 * np.arange(52) % 1) * times[:, None])
    values = np.zeros((len(times), 61))
    values[:, :52] = peak * swing
    values[:, HEADS] = 0.3 * np.sin(times[:, None] * [1, 2, 3])  # 15 degrees
    return values


def frames(fps, seconds=SECONDS):
    times = np.arange(round(seconds * fps)) / fps
    return times, motion(times)


def apple(name):
    return name[0].lower() + name[1:]


def cells(row, digits=5):
    return (f"%.{digits}f " * len(row) % tuple(row)).split()


def table(times, values, names=SHAPES, *, head="time", stamp=lambda t: f"{t:.6f}", digits=5):
    """A CSV with commas."""
    rows = [[stamp(t), *cells(v[: len(names)], digits)] for t, v in zip(times, values, strict=True)]
    return [[head, *names], *rows]


def text(rows, separator=",", end="\n"):
    return end.join(separator.join(map(str, row)) for row in rows) + end


def live_link(times, values, count=60, *, drop=False, start=0.0, names=NAMES):
    """Rows of a Live Link CSV whose frame field counts so many frames."""
    step = count * 1000 / 1001 if drop else count
    rows = []
    for t, v in zip(times, values, strict=True):
        parts = round((t + start) * step * 1000)
        number, thousandths = divmod(parts, 1000)
        if drop:
            number = labelled(number, count)
        seconds, frame = divmod(number, count)
        h, m, s = seconds // 3600 % 24, seconds // 60 % 60, seconds % 60
        mark = ";" if drop else ":"
        rows.append([f"{h:02d}:{m:02d}:{s:02d}{mark}{frame:02d}.{thousandths:03d}", 61, *cells(v)])
    return [["Timecode", "BlendshapeCount", *names], *rows]


def labelled(number, count):
    """Number of a drop-frame code that counts all numbers, by a loop over minutes."""
    minute = 0
    left = 0
    while True:
        length = count * 60 - (left if minute % 10 else 0)
        if number < length:
            skipped = left if minute % 10 else 0
            return minute * 60 * count + number + skipped
        number -= length
        minute += 1
        left = 2 if count == 30 else 4


def sides(name, left, right):
    if name.endswith("Left") and name not in ("JawLeft", "MouthLeft"):
        return name[:-4] + left
    if name.endswith("Right") and name not in ("JawRight", "MouthRight"):
        return name[:-5] + right
    return name


def snake(name):
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


SPELLINGS = {
    "app": lambda n: n,
    "apple": apple,
    "apple_L": lambda n: apple(sides(n, "_L", "_R")),
    "Apple_L": lambda n: sides(n, "_L", "_R"),
    "apple_l": lambda n: apple(sides(n, "_l", "_r")),
    "appleL": lambda n: apple(sides(n, "L", "R")),
    "apple.L": lambda n: apple(sides(n, ".L", ".R")),
    "apple_Left": lambda n: apple(sides(n, "_Left", "_Right")),
    "apple_left": lambda n: apple(sides(n, "_left", "_right")),
    "snake": snake,
    "SNAKE": lambda n: snake(n).upper(),
    "small": str.lower,
    "large": str.upper,
    "words": lambda n: snake(n).replace("_", " "),
    "prefixed": lambda n: f"blendShapes.{apple(n)}",
}


def both(path, fps=None):
    """Curves of ARKit's shapes by `read_curves`, and the capture."""
    return read_curves(path, control_set=None, fps=fps), read_capture(path, fps=fps)


def assert_same(path, fps, *, tolerance=2e-3, given=None, columns=slice(0, 52), note=""):
    curves, capture = both(path, given)
    assert curves.control_set == ARKIT_ID
    assert curves.fps == pytest.approx(fps, abs=1e-3) == capture.curves.fps
    expected = motion(curves.times)[:, columns]
    assert np.abs(curves.values[:, columns] - expected).max() < tolerance
    jaw = capture.curves["CTRL_C_jaw.ty"]
    assert np.abs(jaw - expected[:, NAMES.index("JawOpen")]).max() < tolerance
    for notes in (curves.notes, capture.notes):
        assert note in "; ".join(notes)
    return curves, capture


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_spellings_of_shapes(tmp_path, spelling):
    times, values = frames(30)
    names = list(map(SPELLINGS[spelling], SHAPES))
    path = tmp_path / "a.csv"
    path.write_text(text(table(times, values, names)))
    _, capture = assert_same(path, 30)
    assert len(capture.known) == 73 and not [n for n in capture.notes if "left out" in n]
    other = read_capture(path, rig=arkit_controls())
    assert len(other.known) == 52


LAYOUTS = {
    "commas": lambda rows: text(rows).encode(),
    "semicolons": lambda rows: text(rows, ";").encode(),
    "tabs": lambda rows: text(rows, "\t").encode(),
    "sep=,": lambda rows: b"sep=,\r\n" + text(rows, end="\r\n").encode(),
    "sep=;": lambda rows: b"sep=;\n" + text(rows, ";").encode(),
    "quoted sep": lambda rows: b'"sep=\t"\n' + text(rows, "\t").encode(),
    "decimal commas": lambda rows: text(comma(rows), ";").encode(),
    "decimal commas and tabs": lambda rows: text(comma(rows), "\t").encode(),
    "quoted decimal commas": lambda rows: text(quote(comma(rows))).encode(),
    "quoted": lambda rows: text(quote(rows)).encode(),
    "byte order mark": lambda rows: text(rows).encode("utf-8-sig"),
    "UTF-16": lambda rows: text(rows, end="\r\n").encode("utf-16"),
    "UTF-16 big": lambda rows: b"\xfe\xff" + text(rows, "\t").encode("utf-16-be"),
    "UTF-16 without mark": lambda rows: text(rows, "\t").encode("utf-16-le"),
    "UTF-16 decimal commas": lambda rows: text(comma(rows), ";", "\r\n").encode("utf-16"),
    "CRLF": lambda rows: text(rows, end="\r\n").encode(),
    "CR": lambda rows: text(rows, end="\r").encode(),
    "no end of line": lambda rows: text(rows).rstrip().encode(),
    "spaces": lambda rows: text(rows, ", ").encode(),
    "empty rows at the end": lambda rows: (
        text(rows) + 3 * ("," * (len(rows[0]) - 1) + "\n")
    ).encode(),
    "lines at the end": lambda rows: (text(rows) + "\n\r\n \n").encode(),
    "empty columns": lambda rows: text([[*row, "", ""] for row in rows]).encode(),
    "comma at the end of rows": lambda rows: text(
        [rows[0], *([*r, ""] for r in rows[1:])]
    ).encode(),
    "empty rows first": lambda rows: b",,,\r\n , \n" + text(rows).encode(),
    "empty lines first": lambda rows: b"\n\n" + text(rows).encode(),
    "a comment": lambda rows: b"# exported by hand, 2 of 3\n" + text(rows).encode(),
    "padded quotes": lambda rows: text([[f'"{c} "' for c in rows[0]], *rows[1:]]).encode(),
}


def comma(rows):
    return [rows[0], *([str(cell).replace(".", ",") for cell in row] for row in rows[1:])]


def quote(rows):
    return [[f'"{cell}"' for cell in row] for row in rows]


@pytest.mark.parametrize("kind", ["arkit", "livelink"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts_of_a_table(tmp_path, layout, kind):
    times, values = frames(30)
    rows = table(times, values) if kind == "arkit" else live_link(times, values)
    path = tmp_path / "a.csv"
    path.write_bytes(LAYOUTS[layout](rows))
    assert_same(path, 30)


@pytest.mark.parametrize("suffix", [".tsv", ".txt"])
def test_tables_with_tabs_under_other_suffixes(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_text(text(table(*frames(30)), "\t"))
    assert read_capture(path).curves.fps == 30


# Units.


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


# Times.


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


@pytest.mark.parametrize("fps", [24, 24000 / 1001, 25, 30000 / 1001, 30, 48, 50, 60, 90, 120, 240])
@pytest.mark.parametrize("unit", [1, 1000, 1e6])
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


# Time codes.


CLOCKS = [
    (count, fps)
    for count in (24, 25, 30, 48, 50, 60, 120)
    for fps in (count, count / 2, count / 4)
    if fps >= 12
] + [(60, 24), (60, 25), (30, 60), (24, 60), (25, 60), (60, 30000 / 1001), (60, 24000 / 1001)]


@pytest.mark.parametrize(("count", "fps"), CLOCKS)
@pytest.mark.parametrize("start", [0.0, 36672.4, 86399.0])
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


# Rows without a face.


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


# Other applications.


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


# Pairs of sound and curves.


def broadcast(path, start, seconds, rate=16_000):
    """A recording with a time code: bursts of a tone, so that it holds speech."""
    write_wav(path, bursts(seconds), start=start)


PAIRS = {
    "curves 2 s later": (51020.0, 51022.0, 5, 3, 2.0, "2.00 s of sound"),
    "curves 1 s earlier": (51021.0, 51020.0, 4, 4, -1.0, "1.00 s of sound and 1.00 s of curves"),
    "sound within": (51021.5, 51020.0, 2, 6, -1.5, "4.00 s of curves"),
    "curves within": (51000.0, 51004.25, 20, 4, 4.25, "16.00 s of sound"),
    "over midnight": (86399.0, 1.0, 6, 3, 2.0, "3.00 s of sound"),
    "midnight before the sound": (0.5, 86399.5, 4, 4, -1.0, "1.00 s of sound and 1.00 s of curves"),
    "at once": (51020.0, 51020.0, 3, 3, 0.0, ""),
    "hours apart": (51020.0, 12.0, 3, 3, 0.0, "do not overlap"),
    "an hour apart": (51020.0, 54620.0, 3, 3, 0.0, "laid together at the start"),
    "a moment together": (51020.0, 51022.8, 3, 3, 0.0, "laid together at the start"),
    "no time codes in the sound": (0.0, 51022.0, 3, 3, 0.0, ""),
}


@pytest.mark.parametrize("fps", [60, 24, 30000 / 1001])
@pytest.mark.parametrize("name", PAIRS)
def test_time_codes_lay_sound_and_curves_together(tmp_path, name, fps):
    sound_start, start, sound_seconds, seconds, late, note = PAIRS[name]
    count = 60
    step = round(start * count) / count
    rows = live_link(*frames(fps, seconds), count, start=step)
    (tmp_path / "a.csv").write_text(text(rows))
    broadcast(tmp_path / "a.wav", sound_start, sound_seconds)
    capture, sound = paired(read_capture(tmp_path / "a.csv"), load_audio(tmp_path / "a.wav"))
    assert note in "; ".join(capture.notes)
    whole = load_audio(tmp_path / "a.wav").waveform
    first = whole.tobytes().index(sound.waveform[:800].tobytes()) // whole.itemsize
    jaw = NAMES.index("JawOpen")
    at = capture.curves.times + first / 16_000 - late
    assert np.abs(capture.curves["CTRL_C_jaw.ty"] - motion(at)[:, jaw]).max() < 0.02
    if note and "laid" not in note and "overlap" not in note:
        assert abs(capture.curves.duration - sound.duration) < 1.5 / fps
        assert f"sound {clock_of(sound_start)}, curves {clock_of(step)}" in capture.notes[-1]


def clock_of(seconds):
    h, m = int(seconds // 3600), int(seconds // 60 % 60)
    return f"{h:02d}:{m:02d}:{seconds % 60:05.2f}"


def test_import_says_how_a_take_was_paired(tmp_path):
    rows = live_link(*frames(60, 3), start=51022.0)
    (tmp_path / "t").mkdir()
    (tmp_path / "t" / "a.csv").write_text(text(rows))
    broadcast(tmp_path / "t" / "a.wav", 51020.0, 5)
    result = import_captures([tmp_path / "t"], tmp_path / "data", actor="a", split_by="none")
    (take,) = result.takes
    assert take.notes[0] == (
        "paired by time code (sound 14:10:20.00, curves 14:10:22.00): 2.00 s of sound outside "
        "both, cut"
    )
    assert take.seconds == pytest.approx(3, abs=0.02)


# Other doors.


def test_a_map_and_a_table_of_takes_of_a_spreadsheet(tmp_path):
    times, values = frames(30)
    names = [f"own_{name}" for name in SHAPES]
    (tmp_path / "a.csv").write_text(text(table(times, values, names)))
    rows = [["target", "source", "weight"], *([n, f"own_{n}", "0,5"] for n in SHAPES)]
    (tmp_path / "m.csv").write_bytes(text(rows, ";", "\r\n").encode("utf-8-sig"))
    capture = read_capture(tmp_path / "a.csv", mapping=read_mapping(tmp_path / "m.csv"))
    jaw = motion(times)[:, NAMES.index("JawOpen")]
    assert np.abs(capture.curves["CTRL_C_jaw.ty"] - 0.5 * jaw).max() < 2e-3
    (tmp_path / "t.csv").write_text(text([["take", "actor", "emotion"], ["a", "anna", "joy"]], ";"))
    labels = Labelling(table=tmp_path / "t.csv")
    (source,), _ = find_takes([tmp_path / "a.csv"])
    assert labels.of(source).actor == "anna" and labels.of(source).emotion == "happy"


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_json_with_a_mark(tmp_path, encoding):
    data = json.dumps(results(*frames(30))["objects"])
    (tmp_path / "a.json").write_bytes(data.encode(encoding))
    assert both(tmp_path / "a.json")[1].curves.fps == pytest.approx(30, abs=1e-3)


@pytest.mark.parametrize("fps", [0.1, 1000])
def test_clips_of_a_millisecond_or_ten_seconds_a_frame_are_refused(tmp_path, fps):
    board = read_curves(write_curves_of(tmp_path / "own.csv"))
    with pytest.raises(UserError, match="must be from 1 to 300"):
        replace(board, fps=fps)
    write_curves(tmp_path / "a.json", board)
    content = json.loads((tmp_path / "a.json").read_text())
    (tmp_path / "a.json").write_text(json.dumps(content | {"fps": fps}))
    assert read_curves(tmp_path / "a.json", fps=30).fps == 30
    for read in (read_curves, read_capture):
        with pytest.raises(UserError, match="frames a second"):
            read(tmp_path / "a.json")


def write_curves_of(path):
    path.write_text(text(table(*frames(30))))
    return path


@pytest.mark.parametrize("kind", ["percent", "24 frames", "degrees", "no face", "milliseconds"])
def test_commands_say_what_was_corrected(tmp_path, kind):
    times, values = frames(24 if kind == "24 frames" else 30)
    degrees = values.copy()
    degrees[:, HEADS] *= 50
    rows, note = {
        "percent": (table(times, 100 * values), "values are percent: divided by 100"),
        "24 frames": (live_link(times, values, 24), "time codes count 24 frames a second"),
        "degrees": (live_link(times, degrees), "head angles are degrees, up to 15"),
        "no face": (without_face(live_link(times, values), GAPS, "empty"), "26 of 75 rows"),
        "milliseconds": (table(1000 * times, values), "times are taken as milliseconds"),
    }[kind]
    (tmp_path / "a.csv").write_text(text(rows))
    converted = ran("convert", tmp_path / "a.csv", tmp_path / "b.json")
    assert note in converted.stderr
    preview = deitalk("preview", tmp_path / "a.csv", "-o", tmp_path / "b.html")
    assert note in preview.err  # before the page, which a checkout may not have built
    report = write_curves(tmp_path / "c.csv", read_curves(tmp_path / "a.csv"))
    assert any(note in line for line in report.notes)


def test_a_head_as_quaternion_is_left_out_and_named(tmp_path):
    times, values = frames(30)
    names = [*SHAPES, "HeadQuatX", "HeadQuatY", "HeadQuatZ", "HeadQuatW"]
    (tmp_path / "a.csv").write_text(text(table(times, values, names)))
    curves, capture = assert_same(tmp_path / "a.csv", 30)
    for notes in (curves.notes, capture.notes):
        assert "4 columns are left out: 'HeadQuatX', 'HeadQuatY', 'HeadQuatZ' and 1 more" in notes


def test_the_way_out_of_an_unknown_rig_is_the_option_of_the_command(tmp_path):
    (tmp_path / "a.csv").write_text(text(table(*frames(30), [f"own_{name}" for name in SHAPES])))
    line = refused("data", "import", tmp_path / "a.csv", "-o", tmp_path / "data")
    assert "give --map, a table" in line
