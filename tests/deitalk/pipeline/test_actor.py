"""The usual voice of an actor, and its effect on the intensity."""

import json
import re
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
from deitalk.config.rules import VoiceIntensity
from deitalk.data.captures.take import CapturedCurves
from deitalk.data.captures.traits import measure_traits
from deitalk.emotions import ActorReference, read_actor
from deitalk.emotions.actor import TRAITS
from deitalk.errors import AudioError, EmotionError
from deitalk.models.load import load_network
from deitalk.pipeline.actor_voice import measure_actor
from deitalk.pipeline.speech import Speech, measure_intensities
from deitalk.postprocess.feeling import intensity_of, state_of
from rig import RigCurves, default_controls
from rig.conversion.arkit import arkit_controls
from rig.formats.livelink_csv import LiveLinkTake, frame_ticks, write_take
from tests.deitalk.audio.test_prosody import voice
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
    """The take that an actor is measured on has the intensity of a usual voice, by either."""
    sound = Speech.of_recording(load_audio(recordings / "usual.wav"))
    weights = np.eye(1, 5).repeat(sound.n_frames, axis=0).astype(np.float32)
    for model in ("default", "mel"):
        actor = measure_actor([recordings / "usual.wav"], model=model)
        tracks = load_network(model).read(sound.waveform, weights, gain=sound.gain).tracks
        assert (actor.effort is None) == (tracks.effort is None) == (model == "mel")
        assert mean_intensity(sound, tracks, actor) == approx(USUAL_INTENSITY, abs=0.02)
    heard = replace(actor, effort=actor.strength + 5)  # what `mel` does not read it does not use
    assert mean_intensity(sound, tracks, heard) == approx(USUAL_INTENSITY, abs=0.02)


USUAL_INTENSITY = float(intensity_of(state_of(0.0, VoiceIntensity())))


def mean_intensity(sound, tracks, actor):
    """Intensity of the voice in speech."""
    found = measure_intensities(sound, tracks, Acting.of(voice=actor))
    return float(found.voice[sound.activity > 0].mean())


def test_traits_are_drawn_from_the_recordings_within_their_ranges(recordings):
    first, again = (measure_actor([recordings / "usual.wav"]) for _ in range(2))
    other = measure_actor([recordings / "soft.wav"])
    assert first.traits == again.traits
    assert first.traits != other.traits
    assert set(first.traits) == set(TRAITS)
    assert all(low <= first.traits[name] <= high for name, (low, high) in TRAITS.items())


@pytest.mark.parametrize("effort", [None, -0.25])
def test_reference_file_gives_the_reference_back(tmp_path, effort):
    actor = ActorReference(1.25, 12, 63.5, {"side": -0.1, "blink_interval": 1.2}, effort)
    path = tmp_path / "anna.json"
    path.write_text(actor.as_json())
    assert read_actor(path) == actor
    assert Acting.of(voice=path).voice == actor


PLAIN = {"format": "deitalk-actor", "version": 1, "strength": 0, "recordings": 1, "seconds": 1}


@pytest.mark.parametrize(
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


def captured(seconds=60.0, fps=60.0, known=None, head=None, **controls):
    """A take in which some controls, by the end of their names, move with time in seconds."""
    board = default_controls()
    times = np.arange(round(seconds * fps)) / fps
    values = np.tile(board.rest, (len(times), 1)).astype(np.float32)
    for stem, of_time in controls.items():
        for name in board.names:
            if re.search(rf"^CTRL_{stem}\.", name):
                values[:, board.names.index(name)] = of_time(times)
    track = None if head is None else head(times).astype(np.float32)
    curves = RigCurves(values, board.names, fps, head=track)
    return CapturedCurves(curves, board.names if known is None else known, "board")


def blinks(every, length=0.25):
    """Lids that close and open within 0.25 s."""
    return lambda t: np.where(t % every < length, np.sin(np.pi * (t % every) / length) ** 2, 0)


def wave(size):
    """Swings whose period is a window."""
    return lambda t: size * (1 + np.sin(2 * np.pi * t / 3))


def turning(size):
    """A head that swings about all axes."""
    return lambda t: np.column_stack([size * np.sin(2 * np.pi * t / 3)] * 3 + [0 * t] * 3)


@pytest.mark.parametrize("fps", [30.0, 60.0])
def test_blinks_every_two_seconds_over_the_usual_3_2(fps):
    told = measure_traits([captured(fps=fps, **{"[LR]_eye_blink": blinks(2.0)})])
    assert told == {"blink_interval": approx(2 / 3.2, rel=0.01)}
    looks_down = measure_traits([captured(fps=fps, **{"[LR]_eye_blink": blinks(3.0, 2.0)})])
    assert looks_down == {}


def test_brows_and_head_twice_as_wide_give_twice_the_range_and_the_wider_side():
    once, twice = (
        measure_traits([captured(**{"[LR]_brow_raiseOut": wave(size), "L_brow_down": wave(size)})])
        for size in (0.01, 0.02)
    )
    assert twice["brow_range"] == approx(2 * once["brow_range"], rel=1e-4)
    small, large = (measure_traits([captured(head=turning(s))]) for s in (0.3, 0.6))
    assert large["head_range"] == approx(2 * small["head_range"], rel=1e-4)
    # sides by 11 to 9: their difference is 2 of a mean of 10
    uneven = captured(**{"L_brow_raiseOut": wave(0.022), "R_brow_raiseOut": wave(0.018)})
    assert measure_traits([uneven])["side"] == approx(0.2, rel=1e-3)
    even = measure_traits([captured(**{"[LR]_brow_raiseIn": wave(0.02)})])
    assert "side" not in even  # one curve for both: a source that cannot tell


def test_ranges_end_at_those_of_a_reference():
    told = measure_traits([captured(head=turning(90), **{"L_brow_raiseIn": wave(0.5)})])
    assert (told["head_range"], told["brow_range"]) == (2.0, 2.0)


def test_looks_aside_are_of_eyes_and_head_together():
    """Six looks of 8 degrees to the left, two to the right: (6 - 2) / 8."""

    def aside(t):
        place = (t / 6).astype(int) % 4
        return np.where(t % 6 < 1, np.where(place == 3, -0.2, 0.2), 0)

    eyes = captured(48.0, **{"[LR]_eye": aside})
    assert measure_traits([eyes])["avoids"] == approx(0.5)

    def against(t):  # the head turns right, which is where the eyes keep the left
        return np.column_stack([40 * aside(t)] + [0 * t] * 5)

    assert "avoids" not in measure_traits([captured(48.0, head=against, **{"[LR]_eye": aside})])


def test_what_takes_cannot_tell_is_left_out():
    moving = {"[LR]_eye_blink": blinks(2.0), "[LR]_brow_down": wave(0.02)}
    assert measure_traits([captured(19.0, **moving)]) == {}
    assert set(measure_traits([captured(10.0, **moving)] * 2)) == {"brow_range", "blink_interval"}
    lids = ("CTRL_L_eye_blink.ty", "CTRL_R_eye_blink.ty")
    assert set(measure_traits([captured(known=lids, **moving)])) == {"blink_interval"}
    lost = captured(**moving)
    lost = replace(lost, seen=np.arange(len(lost.curves)) < 19 * 60)
    assert measure_traits([lost]) == {}


def test_a_take_of_ours_tells_the_traits_it_was_made_with():
    sound = np.tile(load_audio("docs/samples/amiable.flac").waveform, 8)[: 16_000 * 80]
    for factor in (0.6, 1.2):
        given = {"blink_interval": factor, "brow_range": factor, "head_range": factor}
        actor = ActorReference(0.0, 1, 1.0, given)
        take = animate(sound, sample_rate=16_000, voice=actor).curves
        told = measure_traits([CapturedCurves(take, take.names, "board")])
        for name in given:
            assert told[name] == approx(factor, rel=0.3), name


def test_command_measures_traits_on_takes_without_sound(tmp_path, recordings):
    values = np.zeros((1800, 61))
    names = arkit_controls().names
    t = np.arange(1800) / 30
    for side in ("Left", "Right"):
        values[:, names.index(f"EyeBlink{side}")] = blinks(2.0)(t)
    values[:, names.index("HeadPitch")] = 0.02 * np.sin(2 * np.pi * t / 3)
    folder = tmp_path / "captured"
    folder.mkdir()
    write_take(folder / "a.csv", LiveLinkTake(frame_ticks(1800, 30.0), values, names))
    out = tmp_path / "anna.json"
    run = CliRunner().invoke
    silent = ["data", "voice", "--takes", str(folder), "-o", str(out)]
    done = run(app, silent)
    assert done.exit_code == 0, done.output
    assert "drawn at random: side, brow_range, avoids" in " ".join(done.output.split())
    alone = read_actor(out)
    assert alone.traits["blink_interval"] == approx(0.625, rel=0.01)
    assert alone.strength == alone.recordings == 0
    done = run(app, [*silent, str(recordings / "usual.wav"), "--force"])
    assert done.exit_code == 0, done.output
    both, heard = read_actor(out), measure_actor([recordings / "usual.wav"])
    assert both.strength == approx(heard.strength, abs=1e-3)
    for name, told in alone.traits.items():
        is_told = name in ("blink_interval", "head_range")
        assert both.traits[name] == approx(told if is_told else heard.traits[name], abs=1e-3)
    write_take(folder / "a.csv", LiveLinkTake(frame_ticks(90, 30.0), values[:90], names))
    for arguments, told in (
        ([*silent, "--force"], "no trait can be measured"),
        (["data", "voice", "-o", str(out), "--force"], "name recordings of the actor"),
        (
            ["data", "import", str(folder), "-o", str(tmp_path / "d")],
            "`deitalk data voice` takes silent ones",
        ),
    ):
        failed = run(app, arguments)
        assert failed.exit_code == 1 and told in str(failed.exception or failed.output)
