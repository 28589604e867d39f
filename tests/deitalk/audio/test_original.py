"""The recording at 48 kHz and its time code, against the Broadcast Wave Format (EBU Tech 3285)."""

import struct
import wave

import numpy as np
import pytest
import soundfile

from deitalk.audio.load import load_audio, write_wav
from deitalk.audio.original import parse_timecode, start_of, start_seconds, write_original
from deitalk.errors import DeitalkError
from tests.media import write_sound


def bext(samples):
    """The chunk of the standard, field by field."""
    fields = [b"take 1".ljust(256, b"\0"), b"recorder".ljust(32, b"\0"), b"\0" * 32]
    fields += [b"2026-11-23", b"10:11:12", struct.pack("<II", samples % 2**32, samples // 2**32)]
    fields += [struct.pack("<H", 1), b"\0" * 64, b"\0" * 190]
    data = b"".join(fields)
    assert len(data) == 602
    return b"bext" + struct.pack("<I", len(data)) + data


def broadcast(path, samples, rate, *, before=True):
    """A 16-bit WAV with the chunk before or after its samples."""
    form = struct.pack("<HHIIHH", 1, 1, rate, 2 * rate, 2, 16)
    form = b"fmt " + struct.pack("<I", 16) + form
    sound = np.zeros(rate // 10, "<i2").tobytes()
    data = b"data" + struct.pack("<I", len(sound)) + sound
    parts = [bext(samples), form, data] if before else [form, data, bext(samples)]
    body = b"WAVE" + b"".join(parts)
    path.write_bytes(b"RIFF" + struct.pack("<I", len(body)) + body)
    return path


@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize(("rate", "hours"), [(48000, 13), (96000, 23), (44100, 0.5)])
def test_time_of_day_is_that_of_the_chunk(tmp_path, rate, hours, before):
    path = broadcast(tmp_path / "a.wav", round(hours * 3600 * rate), rate, before=before)
    assert start_seconds(path) == pytest.approx(hours * 3600)
    assert load_audio(path).start == pytest.approx(hours * 3600)
    assert load_audio(path.read_bytes()).start == pytest.approx(hours * 3600)


def test_start_is_zero_the_recordings_or_the_given_time():
    assert start_of("zero", None, 7.5) == (0.0, "") and start_of("recording", 24, 7.5) == (7.5, "")
    assert start_of("01:00:00:12", 24, 7.5) == (3600.5, "")
    start, note = start_of("recording", None, None)
    assert start == 0 and "no time code" in note
    with pytest.raises(DeitalkError, match="FF below 24"):
        start_of("01:00:00:24", 24, 7.5)


def test_files_without_the_chunk_have_no_time_of_day(tmp_path):
    write_wav(tmp_path / "a.wav", np.zeros(1600))
    write_sound(tmp_path / "a.mp3", np.zeros((48000, 1)), 48000)
    (tmp_path / "short.wav").write_bytes(b"RIFF\0\0")
    for name in ("a.wav", "a.mp3", "short.wav", "absent.wav"):
        assert start_seconds(tmp_path / name) is None
    assert load_audio((tmp_path / "a.wav").read_bytes()).start is None
    damaged = broadcast(tmp_path / "b.wav", 2**63, 48000)
    assert start_seconds(damaged) is None


def test_written_files_carry_the_time_and_are_plain_wav(tmp_path, rng):
    samples = rng.uniform(-0.5, 0.5, 1601)
    write_wav(tmp_path / "a.wav", samples, start=36672.5)
    assert start_seconds(tmp_path / "a.wav") == 36672.5
    back, rate = soundfile.read(tmp_path / "a.wav")
    assert rate == 16000 and np.abs(back - samples).max() < 1 / 32768
    write_wav(tmp_path / "b.wav", samples)
    with wave.open(str(tmp_path / "b.wav")) as file:
        assert file.getparams()[:4] == (1, 2, 16000, 1601)
    assert (tmp_path / "b.wav").stat().st_size == 44 + 2 * 1601  # without the chunk


@pytest.mark.parametrize(("subtype", "bits"), [("PCM_16", 16), ("PCM_24", 24)])
def test_samples_of_48_khz_survive_unchanged(tmp_path, rng, subtype, bits):
    source = tmp_path / "s.wav"
    soundfile.write(source, rng.uniform(-1, 1, (5001, 2)), 48000, subtype=subtype)
    write_original(tmp_path / "o.wav", str(source), seconds=6000 / 48000, start=1.5)
    theirs, _ = soundfile.read(source)
    ours, rate = soundfile.read(tmp_path / "o.wav")
    assert rate == 48000 and ours.shape == (6000, 2)
    assert soundfile.info(tmp_path / "o.wav").subtype == f"PCM_{bits}"
    np.testing.assert_array_equal(ours[:5001], theirs)
    assert not ours[5001:].any()  # silence that was animated after the speech
    assert start_seconds(tmp_path / "o.wav") == 1.5
    write_original(tmp_path / "c.wav", str(source), seconds=0.1)
    assert soundfile.info(tmp_path / "c.wav").frames == 4800


@pytest.mark.parametrize("rate", [44100, 96000])
def test_other_rates_keep_their_place_in_time(tmp_path, rate):
    t = np.arange(rate) / rate
    soundfile.write(tmp_path / "s.flac", 0.5 * np.sin(2 * np.pi * 440 * t) * (t > 0.5), rate)
    write_original(tmp_path / "o.wav", str(tmp_path / "s.flac"), seconds=1.0)
    ours, _ = soundfile.read(tmp_path / "o.wav")
    at = np.arange(48000) / 48000
    expected = 0.5 * np.sin(2 * np.pi * 440 * at) * (at > 0.5)
    assert len(ours) == 48000 and np.abs(ours - expected)[2000:-2000].mean() < 1e-3


@pytest.mark.parametrize(
    ("text", "fps", "seconds"),
    [
        ("00:00:00:00", 30, 0),
        ("01:00:00:00", 24, 3600),
        ("10:11:12:15", 30, 36672.5),
        ("10:11:12:29", 30000 / 1001, 36672 + 29 / 30),
        ("10:11:12.25", 30, 36672.25),
        ("23:59:59", 25, 86399),
        # drop frame: 18 numbers of ten minutes are left out, 17982 frames of 1001/30000 s remain
        ("00:10:00;00", 30000 / 1001, 17982 * 1001 / 30000),
        ("00:01:00;02", 30000 / 1001, 1800 * 1001 / 30000),
        ("01:01:00;02", 29.97, (6 * 17982 + 1800) * 1001 / 30000),
        ("01;01;00;02", 29.97, (6 * 17982 + 1800) * 1001 / 30000),
        ("01:01:00;02", 30, (6 * 17982 + 1800) * 1001 / 30000),
        ("00:01:00;04", 60000 / 1001, 3600 * 1001 / 60000),
        ("23:59:59;29", 29.97, (144 * 17982 - 1) * 1001 / 30000),
    ],
)
def test_time_codes_of_hand_worked_times(text, fps, seconds):
    assert parse_timecode(text, fps) == pytest.approx(seconds)


@pytest.mark.parametrize("text", ["24:00:00:00", "10:11:12:30", "10:60:00:00", "soon", "1:2"])
def test_impossible_time_codes_are_refused(text):
    with pytest.raises(DeitalkError, match=r"is not HH:MM:SS:FF with FF below 30"):
        parse_timecode(text, 30)


@pytest.mark.parametrize(
    ("text", "fps", "expected"),
    [
        ("01:01:00;00", 29.97, "does not exist: drop frame leaves out frames 00 to 01"),
        ("01:01:00;01", 29.97, "write 02"),
        ("01:09:00;03", 59.94, "leaves out frames 00 to 03"),
        ("01:01:00;02", 25, "29.97 or 59.94 frames a second and not 25"),
        ("01:01:00;02", 24000 / 1001, "29.97 or 59.94"),
        ("01:01;00", 29.97, "is not HH:MM:SS:FF"),
        ("01:01:00;30", 29.97, "is not HH:MM:SS:FF"),
    ],
)
def test_drop_frames_that_do_not_exist_are_refused(text, fps, expected):
    with pytest.raises(DeitalkError, match=expected):
        parse_timecode(text, fps)
