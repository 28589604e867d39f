"""Lengths that headers state and files do not keep."""

import struct

import numpy as np
import pytest

from deitalk.audio.decoding import open_sound
from deitalk.audio.load import load_audio
from tests.deitalk.audio.test_times import EXACT, PACKET, RATE, notes, written
from tests.media import click, click_time, movie

LIST = b"LIST" + struct.pack("<I", 26) + b"INFOISFT" + struct.pack("<I", 14) + b"Lavf59.27.100\0"
SIZES = (0, 1000, 0x7FFFFFFE, 0x7FFFFFFF, 0x80000000, 2_000_000_000, 0xFFFFFFFF - 36, 0xFFFFFFFF)


def sized(data, place, form, value):
    return data[:place] + struct.pack(form, value) + data[place + struct.calcsize(form) :]


def with_size(kind, size):
    """A recording of 2 s whose header states so many bytes of samples."""
    data = written(kind, "PCM_16")
    if kind == "WAV":
        return sized(sized(data, 40, "<I", size), 4, "<I", min(size + 36, 0xFFFFFFFF))
    if kind == "AU":
        return sized(data, 8, ">I", size)
    if kind == "AIFF":
        frames = sized(data, data.index(b"COMM") + 10, ">I", size)
        return sized(frames, data.index(b"SSND") + 4, ">I", size)
    size = -1 if size == 0xFFFFFFFF else size
    if kind == "RF64":
        return sized(data, data.index(b"ds64") + 16, "<q", size)
    if kind == "W64":
        return sized(data, data.index(b"data\xf3") + 16, "<q", size)
    return sized(data, data.index(b"data") + 4, ">q", size)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kind", ["WAV", "RF64", "W64", "AIFF", "AU", "CAF"])
def test_bytes_are_believed_over_a_size_in_the_header(kind, size):
    data = with_size(kind, size)
    recording = load_audio(data)
    assert recording.duration == 2 and click_time(recording.waveform) == pytest.approx(1, abs=EXACT)
    assert len(notes(recording)) == 1 and "2.00 s" in notes(recording)[0]
    twice = load_audio(data + data)
    assert twice.duration == 4
    assert click_time(twice.waveform[32_000:]) == pytest.approx(1, abs=EXACT)


@pytest.mark.parametrize("size", [*SIZES, 64_000])
def test_chunks_after_samples_of_unknown_length_are_no_sound(size):
    recording = load_audio(with_size("WAV", size) + LIST)
    assert recording.duration == 2
    assert np.abs(recording.waveform[-1600:]).max() < 1e-4


@pytest.mark.parametrize("kind", ["WAV", "W64", "AIFF", "AU", "CAF", "FLAC", "OGG", "MP3"])
def test_a_tag_before_a_recording_is_no_sound(kind):
    """ID3v2: ten bytes, the last four of 7 bits each its size, here 130; then the recording."""
    data, tag = written(kind, None), b"ID3\4\0\0\0\0\1\2" + bytes(130)
    plain, tagged = load_audio(data), load_audio(tag + data)
    assert np.array_equal(tagged.waveform, plain.waveform) and notes(tagged) == notes(plain)
    assert load_audio(tag + data + data).duration == pytest.approx(2 * plain.duration, abs=0.1)


@pytest.mark.parametrize("after", [LIST, b"\0" * 700, b"TAG" + b"a" * 125, b"ID3\3\0\0\0\0\1\0abc"])
def test_what_follows_samples_of_a_true_length_is_no_sound(after):
    recording = load_audio(written("WAV", "PCM_16") + after)
    assert recording.duration == 2 and notes(recording) == []


def test_samples_that_look_like_a_chunk_stay_sound():
    """A name in the samples without a chain of chunks to the end is no chunk."""
    samples = np.frombuffer(b"LIST" * 8000, "<i2").astype(np.float64) / 32768
    data = sized(written("WAV", "PCM_16", samples), 40, "<I", 0xFFFFFFFF)
    assert load_audio(data).duration == 1


@pytest.mark.parametrize("total", [0, 1000, 10**6, 2**36 - 1])
def test_a_flac_is_read_whatever_number_of_samples_it_states(total):
    data = written("FLAC", "PCM_16")
    packed = int.from_bytes(data[18:26], "big") >> 36 << 36 | total
    recording = load_audio(data[:18] + packed.to_bytes(8, "big") + data[26:])
    assert recording.duration == 2
    assert bool(notes(recording)) == bool(total)  # 0 is no statement


@pytest.mark.parametrize("bits", ["PCM_16", "PCM_24"])
def test_a_flac_without_a_right_checksum_is_read_by_ffmpeg_alike(bits):
    samples = np.random.default_rng(0).uniform(-0.5, 0.5, (4000, 2))
    data = written("FLAC", bits, samples)
    readers, found = [], []
    for content in (data, data[:26] + bytes(16) + data[42:]):
        with open_sound("a.flac", content) as sound:
            readers.append(type(sound.first))
            found.append(np.concatenate([*sound.blocks(512)]))
            found[-1] = sound.rate, sound.channels, sound.layout, sound.expected, found[-1]
    assert (readers[0] is readers[1]) == (bits == "PCM_24")
    for ours, theirs in zip(*found, strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("frames", [0, 1, 40, 0xFFFFFF])
def test_an_mp3_is_read_whatever_number_of_frames_it_states(frames):
    data = movie("mp3", [click(RATE)], codec="libmp3lame")
    mark = max(data.find(b"Xing"), data.find(b"Info"))
    recording = load_audio(sized(data, mark + 8, ">I", frames))
    assert recording.duration == pytest.approx(2, abs=PACKET)
    assert click_time(recording.waveform) == pytest.approx(1, abs=0.025)


def test_a_header_of_terabytes_needs_little_memory():
    data = sized(written("RF64", "PCM_16"), 20, "<Q", 2**42)
    assert load_audio(data).duration == 2
    data = movie("matroska", [click(RATE)], codec="flac")
    at = data.index(b"\x44\x89\x88") + 3  # the element Duration, milliseconds
    assert load_audio(sized(data, at, ">d", 1e15)).duration == 2
