"""The usual voice of an actor, and its effect on the intensity."""

import json
from dataclasses import replace

import numpy as np
import pytest
import soundfile as sf
from pytest import approx
from typer.testing import CliRunner

from deitalk import animate
from deitalk.acting import Acting
from deitalk.audio.load import load_audio
from deitalk.cli import app
from deitalk.emotions import ActorReference, read_actor
from deitalk.emotions.tracks import TRAITS
from deitalk.errors import AudioError, EmotionError
from deitalk.models.load import load_network
from deitalk.pipeline.speech import Speech, measure_actor, measure_intensities
from tests.deitalk.audio.test_prosody import voice
from tests.each import each
from tests.errors import one_line

SOFT, USUAL, STRONG = voice(110, 1.6), voice(140, 1.2), voice(220, 0.8)


@pytest.fixture
def recordings(tmp_path):
    for name, sound in (("soft", SOFT), ("usual", USUAL), ("strong", STRONG)):
        sf.write(tmp_path / f"{name}.wav", sound, 16_000)
    sf.write(tmp_path / "silence.wav", np.zeros(16_000), 16_000)
    return tmp_path


def test_usual_strength_is_the_median_and_silence_does_not_count(recordings):
    actor = measure_actor(sorted(recordings.glob("*.wav")))
    strengths = sorted(
        Speech.of(load_audio(recordings / f"{n}.wav").waveform).strength
        for n in ("soft", "usual", "strong")
    )
    assert actor.strength == approx(strengths[1])
    assert (actor.recordings, actor.seconds) == (3, approx(9))
    with pytest.raises(AudioError, match="no voice"):
        measure_actor([recordings / "silence.wav"])


def test_usual_takes_count_as_usual_in_a_network_with_a_readout_and_in_one_without(recordings):
    """The take that an actor is measured on is 0 deviations from the usual one, by either."""
    sound = Speech.of_recording(load_audio(recordings / "usual.wav"))
    weights = np.eye(1, 5).repeat(sound.n_frames, axis=0).astype(np.float32)
    for model in ("default", "mel"):
        actor = measure_actor([recordings / "usual.wav"], model=model)
        tracks = load_network(model).read(sound.waveform, weights, gain=sound.gain).tracks
        assert (actor.effort is None) == (tracks.effort is None) == (model == "mel")
        assert measure_intensities(sound, tracks, Acting.of(voice=actor)).take == approx(
            0, abs=1e-4
        )
    heard = replace(actor, effort=actor.strength + 5)  # what `mel` does not read it does not use
    assert measure_intensities(sound, tracks, Acting.of(voice=heard)).take == approx(0, abs=1e-4)


def test_traits_are_drawn_from_the_recordings_within_their_ranges(recordings):
    first, again = (measure_actor([recordings / "usual.wav"]) for _ in range(2))
    other = measure_actor([recordings / "soft.wav"])
    assert first.traits == again.traits
    assert first.traits != other.traits
    assert set(first.traits) == set(TRAITS)
    assert all(low <= first.traits[name] <= high for name, (low, high) in TRAITS.items())


@each("effort", [None, -0.25])
def test_reference_file_gives_the_reference_back(tmp_path, effort):
    actor = ActorReference(1.25, 12, 63.5, {"side": -0.1, "blink_interval": 1.2}, effort)
    path = tmp_path / "anna.json"
    path.write_text(actor.as_json())
    assert read_actor(path) == actor
    assert Acting.of(voice=path).voice == actor


PLAIN = {"format": "deitalk-actor", "version": 1, "strength": 0, "recordings": 1, "seconds": 1}


@each(
    "content",
    [
        {},
        [],
        {"format": "deitalk-actor", "version": 2},
        {"format": "deitalk-actor", "version": 1, "strength": "x", "recordings": 1, "seconds": 1},
        {"format": "deitalk-actor", "version": 1, "strength": 1e9, "recordings": 1, "seconds": 1},
        {"format": "deitalk-actor", "version": 1, "recordings": 1, "seconds": 1},
        {**PLAIN, "effort": "x"},
        {**PLAIN, "effort": 1e9},
        {**PLAIN, "traits": {"nose": 1}},
        {**PLAIN, "traits": {"side": 2}},
        {**PLAIN, "traits": {"side": None}},
        {**PLAIN, "traits": [1]},
    ],
)
def test_read_actor_rejects_other_files_in_one_line(tmp_path, content):
    path = tmp_path / "anna.json"
    path.write_text(json.dumps(content))
    with one_line(EmotionError, "anna.json"):
        read_actor(path)
    with pytest.raises(EmotionError, match="give a file or an ActorReference"):
        Acting.of(voice=3)


def test_intensity_counts_from_the_actor_s_usual_voice():
    strong = Speech.of(STRONG).strength
    plain, of_strong, of_soft = (
        animate(STRONG, "angry", sample_rate=16_000, voice=actor, life="off").mean_intensity
        for actor in (None, ActorReference(strong, 1, 3.0), ActorReference(strong - 10, 1, 3.0))
    )
    assert of_strong < plain or strong < 0
    assert of_soft > of_strong + 0.1


def test_commands_build_and_use_a_reference(recordings):
    out = recordings / "anna.json"
    run = CliRunner().invoke
    built = run(app, ["data", "voice", str(recordings / "strong.wav"), "-o", str(out)])
    assert built.exit_code == 0 and "1 recordings" in built.output
    again = run(app, ["data", "voice", str(recordings / "strong.wav"), "-o", str(out)])
    assert again.exit_code == 1
    take = recordings / "take"
    sound = str(recordings / "strong.wav")
    done = run(app, ["animate", sound, "-e", "angry", "--voice", str(out), "-o", f"{take}/"])
    assert done.exit_code == 0, done.output
    assert (
        json.loads((take / "take.json").read_text())["settings"]["voice"] == read_actor(out).content
    )
    assert run(app, ["data", "voice", sound, "-o", "x.wav"]).exit_code == 1
