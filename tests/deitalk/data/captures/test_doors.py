"""Takes as other programs and spreadsheets leave them, at every door: the same curves, or a line.

Every row is one kind of file made of the same take. `read_capture` (`deitalk data import`) and
`read_curves` (convert, validate, retarget, preview, data check) read it.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from deitalk.data.captures.columns import read_mapping
from deitalk.data.captures.labels import Labelling
from deitalk.data.captures.sources import find_takes
from deitalk.data.captures.take import read_capture
from rig import read_curves, write_curves
from rig.conversion.arkit import arkit_controls
from rig.errors import UserError
from tests.command import deitalk, ran, refused
from tests.deitalk.data.captures.shape_tables import (
    HEADS,
    NAMES,
    SHAPES,
    SPELLINGS,
    assert_same,
    both,
    frames,
    live_link,
    motion,
    table,
    text,
)
from tests.deitalk.data.captures.test_applications import results
from tests.deitalk.data.captures.test_gaps import GAPS, without_face


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
