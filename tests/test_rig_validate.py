import json

import numpy as np
import pytest

from rig import RigCurves, default_controls, rest_curves, write_curves
from rig.arkit import arkit_controls
from rig.errors import FormatError
from rig.formats.livelink_csv import LiveLinkTake, frame_ticks, write_take
from rig.validate import validate

BOARD = default_controls()


def texts(path, level):
    return [finding.text for finding in validate(path).findings if finding.level == level]


def talking(n_frames=90):
    values = np.tile(BOARD.rest, (n_frames, 1))
    wave = np.sin(np.linspace(0, np.pi, n_frames)) ** 2
    values[:, BOARD.index("CTRL_C_jaw.ty")] = 0.6 * wave
    return RigCurves(values, BOARD.names)


@pytest.mark.parametrize("suffix", ["csv", "json", "npz", "raw.csv", "rigmapper.csv", "tsv"])
def test_what_we_write_is_found_good(tmp_path, suffix):
    write_curves(tmp_path / f"c.{suffix}", talking())
    validation = validate(tmp_path / f"c.{suffix}")
    assert validation.ok
    assert not texts(tmp_path / f"c.{suffix}", "warning")
    assert "3.00 s" in validation.findings[0].text


def test_our_live_link_take_is_found_good(tmp_path):
    write_curves(tmp_path / "Slate_1_anna.csv", talking(), format="livelink")
    validation = validate(tmp_path / "Slate_1_anna.csv")
    assert validation.ok and not texts(tmp_path / "Slate_1_anna.csv", "warning")
    assert "Unreal makes the Live Link subject 'anna'" in texts(
        tmp_path / "Slate_1_anna.csv", "note"
    )


def test_real_take_is_read_as_the_importer_would(shared):
    path = shared / "data/curves/livelink/alex_rom_3.csv"
    assert validate(path).ok
    warnings = " ".join(texts(path, "warning"))
    assert "the time code starts late" in warnings
    assert "3 gaps in the time codes" in warnings
    assert "Unreal makes the Live Link subject '3'" not in texts(path, "note")


def take(ticks, **values):
    table = np.zeros((len(ticks), 61))
    for name, value in values.items():
        table[:, arkit_controls().index(name)] = value
    return LiveLinkTake(np.asarray(ticks), table, arkit_controls().names)


def test_frames_counted_instead_of_sixtieths_are_found(tmp_path):
    frames = np.arange(150)
    ticks = frames // 30 * 60_000 + frames % 30 * 1000
    write_take(tmp_path / "S_1_a.csv", take(ticks))
    (error,) = texts(tmp_path / "S_1_a.csv", "error")
    assert "FF never passes 29" in error
    write_take(tmp_path / "S_1_a.csv", take(frame_ticks(150, 30)))
    assert validate(tmp_path / "S_1_a.csv").ok


def test_names_values_and_open_mouths_are_found(tmp_path):
    write_take(tmp_path / "mine.csv", take(frame_ticks(5, 30), JawOpen=1.2))
    warnings = " ".join(texts(tmp_path / "mine.csv", "warning"))
    assert "the importer finds no subject" in warnings
    assert "5 values are outside 0 to 1, by 0.2 at most" in warnings
    assert "ends with the mouth open (JawOpen 1.20)" in warnings


def test_raw_curves_that_forget_the_wrinkles_are_found(tmp_path):
    write_curves(tmp_path / "c.raw.csv", rest_curves(3))
    text = (tmp_path / "c.raw.csv").read_text().splitlines()
    column = text[0].split(",").index("CTRL_expressions_noseWrinkleUpperL")
    rows = [line.split(",") for line in text]
    for row in rows[1:]:
        row[column] = "0"
    (tmp_path / "c.raw.csv").write_text("\n".join(",".join(row) for row in rows))
    assert (
        "noseWrinkleUpperL falls to 0; it rests at 1"
        in texts(tmp_path / "c.raw.csv", "warning")[-1]
    )


def test_jumps_and_dead_curves_are_found(tmp_path):
    values = rest_curves(4).values.copy()
    values[2, BOARD.index("CTRL_C_jaw.ty")] = 0.9
    write_curves(tmp_path / "c.csv", RigCurves(values, BOARD.names))
    assert "CTRL_C_jaw.ty jumps by 90% of its range at frame 2" in texts(
        tmp_path / "c.csv", "warning"
    )
    assert "184 of 185 curves never move" in " ".join(texts(tmp_path / "c.csv", "note"))
    write_curves(tmp_path / "c.csv", rest_curves(4))
    assert "no curve moves at all" in texts(tmp_path / "c.csv", "warning")


@pytest.mark.parametrize(
    ("name", "text"), [("c.csv", "a,b\n1,2\n"), ("c.json", "{}"), ("c.npz", "x"), ("c.xyz", "x")]
)
def test_files_that_cannot_be_read_are_errors(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    assert not validate(tmp_path / name).ok


def test_take_folder_is_checked_file_by_file(tmp_path):
    write_curves(tmp_path / "curves.csv", talking())
    write_curves(tmp_path / "curves.json", talking())
    write_curves(tmp_path / "Slate_1_a.csv", talking(), format="livelink")
    (tmp_path / "intensity.csv").write_text("time,predicted\n0,0\n")
    (tmp_path / "take.json").write_text(json.dumps({"files": {"curves.csv": "", "audio.wav": ""}}))
    assert texts(tmp_path, "error") == ["lists audio.wav, which is not in the folder"]
    (tmp_path / "audio.wav").write_bytes(b"")
    assert validate(tmp_path).ok and not texts(tmp_path, "warning")
    write_curves(tmp_path / "curves.json", talking(60))
    assert "files differ in length" in texts(tmp_path, "warning")[0]


def test_empty_folder_and_absent_path(tmp_path):
    assert not validate(tmp_path).ok
    with pytest.raises(FormatError, match="does not exist"):
        validate(tmp_path / "absent")
