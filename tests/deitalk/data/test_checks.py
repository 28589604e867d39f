"""`deitalk data check`: a good dataset passes; every inserted fault is reported."""

import json
from pathlib import Path

import numpy as np
import pytest
import soundfile
from typer.testing import CliRunner

from deitalk.cli.data import app
from deitalk.data.checks import inspect_dataset
from deitalk.errors import DataError
from rig import RigCurves, default_controls, read_curves, write_curves
from tests.dataset import JAW, RATE, spoil, write_dataset

CONTROLS = default_controls()


@pytest.fixture
def folder(tmp_path) -> Path:
    return write_dataset(tmp_path, n_train=5, n_validation=2)


def checks(folder: Path, **options: int) -> dict[str, tuple[str, str]]:
    return {c.name: (c.level, c.text) for c in inspect_dataset(folder, **options).checks}


def rewrite(folder: Path, i: int, change, fps: float | None = None) -> None:
    path = folder / f"curves/{i}.npz"
    curves = read_curves(path)
    values = change(curves.values.copy())
    write_curves(path, RigCurves(values, curves.names[: values.shape[1]], fps=fps or curves.fps))


def test_good_dataset_has_no_errors_and_its_offset_is_0(folder):
    found = checks(folder)
    assert not [name for name, (level, _) in found.items() if level == "error"]
    assert found["files"] == ("ok", "7 clips can be read")
    assert found["controls"][0] == found["lengths"][0] == found["speech"][0] == "ok"
    assert found["speakers"] == ("ok", "7, each in one split")
    assert found["emotions"][0] == "ok" and "happy 20%" in found["emotions"][1]
    assert found["frame rates"][1] == "7 at 60 Hz"
    lag = int(found["offset"][1].split("ms")[0].split()[-1])
    assert found["offset"][0] == "ok" and abs(lag) <= 17
    assert found["splits"][0] == "warning" and "no test clips" in found["splits"][1]
    assert found["movement"][0] == "warning" and "lip controls never move" in found["movement"][1]


@pytest.mark.parametrize("frames", [12, -9])
def test_curves_that_are_late_or_early_are_measured_in_milliseconds(folder, frames):
    for i in range(7):
        rewrite(folder, i, lambda v: np.roll(v, frames, axis=0))
    level, text = checks(folder)["offset"]
    expected = round(frames / 60 * 1000)
    lag = int(text.split("ms")[0].split()[-1])
    assert level == "warning" and abs(lag - expected) <= 17 and "offset_s" in text
    for i in range(7):
        spoil(folder, "offset_s", str(-frames / 60), i)
    assert checks(folder)["offset"][0] == "ok", "and offset_s mends it"


def test_speaker_in_two_splits_is_an_error(folder):
    spoil(folder, "speaker", "test:0", 6)
    assert checks(folder)["speakers"] == (
        "error",
        "1 in several splits: test:0 (train, validation)",
    )


def test_missing_controls_are_an_error(folder):
    short = CONTROLS.names[:-2]
    curves = read_curves(folder / "curves/2.npz")
    write_curves(folder / "curves/2.npz", RigCurves(curves.values[:, :-2], short, fps=60))
    found = checks(folder)
    assert "error" in (found["controls"][0], found["files"][0])
    assert "clip2" in found["controls"][1] + found["files"][1]


def test_unreadable_file_is_an_error_and_the_rest_is_checked(folder):
    (folder / "audio/1.flac").write_bytes(b"no sound")
    (folder / "phones/4.csv").write_text("start,end\n0,1\n")
    level, text = checks(folder)["files"]
    assert level == "error" and text.startswith("2 unreadable: clip1 (") and "clip4 (" in text
    assert checks(folder)["frame rates"][1] == "5 at 60 Hz"


def test_lengths_rates_silence_speech_and_clipping_are_warned_of(folder):
    rewrite(folder, 0, lambda v: v[:-60])
    rewrite(folder, 1, lambda v: v, fps=50.0)
    soundfile.write(folder / "audio/2.flac", np.zeros(3 * RATE, np.float32), RATE)
    sound = soundfile.read(folder / "audio/3.flac", dtype="float32")[0]
    soundfile.write(folder / "audio/3.flac", np.clip(sound * 50, -1, 1), RATE)
    soundfile.write(folder / "audio/4.flac", sound[::2], RATE // 2)
    found = checks(folder)
    assert found["lengths"][0] == "warning" and "clip0 (-1.00 s)" in found["lengths"][1]
    assert "clip1 (+0.60 s)" in found["lengths"][1]
    assert found["frame rates"][1] == "1 at 50 Hz, 6 at 60 Hz"
    assert found["speech"] == ("warning", "1 clips hold none: clip2")
    assert found["clipping"][0] == "warning" and "clip3" in found["clipping"][1]
    assert found["sample rates"] == ("warning", "1 below 16 kHz: clip4 (8000 Hz)")


def test_mouth_that_stays_open_and_values_out_of_range_are_warned_of(folder):
    jaw = CONTROLS.index(JAW)

    def gape(values: np.ndarray) -> np.ndarray:
        values[:, jaw] = 0.5 + 0.5 * values[:, jaw]
        return values

    rewrite(folder, 5, gape)
    found = checks(folder)
    assert found["silence"][0] == "warning" and "clip5" in found["silence"][1]

    with np.load(folder / "curves/6.npz") as stored:
        arrays = dict(stored)
    arrays["values"][5, jaw] = 1.8
    np.savez(folder / "curves/6.npz", **arrays)
    level, text = checks(folder)["files"]
    assert level == "error" and text.startswith("1 unreadable: clip6 (") and "1.8" in text


def test_command_prints_a_table_or_json_and_fails_on_errors(folder):
    runner = CliRunner()
    good = runner.invoke(app, ["check", str(folder)])
    assert good.exit_code == 0
    lines = good.stdout.splitlines()
    assert lines[0].split()[:2] == ["ok", "files"] and len(lines) == 13
    spoil(folder, "speaker", "test:0", 6)
    bad = runner.invoke(app, ["check", str(folder), "--json"])
    assert bad.exit_code == 1
    rows = json.loads(bad.stdout)
    assert {"check": "speakers", "level": "error"}.items() <= rows[2].items()


def test_check_rejects_a_folder_that_is_no_dataset(tmp_path):
    with pytest.raises(DataError, match=r"holds no clips\.csv"):
        inspect_dataset(tmp_path)


def two_splits(folder: Path, gap: float) -> None:
    for row, split in ((0, "train"), (1, "test")):
        start = row * (3 + gap)
        values = {"speaker": "anna", "split": split, "take": "t1", "start_s": start,
                  "stop_s": start + 3}  # fmt: skip
        for column, value in values.items():
            spoil(folder, column, str(value), row)


def test_neighbours_of_one_speaker_in_two_splits_are_an_error(folder):
    two_splits(folder, gap=1.0)
    assert checks(folder)["speakers"][0] == "error"
