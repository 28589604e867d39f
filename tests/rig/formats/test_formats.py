import json

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from rig import ControlSet, RigCurves, default_controls, read_curves, rest_curves, write_curves
from rig.emotions import EMOTIONS
from rig.errors import ControlError, FormatError, RigError, TargetError
from rig.formats.decimal_text import Block, rows
from rig.formats.named import read_named
from rig.formats.table import FORMATS as TABLE
from rig.formats.wide_csv import read_layout, read_numbers
from rig.limits import FPS_HIGHEST

CONTROLS = default_controls()
JAW = "CTRL_C_jaw.ty"
PRECISION = {"csv": 6e-7, "json": 6e-7, "npz": 0.0}
FORMATS = list(PRECISION)
SCENES = [
    pytest.param(suffix, marks=[pytest.mark.slow] if f.name == "usd" else [])
    for f in TABLE
    if f.name in ("glb", "fbx", "usd")
    for suffix in f.suffixes
]
"""Files whose writing takes too long for `tests/fuzz`, which has all others."""


@st.composite
def curves_of_any_kind(draw):
    n_frames = draw(st.integers(1, 6))
    unit = draw(hnp.arrays(np.float32, (n_frames, 185), elements=st.floats(0, 1, width=32)))
    values = CONTROLS.minimum + unit * (CONTROLS.maximum - CONTROLS.minimum)
    tracks = {}
    if draw(st.booleans()):
        tracks["emotion"] = unit[:, :5]
    if draw(st.booleans()):
        tracks["intensity"] = 2 * unit[:, 9]
    if draw(st.booleans()):
        tracks["head"] = 40 * unit[:, 10:16] - 20
    fps = draw(st.sampled_from([24, 25, 29.97, 30, 50, 59.94, 60, 33.3]))
    return RigCurves(values, CONTROLS.names, fps, **tracks)


@pytest.mark.parametrize("suffix", FORMATS)
@settings(max_examples=15, deadline=None)
@given(curves=curves_of_any_kind())
def test_round_trip_keeps_values_names_rate_and_tracks(suffix, curves, tmp_path_factory):
    path = tmp_path_factory.mktemp("round") / f"curves.{suffix}"
    report = write_curves(path, curves)
    back = read_curves(path)
    assert back.values == pytest.approx(curves.values, abs=PRECISION[suffix], rel=0)
    assert (back.names, back.control_set) == (curves.names, curves.control_set)
    if len(curves) > 1 or suffix != "csv":
        assert back.fps == pytest.approx(curves.fps, rel=1e-9)
    if suffix == "csv":
        assert list(report.dropped) == list(curves.tracks)
        assert not back.tracks
    else:
        assert report.dropped == ()
        assert list(back.tracks) == list(curves.tracks)
        for name, written in curves.tracks.items():
            assert back.tracks[name] == pytest.approx(written, abs=2e-6, rel=0)


@given(
    hnp.arrays(
        np.float64, st.tuples(st.integers(1, 5), st.integers(1, 4)), elements=st.floats(-2e3, 2e3)
    ),
    st.integers(0, 10),
)
def test_fixed_point_text_equals_printf(values, decimals):
    text = b"".join(rows([Block(values, decimals, trim=False)])).decode()
    for line, row in zip(text.splitlines(), values, strict=True):
        for cell, value in zip(line.split(","), row, strict=True):
            assert float(cell) == pytest.approx(value, abs=0.51 * 10.0**-decimals, rel=1e-14)
            assert len(cell.partition(".")[2]) == decimals
            assert not (cell.startswith("-") and float(cell) == 0)


def test_fixed_point_text_of_hand_worked_numbers():
    values = np.array([[0.5, -0.25, 1.0, -0.0000001, 10.05, 123.0]])
    assert list(rows([Block(values, 6)])) == [b"0.5,-0.25,1,0,10.05,123\n"]
    assert list(rows([Block(values[:, :2], 2, trim=False)])) == [b"0.50,-0.25\n"]


def test_csv_is_a_plain_table_for_pandas(tmp_path):
    values = np.tile(CONTROLS.rest, (3, 1))
    values[1, CONTROLS.index(JAW)] = 0.5
    write_curves(tmp_path / "c.csv", RigCurves(values, CONTROLS.names))
    table = pd.read_csv(tmp_path / "c.csv")
    assert list(table.columns) == ["frame", "time", *CONTROLS.names]
    assert table["frame"].tolist() == [0, 1, 2]
    assert table["time"].tolist() == pytest.approx([0, 1 / 30, 2 / 30], abs=1e-9)
    assert table[JAW].tolist() == [0, 0.5, 0]


def test_json_holds_its_schema_and_control_set(tmp_path):
    write_curves(tmp_path / "c.json", rest_curves(2, fps=29.97))
    data = json.loads((tmp_path / "c.json").read_text())
    assert data["schema"] == "deitalk.curves/1"
    assert data["control_set"] == "metahuman-185@mh4"
    assert data["fps"] == pytest.approx(30000 / 1001)
    assert data["n_frames"] == len(data["values"]) == 2
    assert len(data["values"][0]) == len(data["names"]) == 185


def test_write_curves_resamples_to_a_given_rate(tmp_path):
    report = write_curves(tmp_path / "c.csv", rest_curves(30), fps=24)
    assert (report.n_frames, report.fps) == (24, 24)
    assert read_curves(tmp_path / "c.csv").fps == 24


def test_a_time_code_that_a_format_lacks_is_named(tmp_path):
    curves = rest_curves(3)
    assert "starts at 0" in write_curves(tmp_path / "a.csv", curves, start=60).note
    assert not write_curves(tmp_path / "a.unreal.json", curves, start=60).note


@pytest.mark.parametrize(
    "fps", [1.5, 12, 24, 25, 30, 50, 60, 240, FPS_HIGHEST, 23.976, 29.97, 59.94]
)
def test_rate_is_inferred_from_the_times_of_two_frames(tmp_path, fps):
    for n_frames in (2, 3, 100):
        curves = rest_curves(n_frames, fps=fps)
        write_curves(tmp_path / "c.csv", curves)
        assert read_curves(tmp_path / "c.csv").fps == pytest.approx(curves.fps, rel=1e-3)


def test_write_curves_clamps_and_reports(tmp_path):
    values = np.tile(CONTROLS.rest, (2, 1))
    values[1, CONTROLS.index(JAW)] = 1.5
    report = write_curves(tmp_path / "c.csv", RigCurves(values, CONTROLS.names))
    assert "worst CTRL_C_jaw.ty by 0.5" in str(report.clipped)
    assert read_curves(tmp_path / "c.csv")[JAW].tolist() == [0, 1]


def table_of_rest(n_frames=3):
    table = pd.DataFrame(np.tile(CONTROLS.rest, (n_frames, 1)), columns=list(CONTROLS.names))
    table.insert(0, "time", np.arange(n_frames) / 30)
    table.insert(0, "frame", np.arange(n_frames))
    return table


def save(table, path):
    table.to_csv(path, index=False)
    return path


def test_columns_may_come_in_any_order_and_spelling(tmp_path):
    table = table_of_rest()[list(reversed(table_of_rest().columns))]
    table[JAW] = [0, 0.5, 1]
    table = table.rename(columns={JAW: "CTRL_C_jaw.Y"})
    assert read_curves(save(table, tmp_path / "c.csv"))[JAW].tolist() == [0, 0.5, 1]


def test_older_board_is_read_with_rest_for_newer_controls(tmp_path):
    newer_only = [c.name for c in CONTROLS.controls if c.mh3_name == "-"]
    names = {c.name: c.mh3_name for c in CONTROLS.controls if c.mh3_name not in ("", "-")}
    table = table_of_rest().drop(columns=newer_only).rename(columns=names)
    table["CTRL_C_tongue_roll.ty"] = 0.75
    curves = read_curves(save(table, tmp_path / "c.csv"))
    assert (curves["CTRL_C_tongue_bendTwist.ty"] == 0.75).all()
    assert (curves["CTRL_C_tongue_roll.ty"] == 0).all()


def test_small_tables_are_read_as_pandas_reads_them(tmp_path):
    text = "a,b,c\r\n1,-2.5e-3, 0.1 \r\n\r\n+.5,7.,0.3333333333333333\r\n"
    (tmp_path / "c.csv").write_bytes(text.encode())
    numbers, _ = read_numbers(tmp_path / "c.csv", read_layout(tmp_path / "c.csv"))
    assert numbers.tolist() == [[1, -0.0025, 0.1], [0.5, 7, 1 / 3]]
    np.testing.assert_allclose(numbers, pd.read_csv(tmp_path / "c.csv"), rtol=1e-15)


def test_read_curves_rejects_wrong_controls(tmp_path):
    table = table_of_rest()
    with pytest.raises(FormatError, match=r"lacks 1 of the 185 controls.*CTRL_C_jaw.ty"):
        read_curves(save(table.drop(columns=JAW), tmp_path / "missing.csv"))
    with pytest.raises(ControlError, match=r"'CTRL_C_jaw.ty' occurs twice"):
        read_curves(save(table.assign(**{"CTRL_C_jaw.Y": 0}), tmp_path / "doubled.csv"))
    with pytest.raises(ControlError, match=r"unknown control 'CTRL_C_jaws.ty'.*did you mean"):
        read_curves(save(table.assign(**{"CTRL_C_jaws.ty": 0}), tmp_path / "unknown.csv"))


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        (1.5, r"data row 2, column 'CTRL_C_jaw.ty' is 1.5, outside 0 to 1"),
        (-0.1, "is -0.1, outside 0 to 1"),
        (np.nan, r"data row 2, column 'CTRL_C_jaw.ty' is empty or NaN"),
        ("wide", r"data row 2, column 'CTRL_C_jaw.ty' is 'wide'"),
        ("inf", "must be a finite number"),
        ("True", "is 'True'"),
    ],
)
def test_invalid_cells_are_named_by_row_and_column(tmp_path, cell, message):
    table = table_of_rest().astype(object)
    table.loc[1, JAW] = cell
    with pytest.raises(FormatError, match=message):
        read_curves(save(table, tmp_path / "c.csv"))


def test_read_curves_rejects_uneven_and_falling_times(tmp_path):
    table = table_of_rest(4)
    table["time"] = [0, 10, 20, 90]
    table["frame"] = 0
    with pytest.raises(FormatError, match=r"frames are 0\.001 apart"):
        read_curves(save(table / 1e4, tmp_path / "c.csv"))
    table["time"] = [0, 0, 0, 0]
    with pytest.raises(FormatError, match="data row 2 comes not after the one before"):
        read_curves(save(table, tmp_path / "c.csv"))
    with pytest.raises(FormatError, match="holds no times and no rate"):
        read_curves(save(table.drop(columns="time"), tmp_path / "c.csv"))
    assert read_curves(tmp_path / "c.csv", fps=25).fps == 25


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("a\n", "no rows under its header"),
        ("frame,time," + ",".join(CONTROLS.names) + "\n", "no rows"),
        ("frame,time," + ",".join(CONTROLS.names) + "\n0,0" + ",0" * 186 + "\n", "more cells"),
        ("frame,time," + ",".join(CONTROLS.names) + "\n0,0" + ",0" * 99 + "\n", "empty or NaN"),
        ("x" * (1 << 20) + "x\n", "longer than 1 MiB"),
    ],
)
def test_read_curves_rejects_broken_tables(tmp_path, text, message):
    (tmp_path / "c.csv").write_text(text)
    with pytest.raises(RigError, match=message):
        read_curves(tmp_path / "c.csv")


def json_of_rest():
    return {
        "schema": "deitalk.curves/1",
        "control_set": CONTROLS.id,
        "fps": 30,
        "names": list(CONTROLS.names),
        "values": [CONTROLS.rest.tolist()],
    }


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": "deitalk.curves/9"}, "schema is 'deitalk.curves/9'; this reads"),
        ({"control_set": "arkit-61"}, "in arkit-61"),
        ({"fps": "fast"}, "'fps' is a str"),
        ({"fps": True}, "'fps' is a bool"),
        ({"fps": 0}, "a face has 1 to 300"),
        ({"names": 7}, "'names' is a int"),
        ({"names": [7] * 185}, "must be text"),
        ({"names": list(CONTROLS.names[1:])}, "lacks 1 of the 185"),
        ({"values": [[0.0]]}, r"it must be \(frames, 185\)"),
        ({"values": [[0.0], [0.0, 1.0]]}, "rows of numbers of one length"),
        ({"values": "all of them"}, "'values' is a str"),
        ({"n_frames": 7}, "'n_frames' is 7 and there are 1 rows"),
        (
            {"emotion": [[0, 0, 0, 0, 0]], "emotion_names": ["joy"]},
            "'emotion_names' must be neutral",
        ),
        ({"intensity": [1, 2]}, r"intensity has shape \(2,\)"),
    ],
)
def test_read_curves_rejects_invalid_json_fields(tmp_path, change, message):
    (tmp_path / "c.json").write_text(json.dumps(json_of_rest() | change))
    with pytest.raises(RigError, match=message):
        read_curves(tmp_path / "c.json")


def test_curves_of_before_the_moods_are_read(tmp_path):
    old = {"emotion": [[0, 0, 1, 0, 0]], "emotion_names": list(EMOTIONS)}
    (tmp_path / "c.json").write_text(json.dumps(json_of_rest() | old))
    assert read_curves(tmp_path / "c.json").emotion.tolist() == [[0, 0, 1, 0, 0, 0, 0, 0, 0]]


def test_archives_never_unpickle(tmp_path):
    np.savez(tmp_path / "c.npz", names=np.array([{"a": 1}], dtype=object))
    with pytest.raises(FormatError, match="no archive of numpy arrays"):
        read_curves(tmp_path / "c.npz")


@pytest.mark.parametrize("suffix", SCENES)
def test_damaged_scene_is_read_or_rejected_in_one_line(suffix, tmp_path, rng):
    path = tmp_path / f"c{suffix}"
    damaged = [b"", *(rng.bytes(400) for _ in range(20))]
    if suffix != ".fbx":  # needs Blender
        write_curves(path, rest_curves(2))
        whole = path.read_bytes()
        heads = [*rng.integers(0, 400, 6), *rng.integers(0, len(whole), 6)]
        damaged += [whole[:at] + rng.bytes(1) + whole[at + 1 :] for at in heads]
        damaged += [whole[:at] for at in heads[::4]]
    for data in damaged:
        path.write_bytes(data)
        try:
            assert np.isfinite(read_curves(path, fps=30).values).all()
        except RigError as error:
            assert str(error) and "\n" not in str(error)


@pytest.mark.parametrize("name", ["absent", "absent.csv", "absent.wav", "folder", "folder.csv"])
@pytest.mark.parametrize("read", [read_curves, read_named])
def test_what_is_no_file_is_said_before_its_suffix(tmp_path, read, name):
    kind, _, suffix = name.partition(".")
    (tmp_path / f"folder{suffix and '.'}{suffix}").mkdir()
    said = {"absent": "does not exist", "folder": "is a folder, not a file"}[kind]
    with pytest.raises(FormatError, match=said):
        read(tmp_path / name)


def test_write_rejects_impossible_paths(tmp_path):
    with pytest.raises(FormatError, match=r"no format has the suffix '.abc'; known: .csv"):
        write_curves(tmp_path / "c.abc", rest_curves(1))
    for name in (f"c{end}" for known in TABLE if known.write is None for end in known.suffixes):
        with pytest.raises(FormatError, match=r"is only read; known: \.csv"):  # not as json or txt
            write_curves(tmp_path / name, rest_curves(1))
    with pytest.raises(FormatError, match="unknown format 'abc'; known: csv"):
        write_curves(tmp_path / "c.csv", rest_curves(1), format="abc")
    with pytest.raises(FormatError, match="cannot write"):
        write_curves(tmp_path / "no" / "folder" / "c.csv", rest_curves(1))
    with pytest.raises(FormatError, match="no frames"):
        write_curves(tmp_path / "c.csv", rest_curves(0))


@pytest.mark.parametrize("suffix", FORMATS)
def test_failed_writer_leaves_the_old_file_only(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"c.{suffix}"
    write_curves(path, rest_curves(1))
    before = path.read_bytes()

    def full_disk(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("rig.formats.curves_csv.rows", full_disk)
    monkeypatch.setattr("rig.formats.curves_json.rows", full_disk)
    monkeypatch.setattr("numpy.savez_compressed", full_disk)
    with pytest.raises(TargetError, match=r"c\.\w+: no space left on the disk; free some"):
        write_curves(path, rest_curves(2))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_own_control_sets_survive_every_format(tmp_path):
    puppet = ControlSet.from_names(["jaw", "lips"], id="puppet@1")
    curves = RigCurves([[0.5, 0.25], [0.0, 1.0]], puppet.names, 25, control_set=puppet.id)
    for suffix in FORMATS:
        write_curves(tmp_path / f"c.{suffix}", curves)
        back = read_curves(tmp_path / f"c.{suffix}", controls=puppet)
        assert (back.values == curves.values).all() and back.fps == 25
        with pytest.raises(RigError):
            read_curves(tmp_path / f"c.{suffix}")


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [f.suffixes[0] for f in TABLE if f.write])
def test_an_hour_is_written_in_seconds(tmp_path, rng, suffix):
    import time

    if suffix == ".fbx":
        pytest.importorskip("bpy", reason="needs bpy")
    values = rng.uniform(CONTROLS.minimum, CONTROLS.maximum, (108_000, 185)).astype(np.float32)
    curves = RigCurves(values, CONTROLS.names)
    start = time.process_time()
    write_curves(tmp_path / f"c{suffix}", curves)
    fitted = suffix in (".anim", ".vrma")  # cubic keys; two sets of an avatar's shapes
    assert time.process_time() - start <= (40 if fitted else 10)
    assert (tmp_path / f"c{suffix}").stat().st_size > 108_000  # a byte a frame at least
