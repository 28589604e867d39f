"""Recordings as mono 16 kHz: known signals, damaged files, invalid input."""

import io
import os
import signal
import struct
import subprocess
import wave
from fractions import Fraction
from math import ceil

import numpy as np
import pytest
import soundfile as sf
from hypothesis import given
from hypothesis import strategies as st

from deitalk.audio.content import Window
from deitalk.audio.frames import frame_count, frame_times
from deitalk.audio.load import load_audio, write_wav
from deitalk.errors import AudioError
from rig.errors import TargetError
from tests.errors import one_line
from tests.media import write_silent_video, write_sound


def tone(rate, seconds=1.0, hz=440.0, peak=0.5):
    return peak * np.sin(2 * np.pi * hz * np.arange(round(rate * seconds)) / rate)


@given(st.integers(0, 10**9))
def test_frame_count_is_the_exact_ceiling(n_samples):
    assert frame_count(n_samples) == ceil(Fraction(30 * n_samples, 16000))


def test_frame_count_by_hand():
    assert [frame_count(n) for n in (0, 1, 533, 534, 16000, 16001)] == [0, 1, 1, 2, 30, 31]
    assert frame_times(4).tolist() == [0, 1 / 30, 2 / 30, 3 / 30]


@pytest.mark.parametrize("rate", [4000, 8000, 11025, 16000, 22050, 44100, 48000, 96000, 768000])
def test_tone_keeps_frequency_level_and_time_at_any_rate(tmp_path, rate):
    path = tmp_path / "tone.wav"
    sf.write(path, tone(rate), rate, subtype="FLOAT")
    recording = load_audio(path)
    assert recording.waveform.dtype == np.float32
    assert recording.waveform.shape == (16000,)
    assert (recording.source_rate, recording.channels, recording.n_frames) == (rate, 1, 30)
    middle = slice(1000, -1000)  # the resampler rings at the cut ends of a tone
    assert np.abs(recording.waveform - tone(16000))[middle].max() < 2e-3


@pytest.mark.parametrize(
    ("suffix", "tolerance"),
    [("wav", 1e-4), ("flac", 1e-4), ("ogg", 0.05), ("mp3", 0.05), ("opus", 0.1)],
)
def test_formats_give_the_same_waveform(tmp_path, suffix, tolerance):
    path = tmp_path / f"tone.{suffix}"
    kind = {"format": "OGG", "subtype": "OPUS"} if suffix == "opus" else {}
    sf.write(path, tone(48000), 48000, **kind)
    waveform = load_audio(path).waveform
    assert np.abs(waveform[2000:14000] - tone(16000)[2000:14000]).max() < tolerance


def test_mp3_samples_equal_those_of_libsndfile(tmp_path, rng):
    path = tmp_path / "a.mp3"
    sf.write(path, tone(16000) + rng.normal(0, 0.05, 16000), 16000)
    expected = sf.read(path, dtype="float32")[0]
    np.testing.assert_allclose(load_audio(path).waveform, expected - expected.mean(), atol=1e-5)


@pytest.mark.parametrize("kept", [0, 4, 40])
def test_load_audio_rejects_text_named_mp3_and_prints_nothing(tmp_path, capfd, rng, kept):
    sf.write(tmp_path / "a.mp3", tone(44100, 3.0), 44100)
    head = rng.integers(1, 250, kept, dtype=np.uint8).tobytes()
    (tmp_path / "a.mp3").write_bytes(head + b"Dear diary,\n" * 200)
    with one_line(AudioError, "a.mp3", "not audio that can be read"):
        load_audio(tmp_path / "a.mp3")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.m4a", b"\0\0\0\x20ftypM4A " + bytes(100), "cut off or damaged"),
        ("a.webm", b"\x1a\x45\xdf\xa3" + bytes(100), "cut off or damaged"),
        ("a.mp3", b"ID3\x03\0\0\0\0\0\x0a" + bytes(30), "cut off or damaged"),
        ("a.mp4", b"Dear diary,\n", "is not audio that can be read"),
    ],
)
def test_load_audio_rejects_containers_without_content(tmp_path, capfd, name, content, words):
    (tmp_path / name).write_bytes(content)
    with one_line(AudioError, name, words):
        load_audio(tmp_path / name)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", ["m4a", "mka", "mp3"])
def test_tags_that_are_no_utf_8_are_ignored(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    write_sound(path, np.stack([tone(48000)], 1), 48000, title="Zoe Z.")
    content = path.read_bytes()
    assert b"Zoe Z." in content
    assert load_audio(content.replace(b"Zoe Z.", b"Zo\xeb Z.")).duration > 0.9


def test_load_audio_rejects_video_without_sound(tmp_path):
    with one_line(AudioError, "a.mp4", "export it with its sound", match="has no sound track"):
        load_audio(write_silent_video(tmp_path / "a.mp4"))


def test_damage_inside_a_container_becomes_silence_and_a_warning(tmp_path, rng):
    path = write_sound(tmp_path / "a.m4a", np.stack([tone(48000, 4.0)], 1), 48000)
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 2000] = rng.integers(0, 256, 2000, dtype=np.uint8).tobytes()
    recording = load_audio(bytes(content))
    assert recording.duration == pytest.approx(4.0, abs=0.05)
    assert "damaged pieces are silent now, the first at" in recording.warnings[0]


@pytest.mark.parametrize(
    "first", ["ffconcat version 1.0\nfile secret.wav\n", "#EXTM3U\nsecret.wav\n"]
)
def test_playlist_opens_no_other_file(tmp_path, first):
    sf.write(tmp_path / "secret.wav", tone(16000), 16000)
    (tmp_path / "list.m4a").write_text(first)
    with pytest.raises(AudioError, match="not audio"):
        load_audio(tmp_path / "list.m4a")


def test_damaged_containers_give_an_error_of_one_line_or_a_recording(tmp_path, rng, capfd):
    for suffix in ("m4a", "mp4", "webm", "mp3", "aac", "wma", "mka"):
        path = write_sound(tmp_path / f"a.{suffix}", np.stack([tone(16000, 0.5)], 1), 16000)
        content = np.frombuffer(path.read_bytes(), np.uint8)
        for _ in range(8):
            damaged = content[: rng.integers(20, len(content) + 1)].copy()
            where = rng.integers(0, len(damaged), rng.integers(1, 30))
            damaged[where] = rng.integers(0, 256, len(where))
            try:
                assert np.isfinite(load_audio(damaged.tobytes()).waveform).all()
            except AudioError as error:
                assert "\n" not in str(error)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", ["wav", "flac", "ogg", "mp3", "m4a"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_ctrl_c_while_a_decoder_reads_is_not_lost(tmp_path, monkeypatch, capfd, suffix, share):
    """Decoders print exceptions of what they call, and take them for the end of the file."""
    path, sound = tmp_path / f"a.{suffix}", tone(48_000, 20)[:, None]
    if suffix == "m4a":
        write_sound(path, sound, 48_000)
    else:
        sf.write(path, sound, 48_000)
    plain, calls, last = Window.read, [0], [0]

    def pressed(window: Window, count: int = -1) -> bytes:
        calls[0] += 1
        if calls[0] == last[0]:
            signal.raise_signal(signal.SIGINT)
        return plain(window, count)

    monkeypatch.setattr(Window, "read", pressed)
    load_audio(path)
    last[0], calls[0] = max(round(share * calls[0]), 1), 0
    with pytest.raises(KeyboardInterrupt):
        load_audio(path)
    assert not capfd.readouterr().err


def test_bytes_and_streams_equal_the_file(tmp_path):
    path = tmp_path / "tone.flac"
    sf.write(path, tone(44100), 44100)
    from_path = load_audio(path).waveform
    assert np.array_equal(from_path, load_audio(str(path)).waveform)
    assert np.array_equal(from_path, load_audio(path.read_bytes()).waveform)
    with path.open("rb") as file:
        assert np.array_equal(from_path, load_audio(file).waveform)
    assert load_audio(io.BytesIO(path.read_bytes())).source == "<stream>"


def test_channels_are_averaged(tmp_path, rng):
    channels = rng.normal(0, 0.1, (16000, 3))
    sf.write(tmp_path / "a.wav", channels, 16000, subtype="FLOAT")
    mean = channels.mean(axis=1)
    recording = load_audio(tmp_path / "a.wav")
    np.testing.assert_allclose(recording.waveform, mean - mean.mean(), atol=1e-6)
    assert recording.channels == 3
    assert not any("cancel" in note for note in recording.warnings)


def test_one_channel_of_eight_with_sound_is_averaged(tmp_path):
    channels = np.zeros((16000, 8))
    channels[:, 3] = tone(16000)
    sf.write(tmp_path / "a.wav", channels, 16000, subtype="FLOAT")
    recording = load_audio(tmp_path / "a.wav")
    assert not any("cancel" in note for note in recording.warnings)
    assert np.abs(recording.waveform).max() == pytest.approx(0.5 / 8, rel=1e-3)


def test_inverted_channels_take_the_loudest(tmp_path):
    voice = tone(16000)
    sf.write(tmp_path / "a.wav", np.stack([0.9 * voice, -voice], 1), 16000, subtype="FLOAT")
    recording = load_audio(tmp_path / "a.wav")
    np.testing.assert_allclose(recording.waveform, -voice, atol=1e-4)
    assert "cancel" in recording.warnings[0]
    assert "channel 2" in recording.warnings[0]


def test_dc_is_removed_with_a_warning(tmp_path):
    sf.write(tmp_path / "a.wav", tone(16000) + 0.2, 16000, subtype="FLOAT")
    recording = load_audio(tmp_path / "a.wav")
    assert abs(recording.waveform.mean()) < 1e-6
    assert "DC offset of +0.200" in recording.warnings[0]


def test_clipping_is_measured(tmp_path):
    sf.write(tmp_path / "clipped.wav", np.clip(tone(16000, peak=2.0), -1, 1), 16000)
    recording = load_audio(tmp_path / "clipped.wav")
    # a sine of amplitude 2 is beyond 1 for 2/3 of the time: asin(1/2) = 30 of 90 degrees below it
    assert recording.clipped_fraction == pytest.approx(2 / 3, abs=0.03)
    assert "clipped" in recording.warnings[0]
    sf.write(tmp_path / "full.wav", tone(16000, peak=0.99997), 16000)
    assert load_audio(tmp_path / "full.wav").clipped_fraction == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_load_audio_rejects_samples_that_are_not_finite(tmp_path, bad):
    samples = tone(16000)
    samples[8000] = bad
    for n, channels in enumerate((samples, np.stack([tone(16000), samples], 1))):
        sf.write(tmp_path / f"{n}.wav", channels, 16000, subtype="FLOAT")
        with one_line(AudioError, "export it as 16-bit PCM", match=r"sample 8000 \(0.500 s\)"):
            load_audio(tmp_path / f"{n}.wav")


@pytest.mark.parametrize("rate", [1, 3999, 768001])
def test_load_audio_rejects_rates_out_of_range(tmp_path, rate):
    sf.write(tmp_path / "a.wav", tone(16000), rate)
    with one_line(AudioError, "4000", "768000", "export", match=f"sample rate is {rate} Hz"):
        load_audio(tmp_path / "a.wav")


def test_load_audio_rejects_recordings_too_long_by_header_or_content(tmp_path):
    sf.write(tmp_path / "a.wav", np.zeros(4000 * 10), 4000)
    with one_line(AudioError, "10 s", "split", match="the limit is 5 s"):
        load_audio(tmp_path / "a.wav", max_seconds=5)
    content = bytearray((tmp_path / "a.wav").read_bytes())
    content[40:44] = struct.pack("<I", 8000)  # one second by the header
    assert len(load_audio(bytes(content), max_seconds=5).waveform) == 16000


@pytest.mark.parametrize(("kind", "endian"), [("WAV", "LITTLE"), ("AIFF", "BIG")])
def test_wav_shorter_than_its_header_gives_a_warning(kind, endian):
    file = io.BytesIO()
    sf.write(file, np.stack([tone(16000, 4.0)] * 2, 1), 16000, format=kind, endian=endian)
    content = file.getvalue()
    assert not any("cut short" in note for note in load_audio(content).warnings)
    recording = load_audio(content[: len(content) * 3 // 8])
    assert recording.duration == pytest.approx(1.5, abs=0.01)
    assert any("cut short: 1.50 s of 4.00 s" in note for note in recording.warnings)


def test_cut_file_is_read_to_its_end(tmp_path):
    sf.write(
        tmp_path / "a.flac",
        tone(16000, 4.0) + 0.01 * np.random.default_rng(0).normal(size=64000),
        16000,
    )
    content = (tmp_path / "a.flac").read_bytes()
    try:
        recording = load_audio(content[: len(content) // 2])
    except AudioError as error:
        assert "damaged" in str(error)
    else:
        assert 1.0 < recording.duration < 3.0
        assert "cut short" in recording.warnings[0]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.wav", b"", "empty (0 bytes)"),
        ("text.wav", b"Dear diary,\n", "not audio that can be read"),
        ("noise.mp3", bytes(range(7, 200)), "not audio that can be read"),
        ("text.raw", b"Dear diary,\n", "not audio that can be read"),
        ("half.wav", b"RIFF\x24\0\0\0WAVEfmt ", "cut off or damaged"),
    ],
)
def test_load_audio_rejects_files_that_are_no_audio(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_bytes(content)
    for source in (path, content):
        with one_line(AudioError, words):
            load_audio(source)


def test_load_audio_rejects_paths_that_cannot_be_read(tmp_path):
    with pytest.raises(AudioError, match="there is no recording"):
        load_audio(tmp_path / "missing.wav")
    with pytest.raises(AudioError, match="is a folder"):
        load_audio(tmp_path)
    with pytest.raises(AudioError, match="cannot read"):
        load_audio("x" * 5000 + ".wav")
    with pytest.raises(AudioError, match="not a regular file"):
        load_audio("/dev/null")
    with pytest.raises(AudioError, match="binary mode"):
        load_audio(io.StringIO("text"))
    with pytest.raises(AudioError, match="a list is no recording"):
        load_audio([0.0])


def test_full_disk_leaves_no_partial_file(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    write_wav(tmp_path / "a.wav", [0.5])
    monkeypatch.setattr("deitalk.audio.load.wav_header", full)
    with pytest.raises(TargetError, match="no space left on the disk; free some"):
        write_wav(tmp_path / "a.wav", [0.0])
    assert [p.name for p in tmp_path.iterdir()] == ["a.wav"]
    assert load_audio(tmp_path / "a.wav").n_frames == 1


@pytest.mark.slow
def test_an_hour_of_stereo_stays_under_400_mb(tmp_path):
    script = (
        "import resource, sys; from deitalk.audio.load import load_audio;"
        "load_audio(sys.argv[1]); print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    peaks = []
    for minutes in (1, 60):
        path = tmp_path / f"{minutes}.wav"
        minute = np.random.default_rng(0).normal(0, 3000, (48000 * 60, 2)).astype("<i2").tobytes()
        with wave.open(str(path), "wb") as file:
            file.setparams((2, 2, 48000, 0, "NONE", "NONE"))
            for _ in range(minutes):
                file.writeframes(minute)
        done = subprocess.run(
            [os.sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=True
        )
        peaks.append(int(done.stdout) / 1024)
    assert peaks[1] < 400
