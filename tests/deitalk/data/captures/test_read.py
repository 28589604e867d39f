"""Tables of curves and maps of other rigs: what is read, and one line for each fault."""

import json
import shutil

import numpy as np
import pytest

from deitalk.data.captures.columns import read_mapping
from deitalk.data.captures.sources import find_sound, find_takes
from deitalk.data.captures.take import read_capture
from deitalk.errors import DataError
from rig import default_controls, rest_curves, write_curves
from rig.conversion.raw import raw_controls
from rig.errors import UserError
from rig.formats.livelink_csv import SUBJECT_REST
from rig.formats.named import read_named
from tests.errors import one_line
from tests.takes import write_live_link

FRAMES = [{"time": i / 25, "blendShapes": {"jawOpen": i / 10, "jawLeft": 0}} for i in range(10)]


@pytest.mark.parametrize(
    "data",
    [
        FRAMES,
        {"frames": FRAMES},
        [{"timeCode": f["time"], **f["blendShapes"]} for f in FRAMES],
        {"names": ["jawOpen", "jawLeft"], "values": [[i / 10, 0] for i in range(10)], "fps": 25},
        {"facsNames": ["jawOpen", "jawLeft"], "weightMat": [[i / 10, 0] for i in range(10)],
         "exportFps": 25.0},
    ],
)  # fmt: skip
def test_layouts_of_json_give_the_same_curves(tmp_path, data):
    (tmp_path / "a.json").write_text(json.dumps(data))
    curves = read_named(tmp_path / "a.json")
    assert (curves.names, curves.fps) == (("jawOpen", "jawLeft"), 25)
    np.testing.assert_allclose(curves["jawOpen"], np.arange(10) / 10)


def test_uneven_times_are_put_on_an_even_grid(tmp_path):
    times = np.array([0, 1, 2, 3, 4.5, 5, 6, 7]) / 30
    lines = [f"{t},{t * 2}" for t in times]
    (tmp_path / "a.csv").write_text("time,jawOpen\n" + "\n".join(lines) + "\n")
    curves = read_named(tmp_path / "a.csv")
    assert curves.fps == 30 and "put on 30 fps" in curves.notes[0]
    np.testing.assert_allclose(curves["jawOpen"], 2 * np.arange(8) / 30, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("a.csv", "jawOpen,jawLeft\n0,0\n", "give `fps`"),
        ("a.csv", "time,jawOpen\n0,0\n0,1\n", "data row 2 comes not after"),
        ("a.csv", "time,jawOpen,a\n0,nan,0\n0.1,0,0\n", "data row 1, column 'jawOpen'"),
        ("a.json", '{"names": ["a"], "values": [[1, 2]], "fps": 30}', "frames x 1 names"),
        ("a.json", '[{"time": 0, "weights": {"a": 1}}, {"time": 1, "weights": {"b": 1}}]', "frame 2"),
        ("a.json", '{"names": ["a"], "values": [["x"]], "fps": 30}', "no rows of 1 numbers"),
        ("a.json", '{"names": ["a"], "values": [[1], [2, 3]], "fps": 30}', "see frame 2"),
        ("a.txt", "info,x\nbs,jawOpen\n" + "k,0,0,0,0,0,0,0,0,0,0,0,1\nk,1,0\n", "see frame 2"),
        ("a.json", "[]", "no JSON of curves"),
        ("a.xlsx", "1 2 3", "no table of curves"),
    ],
)  # fmt: skip
def test_fault_of_a_table_is_one_line(tmp_path, name, text, expected):
    (tmp_path / name).write_text(text)
    with one_line(UserError, match=expected):
        read_named(tmp_path / name)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("target,weight\na,1\n", "lacks the column source"),
        ("target,source\n", "has no rows"),
        ("target,source\nJawOpen,\n", "row 1 needs a target and a source"),
        ("target,source,weight\nJawOpen,a,x\n", "weight 'x' must be a number"),
        ("target,source\nJawOpen,a\nJawOpn,b\n", "target 'JawOpn' is no control of arkit-61"),
    ],
)
def test_fault_of_a_map_is_one_line(tmp_path, text, expected):
    (tmp_path / "map.csv").write_text(text)
    with pytest.raises(DataError, match=expected):
        read_mapping(tmp_path / "map.csv")


@pytest.mark.parametrize(
    ("suffix", "kind", "known"),
    [(".csv", "board", 185), (".raw.csv", "raw", 174),
     (".a2f.csv", "arkit", 73), (".livelink.csv", "livelink", 73), (".json", "board", 185),
     (".npz", "board", 185), (".unreal.json", "unreal", None)],
)  # fmt: skip
def test_every_written_format_is_a_capture(tmp_path, suffix, kind, known):
    curves = rest_curves(40, fps=30)
    values = curves.values.copy()
    values[:, curves.index("CTRL_C_jaw.ty")] = np.linspace(0, 0.6, 40)
    path = tmp_path / f"a{suffix}"
    write_curves(path, type(curves)(values, curves.names, fps=30))
    capture = read_capture(path)
    assert capture.kind == kind
    np.testing.assert_allclose(capture.curves["CTRL_C_jaw.ty"], values[:, 0 + curves.index(
        "CTRL_C_jaw.ty")], atol=0.02)  # fmt: skip
    if known is not None:
        assert len(capture.known) == known


def test_calibrated_variant_is_read_and_neutral_is_no_take(tmp_path):
    for ending in ("_raw", "_cal", "_neutral"):
        write_live_link(tmp_path / f"S_1_iPhone{ending}.csv", 1)
        (tmp_path / f"S_1_iPhone{ending}.wav").rename(tmp_path / "S_1_iPhone.wav")
    (tmp_path / "notes.csv").write_text("who,what\na,b\n")
    takes, skipped = find_takes([tmp_path])
    assert [t.curves.name for t in takes] == ["S_1_iPhone_cal.csv"]
    assert [p.name for p in skipped] == ["notes.csv"]
    assert find_sound(takes[0], "", (), takes).name == "S_1_iPhone.wav"


@pytest.mark.parametrize(
    ("names", "takes"),
    [
        (["anna_neutral.csv"], ["anna_neutral.csv"]),
        (["anna_happy.csv", "anna_neutral.csv"], ["anna_happy.csv", "anna_neutral.csv"]),
        (["S.csv", "S_neutral.csv"], ["S.csv"]),
        (["S_raw.csv", "S_cal.csv", "S_neutral.csv"], ["S_cal.csv"]),
        (["S.csv", "S_neutral.csv", "S_neutral.wav"], ["S.csv", "S_neutral.csv"]),
    ],
)
def test_a_neutral_take_is_no_resting_face_of_another(tmp_path, names, takes):
    """A resting face lies beside its take and has no recording."""
    write_live_link(tmp_path / "some.csv", 1)
    for name in names:
        given = "some.wav" if name.endswith(".wav") else "some.csv"
        shutil.copy(tmp_path / given, tmp_path / name)
    for given in ("some.csv", "some.wav"):
        (tmp_path / given).unlink()
    assert [take.curves.name for take in find_takes([tmp_path])[0]] == takes


def test_sound_is_found_in_other_folders_by_name(tmp_path):
    path = write_live_link(tmp_path / "curves" / "a.csv", 1)
    (tmp_path / "wavs").mkdir()
    path.with_suffix(".wav").rename(tmp_path / "wavs" / "Line 7.wav")
    takes, _ = find_takes([tmp_path / "curves"])
    with pytest.raises(DataError, match="no audio beside the take"):
        find_sound(takes[0], "", (), takes)
    found = find_sound(takes[0], "C:\\takes\\line 7.wav", (tmp_path / "wavs",), takes)
    assert found.name == "Line 7.wav"


def test_folder_without_takes_is_refused(tmp_path):
    with pytest.raises(DataError, match="holds no takes"):
        find_takes([tmp_path])
    with pytest.raises(DataError, match="does not exist"):
        find_takes([tmp_path / "x"])
    (tmp_path / "a.csv").write_text("time,jaw\n0,0\n0.1,1\n")
    with pytest.raises(DataError, match="has a column of the map or rig, such as 'chin'"):
        find_takes([tmp_path], {"lip", "chin"})


def test_values_out_of_range_are_clamped_and_noted(tmp_path):
    names = default_controls().names
    header, row = ",".join(("time", *names)), ",".join(["2"] * len(names))
    (tmp_path / "a.csv").write_text(f"{header}\n0,{row}\n0.1,{row}\n")
    capture = read_capture(tmp_path / "a.csv")
    assert capture.curves.values.max() <= default_controls().maximum.max()
    assert "were clamped to their ranges" in " ".join(capture.notes)


@pytest.mark.parametrize("left_out", [0, 3])
def test_table_of_a_metahuman_subject_keeps_the_head(tmp_path, left_out):
    """Of Unreal's axes: a turn to the right is minus HeadRoll; translations are back, left, up."""
    raw = raw_controls().names[: 251 - left_out]
    header = ",".join(("time", *raw, *SUBJECT_REST))
    rows = [[i / 30, *[i / 100] * len(raw), 1, -10 * i, 0, 0, 0, 2 * i, 0, 1, 1] for i in range(4)]
    lines = [header, *(",".join(map(str, row)) for row in rows)]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    capture = read_capture(tmp_path / "a.csv")
    wanted = np.zeros((4, 6))  # yaw, pitch, roll, left, up, forward
    wanted[:, 0], wanted[:, 3] = 10 * np.arange(4), 2 * np.arange(4)
    np.testing.assert_allclose(capture.curves.head, wanted, atol=1e-5)
    assert "left out" not in " ".join(capture.notes)
    (tmp_path / "b.csv").write_text("\n".join(lines).replace("HeadControlSwitch", "Other"))
    if not left_out:  # with columns missing it would be a renamed one
        capture = read_capture(tmp_path / "b.csv")
        assert capture.curves.head is None and "1 column is left out: 'Other'" in capture.notes
