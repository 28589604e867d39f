"""Performances: saved by the name of the target, one line when printed, means of their tracks."""

import json
from dataclasses import replace

import numpy as np
import pytest
import soundfile

from deitalk import animate, animate_mesh
from deitalk.audio.voice_activity import speech_activity
from deitalk.emotions import EmotionTrack, IntensityCurve
from deitalk.errors import AudioError, CheckpointError, ConfigError, DeitalkError, EmotionError
from rig import read_curves
from rig.errors import ExistsError, TargetError
from tests.deitalk.pipeline.test_curves import network, recording
from tests.errors import one_line

__all__ = ["network"]


@pytest.fixture(scope="module")
def happy(network):
    return animate(recording(1.5), "happy", model=network, intensity=1.5)


@pytest.mark.parametrize("name", ["take", "take.v2/", "Scene 1.2", "Scene 1.a b", "x.animation12"])
def test_save_writes_a_take_where_the_name_is_a_folder(tmp_path, happy, name):
    saved = happy.save(f"{tmp_path}/{name}")
    about = json.loads((saved / "take.json").read_text())
    assert saved == tmp_path / name.rstrip("/")
    assert about["settings"] == {"emotion": "happy", "intensity": 1.5}
    assert about["model"]["control_set"] == "metahuman-185@mh4"


@pytest.mark.parametrize("name", ["c.csv", "c.JSON", "Scene 1.2.npz", "a.v2.unreal.json"])
def test_save_writes_one_file_by_its_suffix(tmp_path, happy, name):
    saved = happy.save(tmp_path / name, fps=60)
    assert saved.is_file()
    if "unreal" not in name:
        read = read_curves(saved)
        assert (len(read), read.fps) == (90, 60)


def test_save_replaces_only_by_force(tmp_path, happy):
    happy.save(tmp_path / "c.csv")
    with pytest.raises(ExistsError, match=r"c\.csv exists"):
        happy.save(tmp_path / "c.csv")
    happy.save(tmp_path / "c.csv", force=True)


def test_save_names_the_model_it_was_given(tmp_path, happy):
    named = replace(happy, model="live")
    about = json.loads((named.save(tmp_path / "take") / "take.json").read_text())
    assert about["model"]["name"] == "live" and len(about["model"]["sha256"]) == 64


def test_mean_intensities_are_of_predicted_and_applied(network):
    sound = recording(1.5)
    plain = animate(sound, "happy", model=network)
    doubled = animate(sound, "happy", model=network, intensity=2)
    none = animate(sound, "happy", model=network, intensity_curve=still(0.0))
    neutral = animate(sound, "neutral", model=network)
    assert plain.mean_applied_intensity == pytest.approx(plain.mean_intensity)
    assert doubled.mean_intensity == pytest.approx(plain.mean_intensity)
    assert doubled.mean_applied_intensity == pytest.approx(2 * plain.mean_intensity)
    assert none.mean_applied_intensity == 0 and none.mean_intensity > 0.1
    assert neutral.mean_applied_intensity == 0 and not neutral.has_emotion


def test_mean_intensity_is_of_speech_alone(happy):
    """.8 in speech and 0 in two seconds of silence after it is .8."""
    quiet = np.concatenate((happy.recording.waveform, np.zeros(32_000, np.float32)))
    track = np.zeros(len(speech_activity(quiet)), np.float32)
    track[speech_activity(quiet) > 0] = 0.8
    longer = replace(happy.recording, waveform=quiet)
    assert replace(happy, recording=longer, predicted=track).mean_intensity == pytest.approx(0.8)
    assert track.mean() < 0.6


def test_keys_outside_the_recording_are_refused_or_noted(network):
    track = EmotionTrack(np.array([0.0, 9.5]), np.eye(5)[[0, 2]])
    late = animate(recording(1.5), track, model=network)
    assert "emotion has keys until 9.5 s, the recording lasts 1.5 s" in late.recording.warnings[-1]
    with one_line(EmotionError, match="before the recording"):
        animate(recording(1.5), '[{"time": -1, "emotion": "happy", "strength": 1}]', model=network)


def still(value):
    return IntensityCurve(np.zeros(1), np.full(1, value))


@pytest.mark.parametrize(
    ("name", "files"), [("m.glb", None), ("m.npz", None), ("m.v2/", 6), ("frames", 6)]
)
def test_mesh_performance_saves_by_the_same_rule(tmp_path, network, name, files):
    performance = animate_mesh(recording(0.2), model=network)
    saved = performance.save(f"{tmp_path}/{name}")
    assert saved.is_file() if files is None else len(list(saved.glob("*.ply"))) == files
    with pytest.raises(TargetError):
        performance.save(f"{tmp_path}/{name}")
    with pytest.raises(TargetError, match=r"\.glb, \.npz"):
        performance.save(tmp_path / "m.fbx")


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"emotion": 3}, EmotionError, "emotion 3 is a int"),
        ({"emotion": ["happy"]}, EmotionError, "is a list"),
        ({"emotion": b"happy"}, EmotionError, "is a bytes"),
        ({"emotion": {1: 0.5}}, EmotionError, "unknown emotion 1"),
        ({"emotion": {"happy": None}}, EmotionError, "happy is None"),
        ({"emotion": "furious"}, EmotionError, "angry"),
        ({"emotion": "happy=0.9,sad=0.4"}, EmotionError, "1"),
        ({"intensity": -1}, ConfigError, "0"),
        ({"intensity": "loud"}, ConfigError, "intensity 'loud' must be a number"),
        ({"intensity": [1]}, ConfigError, "must be a number"),
        ({"intensity": True}, ConfigError, "must be a number"),
        ({"intensity": float("nan")}, ConfigError, "intensity nan must be a number, 0 to 4"),
        ({"intensity_curve": 1.0}, EmotionError, "intensity_curve 1.0 is a float"),
        ({"intensity_curve": [1, 2]}, EmotionError, "is a list"),
        ({"idle": False}, ConfigError, "no argument 'idle'"),
        ({"loudness": 1}, ConfigError, "no argument 'loudness'; known are emotion, acting"),
        ({"seed": -1}, DeitalkError, "seed -1"),
        ({"seed": 1.5}, DeitalkError, "seed 1.5"),
        ({"seed": 2**70}, DeitalkError, "seed 1180591620717411303424"),
        ({"model": 12}, CheckpointError, "model 12 is a int"),
        ({"model": None}, CheckpointError, "is a NoneType"),
        ({"progress": None}, DeitalkError, "progress None must be a function"),
        ({"audio": 12}, AudioError, "a int is no recording"),
        ({"audio": None}, AudioError, "a NoneType is no recording"),
        ({"audio": [0.0, 1.0]}, AudioError, "a list is no recording"),
        ({"audio": "nul\0.wav"}, AudioError, "nul"),
        ({"sample_rate": 48_000}, AudioError, "belongs to an array"),
    ],
)
@pytest.mark.parametrize("function", [animate, animate_mesh])
def test_arguments_reject_other_types(network, function, arguments, error, message):
    given = {"audio": recording(0.2), "emotion": "happy", "model": network} | arguments
    with one_line(error, message):
        function(**given)


def test_settings_hold_what_files_held(network):
    """Text that gives the same acting again, wherever the files are now."""
    sound = recording(0.2)
    mixed = animate(sound, {"happy": 0.7, "sad": 0.1}, model=network, intensity_curve=still(1.0))
    assert mixed.acting.settings == {
        "emotion": "happy=0.7,sad=0.1", "intensity_curve": "time,intensity\n0,1\n"
    }  # fmt: skip
    track = EmotionTrack(np.array([0.0, 0.1]), np.eye(5)[:2])
    acted = animate(sound, track, model=network)
    assert "emotion a track of 2 keys" in repr(acted)
    assert animate(sound, model=network, **acted.acting.settings).acting == acted.acting


def test_recordings_with_names_that_are_no_utf8_are_read(tmp_path, network):
    path = tmp_path / "\udcff.wav"
    soundfile.write(tmp_path / "a.wav", recording(0.5).waveform, 16_000)
    try:
        (tmp_path / "a.wav").rename(path)
    except (OSError, UnicodeError):
        pytest.skip("this system has no such file names")
    performance = animate(path, "happy", model=network)
    saved = performance.save(tmp_path / "take\udcfe")
    about = json.loads((saved / "take.json").read_text(encoding="utf-8"))
    assert about["source"]["name"].endswith(r"\xff.wav")
    assert len(read_curves(saved / "curves.csv")) == 15


def test_speech_of_a_recording_is_sought_once(network, tmp_path, monkeypatch):
    """From the reading of the file to the mean intensity, whatever is noted in between."""
    sought = []

    def seek(waveform):
        sought.append(len(waveform))
        return speech_activity(waveform)

    monkeypatch.setattr("deitalk.audio.load.speech_activity", seek)
    soundfile.write(tmp_path / "a.wav", recording(1.5).waveform, 16_000)
    late = IntensityCurve(np.array([0.0, 9.0]), np.ones(2))
    made = animate(tmp_path / "a.wav", "happy", model=network, intensity_curve=late)
    assert made.mean_intensity > 0 and "keys until 9.0 s" in made.recording.warnings[-1]
    assert sought == [24_000]
