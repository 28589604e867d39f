import json
from dataclasses import replace

import numpy as np
import pytest

from rig import RigCurves, default_controls, rest_curves, write_curves
from rig.conversion.arkit import arkit_controls
from rig.errors import FormatError
from rig.formats.livelink_csv import LiveLinkTake, frame_ticks, write_take
from rig.validation.files import validate
from tests.unreal_live_link import import_csv

BOARD = default_controls()


def texts(path, level):
    return [finding.text for finding in validate(path).findings if finding.level == level]


def talking(n_frames=90):
    values = np.tile(BOARD.rest, (n_frames, 1))
    wave = np.sin(np.linspace(0, np.pi, n_frames)) ** 2
    values[:, BOARD.index("CTRL_C_jaw.ty")] = 0.6 * wave
    return RigCurves(values, BOARD.names)


def test_our_live_link_take_is_valid(tmp_path):
    write_curves(tmp_path / "Slate_take_1_anna.csv", talking(), format="livelink")
    validation = validate(tmp_path / "Slate_take_1_anna.csv")
    assert validation.ok and not texts(tmp_path / "Slate_take_1_anna.csv", "warning")
    assert "Unreal makes the Live Link subject 'anna'" in texts(
        tmp_path / "Slate_take_1_anna.csv", "note"
    )


def test_real_take_is_checked_by_the_importers_rules(shared):
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


HEADER = ",".join(["Timecode", "BlendShapeCount", *arkit_controls().names])


def rows_of(n_frames, per_second, zero=",0"):
    return [
        f"00:00:{i // per_second:02}:{i % per_second:02}.000,61{zero * 61}" for i in range(n_frames)
    ]


def test_frames_counted_to_29_are_a_warning_for_older_importers(tmp_path):
    (tmp_path / "S_1_a.csv").write_text("\n".join([HEADER, *rows_of(150, 30)]))
    assert validate(tmp_path / "S_1_a.csv").ok
    text = texts(tmp_path / "S_1_a.csv", "warning")[0]
    assert "read as 30 frames a second" in text and "older importer" in text
    assert "150 frames at 30 fps" in texts(tmp_path / "S_1_a.csv", "note")[0]
    write_take(tmp_path / "S_1_a.csv", take(frame_ticks(150, 30)))
    assert "FF" not in " ".join(texts(tmp_path / "S_1_a.csv", "warning"))


def test_short_file_in_sixtieths_plays_at_half_speed(tmp_path):
    (tmp_path / "S_1_a.csv").write_text("\n".join([HEADER, *rows_of(20, 60)]))
    assert "plays at half speed" in texts(tmp_path / "S_1_a.csv", "warning")[0]
    write_curves(tmp_path / "S_1_a.csv", rest_curves(20, fps=60), format="livelink")
    assert "half speed" not in " ".join(texts(tmp_path / "S_1_a.csv", "warning"))


def spoilt(kind):
    """A take that Unreal refuses, or whose import it ends before the end."""
    lines = [HEADER, *rows_of(100, 60)]
    if kind == "spaces":
        lines[0] = lines[0].replace(",", ", ")
    elif kind == "quotes":
        lines[0] = ",".join(f'"{cell}"' for cell in lines[0].split(","))
    elif kind == "semicolons":
        lines = [line.replace(",", ";") for line in lines]
    elif kind == "short row":
        lines[7] = lines[7][:-4]
    elif kind == "long row":
        lines[7] += ",0"
    elif kind == "empty cell":
        lines[7] = lines[7].replace(",0", ",", 1)
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("spaces", "white space at ' BlendShapeCount'"),
        ("quotes", "quotes in its first line"),
        ("semicolons", "semicolons between its cells; Unreal reads commas"),
        ("short row", "data row 7 has 61 filled cells, the header 63"),
        ("long row", "data row 7 has 64 filled cells, the header 63"),
        ("empty cell", "data row 7 has 62 filled cells, the header 63"),
    ],
)
def test_what_unreal_refuses_is_an_error_of_one_short_line(tmp_path, kind, message):
    path = tmp_path / "S_1_a.csv"
    path.write_text(spoilt("nothing"))
    assert validate(path).ok and len(import_csv(path).times) == 100
    path.write_text(spoilt(kind))
    with pytest.raises(AssertionError):
        import_csv(path)
    (error,) = texts(path, "error")
    assert message in error and len(error) - len(str(path)) < 120


@pytest.mark.parametrize(
    ("name", "note"),
    [
        (
            "Speech_1_anna.csv",
            "'Speech_1_anna', the whole name; Speech_take_1_anna.csv gives 'anna'",
        ),
        ("Speech_take_1_anna.csv", "subject 'anna'"),
        ("mine.csv", "subject 'mine'"),
    ],
)
def test_subject_is_the_one_that_unreal_makes(tmp_path, name, note):
    (tmp_path / name).write_text("\n".join([HEADER, *rows_of(100, 60)]))
    assert texts(tmp_path / name, "note")[1].endswith(note)


def test_values_and_open_mouths_are_found(tmp_path):
    write_take(tmp_path / "mine.csv", take(frame_ticks(50, 30), JawOpen=1.2))
    warnings = " ".join(texts(tmp_path / "mine.csv", "warning"))
    assert "50 values are outside 0 to 1, by 0.2 at most" in warnings
    assert "ends with the mouth open (JawOpen 1.20)" in warnings


def test_raw_curves_with_wrinkles_at_zero_are_found(tmp_path):
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


@pytest.mark.parametrize("n_frames", [1, 2, 17, 18])
def test_take_of_few_frames_is_checked(tmp_path, n_frames):
    names = ["curves.csv", "curves.json", "neutral.npz", "c.anim", "s.unreal.json"]
    names += ["c.glb"] * (n_frames in (1, 18))  # half a second each
    for name in names:
        write_curves(tmp_path / name, talking(n_frames))
    write_curves(tmp_path / "Slate_1_a.csv", talking(n_frames), format="livelink")
    assert not texts(tmp_path, "error")
    (tmp_path / "neutral.npz").write_bytes(b"PK")
    assert len(texts(tmp_path, "error")) == 1


def test_exports_are_checked(tmp_path):
    for suffix in ("unreal.json", "visemes.json"):
        path = tmp_path / f"c.{suffix}"
        write_curves(path, talking())
        assert validate(path).ok and "90 frames" in texts(path, "note")[0]
    cases = {
        "c.unreal.json": [
            ({"n_frames": 0}, "must be 1 to"),
            ({"n_frames": 5}, "has 90 values, not 5"),
            ({"frame_rate": [30, 0]}, "two whole numbers"),
            ({"board": {"CTRL_C_jaw": {"z": 0}}}, "CTRL_C_jaw has no channel 'x'"),
            ({"board": {"CTRL_C_jaw": {"x": 3, "y": 0}}}, "CTRL_C_jaw.tx"),
            ({"board": {"CTRL_C_jaw": {"x": "x", "y": 0}}}, "no list of numbers"),
        ],
        "c.visemes.json": [
            ({"names": 3}, "needs 'names'"),
            ({"values": [[1, 2]]}, "rows of 15 numbers"),
            ({"values": [[1] * 15]}, "data row 1 does not sum to 1"),
        ],
    }
    for name, changes in cases.items():
        good = json.loads((tmp_path / name).read_text())
        for change, message in changes:
            (tmp_path / name).write_text(json.dumps(good | change))
            assert message in texts(tmp_path / name, "error")[0]


def test_glb_is_checked(tmp_path):
    from rig.mesh.glb import write_container

    path = tmp_path / "c.glb"
    primitive = {"attributes": {}, "targets": [{}, {}]}
    document = {
        "asset": {"version": "2.0"},
        "meshes": [{"primitives": [primitive]}],
        "nodes": [{"mesh": 0}],
        "bufferViews": [{"buffer": 0, "byteLength": 8}],
        "accessors": [{"count": 3}, {"count": 6}],
        "animations": [
            {
                "samplers": [{"input": 0, "output": 1}],
                "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}],
            }
        ],
    }
    write_container(path, document, bytes(8))
    assert texts(path, "note")[0] == "glTF 2.0, 2 morph targets, 3 keys of weights"
    document["accessors"][1]["count"] = 5
    write_container(path, document, bytes(8))
    assert "5 weights; 3 keys need 6" in texts(path, "error")[0]
    document["accessors"][1]["count"] = 6
    write_container(path, document, bytes(4))
    assert "bufferView 0 lies outside" in texts(path, "error")[0]
    del document["nodes"]
    write_container(path, document, bytes(8))
    assert "no valid glTF" in texts(path, "error")[0]
    path.write_bytes(b"glTF")
    assert not validate(path).ok


def test_hidden_files_of_a_take_folder_are_no_curves(tmp_path):
    write_curves(tmp_path / "curves.csv", talking())
    (tmp_path / ".deitalk-manifest.json").write_text('{"schema": "deitalk.manifest/1"}')
    assert texts(tmp_path, "error") == []


def test_empty_folder_and_absent_path(tmp_path):
    assert not validate(tmp_path).ok
    with pytest.raises(FormatError, match="does not exist"):
        validate(tmp_path / "absent")


def test_raw_subjects_are_checked_by_the_face_blueprints_of_5_6(tmp_path):
    """Raw curves are recognised by CTRL_expressions_mouthUp; the head needs HeadControlSwitch."""
    head = np.tile(np.array([10, 0, 0, 0, 0, 0], np.float32), (90, 1))
    path = tmp_path / "scene_take_1_anna_cal.csv"
    write_curves(path, replace(talking(), head=head), format="livelink-raw")
    good = path.read_text()
    assert validate(path).ok and not texts(path, "warning")
    path.write_text(good.replace("CTRL_expressions_mouthUp,", "other,"))
    assert any("takes the columns for ARKit shapes" in text for text in texts(path, "warning"))
    path.write_text(good.replace("HeadControlSwitch", "other"))
    assert any("leaves the head still" in text for text in texts(path, "warning"))


def test_take_of_an_own_rig_is_good(tmp_path):
    curves = RigCurves(np.zeros((30, 1), np.float32), ("smile",), control_set="mine@1")
    write_curves(tmp_path / "curves.json", curves)
    write_curves(tmp_path / "curves.csv", curves)
    found = validate(tmp_path)
    assert found.ok and any("of the rig mine@1" in finding.text for finding in found.findings)
