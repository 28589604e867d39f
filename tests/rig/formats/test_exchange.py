import json

from deitalk.pipeline.exchange_files import write_exchange_files
from rig import rest_curves
from rig.formats.livelink_csv import read_take
from rig.unreal.deitalk_clip import subject_of
from rig.validation.files import validate


def test_both_files_are_written_and_described(tmp_path):
    files = write_exchange_files(tmp_path, rest_curves(30), slate="my speech_1.wav")
    assert set(files) == {"my-speech-1-wav_take_1_deitalk.csv", "my-speech-1-wav.unreal.json"}
    assert {path.name for path in tmp_path.iterdir()} == set(files)
    take = tmp_path / "my-speech-1-wav_take_1_deitalk.csv"
    assert subject_of(take.name) == "deitalk" and len(read_take(take).ticks) == 30
    assert validate(take).ok and "lossy preview" in files[take.name]
    data = json.loads((tmp_path / "my-speech-1-wav.unreal.json").read_text())
    assert data["n_frames"] == 30


def test_a_name_without_letters(tmp_path):
    assert "take_take_1_deitalk.csv" in write_exchange_files(tmp_path, rest_curves(1), slate="…")
