"""A dialogue as two takes that listen to each other: by channel, by track, by named subtitles."""

import json
from pathlib import Path

import numpy as np
import pytest
import soundfile

from deitalk.audio.load import load_audio
from rig import read_curves
from tests.command import ran
from tests.media import movie

SAMPLES = Path(__file__).parents[3] / "docs" / "samples"
RATE, SECONDS = 16_000, 9.0
ANNA, BOB = (0.5, 4.5), (5.0, 8.5)
"""When each speaks."""
SUBTITLES = (
    "1\n00:00:00,500 --> 00:00:04,500\nANNA: Maybe you believe me. But mother, Bob promised\n\n"
    "2\n00:00:05,000 --> 00:00:08,500\nBOB: [nods] Fine.\n"
)
WAYS = {
    "channels": ("scene.wav", {"anna": ["--channel", "left"], "bob": ["--channel", "2"]}),
    "tracks": ("scene.mka", {"anna": ["--track", "1"], "bob": ["--track", "2"]}),
    "subtitles": (
        "mixed.wav",
        {name: ["--script", "scene.srt", "--speaker", name] for name in ("anna", "bob")},
    ),
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Two people who speak one after the other, in each form of a recording."""
    folder = tmp_path_factory.mktemp("scene")
    voices = np.zeros((round(SECONDS * RATE), 2), np.float32)
    for k, (name, (start, stop)) in enumerate((("promise", ANNA), ("amiable", BOB))):
        part = load_audio(SAMPLES / f"{name}.flac").waveform[: round((stop - start) * RATE)]
        voices[round(start * RATE) :][: len(part), k] = part
    soundfile.write(folder / "scene.wav", voices, RATE)
    soundfile.write(folder / "mixed.wav", voices.sum(axis=1), RATE)
    (folder / "scene.mka").write_bytes(movie("matroska", [*voices.T], RATE, codec="pcm_s16le"))
    (folder / "scene.srt").write_text(SUBTITLES)
    return folder


@pytest.mark.parametrize("way", WAYS)
def test_two_takes_of_a_dialogue_listen_to_each_other(scene, way, tmp_path, monkeypatch):
    """Each is silent while the other speaks, keeps only its own voice, and nods at the other's."""
    monkeypatch.chdir(scene)
    recording, choices = WAYS[way]
    anna, bob = tmp_path / "anna", tmp_path / "bob"
    ran("animate", recording, *choices["anna"], "-o", f"{anna}/")
    alone = read_curves(anna / "curves.json")
    ran("animate", recording, *choices["bob"], "--listen-to", anna / "audio.wav", "-o", f"{bob}/")
    ran("animate", recording, *choices["anna"], "--listen-to", bob / "audio.wav", "-o", f"{anna}/",
        "--force")  # fmt: skip
    for folder, own, others in ((anna, ANNA, BOB), (bob, BOB, ANNA)):
        curves = read_curves(folder / "curves.json")
        assert len(curves) == round(SECONDS * 30)
        speaks, listens = (slice(round(30 * a + 6), round(30 * b - 6)) for a, b in (own, others))
        jaw = curves["CTRL_C_jaw.ty"]
        assert jaw[speaks].std() > 0.05 and jaw[listens].std() < 0.02
        sound, _ = soundfile.read(folder / "audio.wav")
        level = [np.abs(sound[round(a * RATE) : round(b * RATE)]).mean() for a, b in (own, others)]
        assert level[0] > 30 * level[1]
        settings = json.loads((folder / "take.json").read_text())["settings"]
        start, stop, _ = settings["listen_to"]["phrases"][0]
        assert others[0] - 0.1 <= start < stop <= others[1] + 0.1
    now = read_curves(anna / "curves.json")
    turned = np.abs(now.head - alone.head).max(axis=1)
    assert turned[: round(30 * BOB[0])].max() < 0.2 < turned[round(30 * BOB[0]) :].max()
