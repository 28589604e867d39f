"""The take folder: complete, readable, written whole or not at all."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import soundfile

from deitalk import animate
from deitalk.audio.original import start_seconds
from deitalk.pipeline.performance import FILES, write_take
from rig import read_curves
from rig.errors import ExistsError, TargetError
from tests.deitalk.pipeline.test_curves import network, recording
from tests.unreal_live_link import import_csv

__all__ = ["network"]


@pytest.fixture(scope="module")
def performance(network):
    return animate(recording(2.5), "happy", model=network)


def write(folder, performance, **options):
    return write_take(folder, performance, model={"name": "test"}, **options)


def test_take_describes_each_of_its_files(tmp_path, performance):
    take = write(tmp_path / "take", performance)
    about = json.loads((take / "take.json").read_text())
    assert {path.name for path in take.iterdir() if path.name[0] != "."} == set(about["files"])
    assert set(FILES) <= set(about["files"])
    assert any(name.endswith("_take_1_deitalk.csv") for name in about["files"])
    assert about["frames"] == 75
    assert about["control_set"] == "metahuman-185@mh4"
    assert about["settings"] == {"emotion": "happy"}


def test_files_of_a_take_agree(tmp_path, performance):
    take = write(tmp_path / "take", performance)
    from_csv, from_json = read_curves(take / "curves.csv"), read_curves(take / "curves.json")
    np.testing.assert_allclose(from_csv.values, performance.curves.values, atol=1e-5)
    np.testing.assert_allclose(from_json.values, from_csv.values, atol=1e-5)
    np.testing.assert_allclose(from_json.intensity, performance.curves.intensity, atol=1e-5)
    table = pd.read_csv(take / "intensity.csv")
    np.testing.assert_allclose(table["time"], np.arange(75) / 30, atol=1e-6)
    np.testing.assert_allclose(table["predicted"], performance.predicted, atol=1e-5)
    sound, rate = soundfile.read(take / "audio.wav")
    assert rate == 16_000
    assert len(sound) == len(performance.recording.waveform)


def test_take_of_a_48_khz_file_has_it_and_one_time_code(tmp_path, performance, rng):
    source = tmp_path / "line.wav"
    soundfile.write(source, rng.uniform(-0.1, 0.1, (100_000, 2)), 48_000)
    known = replace(performance.recording, source=str(source), source_rate=48_000)
    take = write(tmp_path / "take", replace(performance, recording=known), start=3661.5)
    about = json.loads((take / "take.json").read_text())
    assert about["start_seconds"] == 3661.5 and "audio_48k.wav" in about["files"]
    sound, rate = soundfile.read(take / "audio_48k.wav")
    assert rate == 48_000 and sound.shape == (3 * len(known.waveform), 2)
    np.testing.assert_array_equal(sound[:100_000], soundfile.read(source)[0])
    for name in ("audio.wav", "audio_48k.wav"):
        assert start_seconds(take / name) == 3661.5
    there = import_csv(take / "line_take_1_deitalk.csv")
    assert there.times[0] == pytest.approx(3661.5) and there.subject == "deitalk"
    assert json.loads((take / "line.unreal.json").read_text())["start"] == 3661.5
    source.unlink()
    again = write(tmp_path / "again", replace(performance, recording=known))
    assert not (again / "audio_48k.wav").exists()


def test_write_take_replaces_own_files_only_by_force(tmp_path, performance):
    take = write(tmp_path / "take", performance)
    (take / "mine.txt").write_text("notes")
    before = (take / "take.json").read_text()
    with pytest.raises(ExistsError, match="exists"):
        write(take, performance)
    assert (take / "take.json").read_text() == before
    write(take, performance, fps=60, force=True)
    assert (take / "mine.txt").read_text() == "notes"
    assert json.loads((take / "take.json").read_text())["fps"] == 60


def test_write_take_rejects_edited_take(tmp_path, performance):
    take = write(tmp_path / "take", performance)
    (take / "intensity.csv").write_text("edited")
    with pytest.raises(TargetError, match=r"intensity\.csv was changed since"):
        write(take, performance, force=True)
    assert (take / "intensity.csv").read_text() == "edited"


@pytest.mark.parametrize("name", ["a.jpg", "take.json"])
def test_write_take_rejects_foreign_folder(tmp_path, performance, name):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / name).write_bytes(b"x")
    with pytest.raises(TargetError, match="did not write"):
        write(tmp_path / "photos", performance, force=True)
    assert (tmp_path / "photos" / name).read_bytes() == b"x"


def test_write_take_keeps_its_recording(tmp_path, performance):
    """The source may lie in the folder, but not be one of the files that are replaced."""
    take = write(tmp_path / "take", performance)
    source = take / "line.wav"
    source.write_bytes(b"the source")
    named = replace(performance.recording, source=str(source))
    write(take, replace(performance, recording=named), force=True)
    assert source.read_bytes() == b"the source"
    named = replace(performance.recording, source=str(take / "audio.wav"))
    with pytest.raises(TargetError, match="is also an input"):
        write(take, replace(performance, recording=named), force=True)


def test_write_take_on_a_full_disk_leaves_nothing(tmp_path, performance, monkeypatch):
    def full(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("deitalk.pipeline.performance.write_wav", full)
    with pytest.raises(TargetError, match="take: no space left on the disk; free some"):
        write(tmp_path / "take", performance)
    assert list(tmp_path.iterdir()) == []
