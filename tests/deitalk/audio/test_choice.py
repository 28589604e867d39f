"""Which signal is read: tracks, channels, samples without a header."""

import io
import json

import numpy as np
import pytest
import soundfile

from deitalk import animate
from deitalk.audio.arrays import recording_from_array, recording_of
from deitalk.audio.choice import ENCODINGS, AudioChoice, RawFormat
from deitalk.audio.load import load_audio
from deitalk.audio.original import write_original
from deitalk.errors import AudioError
from tests.errors import one_line
from tests.media import movie

SPEECH = "docs/samples/amiable.flac"
RATE = 48_000


@pytest.fixture(scope="module")
def voice(request):
    """Two seconds of speech at 48 kHz."""
    samples, rate = soundfile.read(request.config.rootpath / SPEECH, dtype="float32")
    return np.repeat(samples[: 2 * rate], RATE // rate)


def quiet(voice):
    return np.zeros_like(voice)


def hum(voice):
    return (0.05 * np.sin(2 * np.pi * 50 * np.arange(len(voice)) / RATE)).astype(np.float32)


def wav(*channels, kind="WAV"):
    file = io.BytesIO()
    soundfile.write(file, np.stack(channels, axis=1), RATE, "PCM_16", format=kind)
    return file.getvalue()


def like(found, wanted):
    """Whether a waveform is that of samples at 48 kHz, at any gain."""
    expected = load_audio(wav(wanted)).waveform
    count = min(len(found), len(expected))
    return np.corrcoef(found[:count], expected[:count])[0, 1] > 0.97


@pytest.mark.parametrize(("kind", "codec"), [("matroska", "flac"), ("mp4", "aac"), ("mov", "alac")])
@pytest.mark.parametrize("before", [quiet, hum])
def test_the_track_with_speech_is_taken_and_the_others_are_named(voice, before, kind, codec):
    data = movie(kind, [before(voice), voice], codec=codec, titles=["Desktop", "Mic"])
    recording = load_audio(data)
    assert recording.choice == AudioChoice(track=2)
    assert like(recording.waveform, voice)
    note = recording.warnings[0]
    assert "2 sound tracks: track 2 was taken" in note
    if kind == "matroska":
        assert "1 (Desktop) has no speech" in note and "2 (Mic)" in note
    first = load_audio(data, track=1)
    assert first.choice.track == 1 and not first.activity.any()
    assert not any("sound tracks" in note for note in first.warnings)


def test_of_tracks_with_as_much_speech_the_first_is_taken(voice):
    recording = load_audio(movie("matroska", [voice, voice[::-1], quiet(voice)], codec="flac"))
    assert recording.choice.track == 1 and like(recording.waveform, voice)


def test_of_many_tracks_the_first_eight_are_searched(voice):
    sounds = [quiet(voice)[:4800]] * 9 + [voice]
    data = movie("matroska", sounds, codec="flac")
    recording = load_audio(data)
    assert recording.choice.track == 1 and "2 more were not looked at" in recording.warnings[0]
    assert like(load_audio(data, track=10).waveform, voice)


def test_without_speech_the_first_track_is_read(voice):
    recording = load_audio(movie("matroska", [quiet(voice), quiet(voice)], codec="flac"))
    assert recording.choice.track == 1
    assert any("silence" in note for note in recording.warnings)


def test_a_track_that_is_not_there_is_refused(voice):
    data = movie("matroska", [voice, voice], codec="flac")
    with one_line(AudioError, "2 sound tracks", "no track 3"):
        load_audio(data, track=3)
    with one_line(AudioError, "1 sound track;", "no track 2"):
        load_audio(wav(voice), track=2)
    assert load_audio(wav(voice), track=1).duration == 2


@pytest.mark.parametrize(
    ("channel", "index"),
    [("left", 0), ("right", 1), ("1", 0), (2, 1), ("loudest", 1), (" Right ", 1)],
)
def test_a_channel_is_taken_by_name_or_number(voice, channel, index):
    channels = (0.2 * voice, 0.9 * voice[::-1])
    recording = load_audio(wav(*channels), channel=channel)
    assert like(recording.waveform, channels[index])
    assert not any("different voices" in note for note in recording.warnings)


def test_mix_is_the_mean(voice):
    mixed = load_audio(wav(voice, voice[::-1]), channel="mix")
    assert like(mixed.waveform, voice + voice[::-1]) and mixed.choice == AudioChoice(channel="mix")


@pytest.mark.parametrize(
    ("channel", "words"),
    [(3, "channels are 1 to 2"), ("centre", "channels are 1 to 2"), (0, "number from 1"),
     ("middle", "left, right, centre, loudest, mix"), (-1, "number from 1"), ("9" * 5000, "number")],
)  # fmt: skip
def test_a_channel_that_is_not_there_is_refused(voice, channel, words):
    with one_line(AudioError, words):
        load_audio(wav(voice, voice), channel=channel)


@pytest.mark.parametrize("track", [0, -1, 1.5, "one", True, 10**30])
def test_a_track_that_is_no_number_is_refused(voice, track):
    with one_line(AudioError, "track", "whole number"):
        load_audio(wav(voice), track=track)


SURROUND = [("WAVEX", ""), ("FLAC", ""), ("mp4", "aac"), ("matroska", "ac3"), ("ogg", "libopus")]


def surround(kind, codec, channels):
    if not codec:
        return wav(*channels, kind=kind)
    return movie(kind, [np.stack(channels, axis=1)], codec=codec)


@pytest.mark.parametrize(("kind", "codec"), SURROUND)
def test_the_centre_of_surround_sound_is_taken_by_itself(voice, kind, codec, rng):
    music = 0.1 * rng.standard_normal((6, len(voice))).astype(np.float32)
    music[2] = voice
    recording = load_audio(surround(kind, codec, [*music]))
    assert recording.choice.channel == "centre" and like(recording.waveform, voice)
    assert "took the centre, which has the speech" in " ".join(recording.warnings)
    left = load_audio(surround(kind, codec, [*music]), channel="left")
    assert not like(left.waveform, voice)


@pytest.mark.parametrize("middle", [quiet, hum])
def test_surround_sound_whose_centre_has_no_speech_is_mixed(voice, middle):
    channels = [voice, voice, middle(voice), quiet(voice), quiet(voice), quiet(voice)]
    recording = load_audio(wav(*channels, kind="WAVEX"))
    assert recording.choice.channel is None and like(recording.waveform, 2 * voice + channels[2])


def turns(voice, count):
    """Each of several people speaks in turn, on a channel of their own with some of the others."""
    silence = [np.zeros_like(voice)] * count
    alone = [
        np.concatenate([voice if k == turn else silence[k] for turn in range(count)])
        for k in range(count)
    ]
    bleed = sum(alone) * 0.1
    return [0.9 * own + bleed for own in alone]


@pytest.mark.parametrize("count", [2, 4])
def test_channels_of_different_people_give_a_note(voice, count):
    people = turns(voice, count)
    recording = load_audio(wav(*people))
    (note,) = [n for n in recording.warnings if "different voices" in n]
    assert all(f"{k + 1}" in note for k in range(count)) and "option channel" in note
    assert like(recording.waveform, sum(people))
    second = load_audio(wav(*people), channel=2)
    assert like(second.waveform, people[1]) and second.choice.channel == "2"


@pytest.mark.parametrize("gains", [(1, 1), (1, 0.3), (0, 1), (1, 0.02), (1, 0, 0, 0)])
def test_one_voice_on_several_channels_gives_no_note(voice, gains, rng):
    noise = 1e-3 * rng.standard_normal((len(gains), len(voice))).astype(np.float32)
    recording = load_audio(wav(*(gain * voice + n for gain, n in zip(gains, noise, strict=True))))
    assert not any("different voices" in note for note in recording.warnings)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("channels", [1, 2])
def test_samples_without_a_header_are_read_by_their_form(voice, encoding, channels):
    subtype, endian, _ = ENCODINGS[encoding]
    file = io.BytesIO()
    columns = np.stack([voice] * channels, axis=1)
    soundfile.write(file, columns, RATE, subtype, endian, "RAW")
    recording = load_audio(file.getvalue(), raw=f"{encoding},{RATE},{channels}")
    assert recording.duration == 2 and (recording.source_rate, recording.channels) == (
        RATE,
        channels,
    )
    assert np.abs(recording.waveform - load_audio(wav(voice)).waveform).max() < 0.03
    assert recording.choice.settings["raw"] == f"{encoding},{RATE},{channels}"


def test_a_part_of_a_sample_at_the_end_is_left_out_with_a_note():
    recording = load_audio(bytes(32_001), raw="s16le,16000")
    assert recording.duration == 1
    assert "1 bytes at the end are no whole sample" in recording.warnings[0]


@pytest.mark.parametrize(
    "raw",
    ["s16", "s16le", "s16le,", "s16le,0", "s16le,24000,0", "s16le,24000,65", "s16le,24000,1,1",
     "s16le,1e5", "S16LE;24000", "wav,24000", True, "s16le," + "9" * 5000],
)  # fmt: skip
def test_a_form_that_is_none_is_refused(raw):
    with one_line(AudioError, "raw", "s16le,24000,1"):
        load_audio(bytes(1000), raw=raw)


@pytest.mark.parametrize("kind", ["WAV", "FLAC", "OGG", "AIFF", "CAF", "AU", "W64"])
def test_a_file_with_a_header_is_no_raw_sound(kind):
    file = io.BytesIO()
    soundfile.write(file, np.zeros(16_000), 16_000, format=kind)
    with one_line(AudioError, "has a header", "raw"):
        load_audio(file.getvalue(), raw="s16le,16000")


def test_the_form_is_named_where_a_file_is_no_audio():
    with one_line(AudioError, "raw=s16le,24000,1"):
        load_audio(bytes(1000))


def test_a_form_is_the_same_after_its_text():
    form = RawFormat.of(" F32LE , 44100 , 2 ")
    assert RawFormat.of(str(form)) == form == RawFormat("f32le", 44_100, 2)


def test_a_channel_of_an_array(voice):
    stereo = np.stack([quiet(voice), voice], axis=1)
    assert not recording_from_array(stereo, RATE, channel="left").activity.any()
    assert like(recording_of(stereo, RATE, AudioChoice(channel="2")).waveform, voice)
    with one_line(AudioError, "`track=1`", "ndarray"):
        recording_of(stereo, RATE, AudioChoice(track=1))
    with one_line(AudioError, "`channel=left`", "Recording"):
        recording_of(recording_from_array(voice, RATE), None, AudioChoice(channel="left"))


@pytest.mark.parametrize(
    ("choice", "wanted"),
    [
        (AudioChoice(), (0, 1)),
        (AudioChoice(channel="right"), (1,)),
        (AudioChoice(channel="1"), (0,)),
    ],
)
def test_the_sound_of_a_take_is_the_signal_that_was_read(tmp_path, voice, choice, wanted):
    (tmp_path / "s.wav").write_bytes(wav(voice, voice[::-1]))
    write_original(tmp_path / "o.wav", str(tmp_path / "s.wav"), seconds=2, choice=choice)
    found, rate = soundfile.read(tmp_path / "o.wav", always_2d=True)
    assert rate == RATE and found.shape == (2 * RATE, len(wanted))
    given = np.stack([voice, voice[::-1]], axis=1)[:, wanted]
    assert np.abs(found - given).max() < 1e-4


def test_the_sound_of_a_take_keeps_the_silence_before_it(tmp_path, voice):
    data = movie("mov", [quiet(voice), voice], codec="alac", starts=[0, 1.5], picture="mpeg4")
    (tmp_path / "a.mov").write_bytes(data)
    recording = load_audio(tmp_path / "a.mov")
    write_original(
        tmp_path / "o.wav", recording.source, seconds=recording.duration, choice=recording.choice
    )
    found, rate = soundfile.read(tmp_path / "o.wav")
    assert (
        len(found) == pytest.approx(3.5 * RATE, abs=100) and not found[: round(1.49 * rate)].any()
    )
    assert like(load_audio(tmp_path / "o.wav").waveform[24_000:], voice)


def test_a_take_says_which_signal_it_is_of_and_gives_it_again(tmp_path, voice):
    data = movie("matroska", [np.stack([quiet(voice)] * 2, 1), np.stack(turns(voice[:RATE], 2), 1)],
                 codec="flac")  # fmt: skip
    (tmp_path / "a.mkv").write_bytes(data)
    made = animate(tmp_path / "a.mkv", channel="right")
    take = made.save(tmp_path / "take")
    about = json.loads((take / "take.json").read_text())
    signal = {name: about["source"][name] for name in ("track", "channel")}
    assert signal == {"track": 2, "channel": "right"}
    assert "track 2, channel right alone" in about["files"]["audio_48k.wav"]
    again = animate(tmp_path / "a.mkv", **signal, **about["settings"])
    assert np.array_equal(again.curves.values, made.curves.values)
