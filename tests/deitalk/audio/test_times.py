"""Length and time of a click over containers and codecs; several recordings, holes, late starts.

Expected times are those of the samples that each test writes. Where a container holds no delay of
its encoder the click is late by that delay, which is that of the coding's standard.
"""

import io

import av
import numpy as np
import pytest
import soundfile

from deitalk.audio.load import load_audio
from deitalk.errors import AudioError
from tests.errors import one_line
from tests.media import click, click_time, movie

RATE = 48_000
AAC, AC3, MP2, MP3, OPUS = 1024 / RATE, 256 / RATE, 481 / RATE, 1105 / RATE, 312 / RATE
"""Delays of encoders, seconds: ISO 14496-3, ATSC A/52, ISO 11172-3, LAME, RFC 7845."""
EXACT, PACKET = 0.0015, 0.045
"""Tolerances: of a time (movies count milliseconds), of an end within its last packet, seconds."""

COMBINATIONS = [
    ("mp4", "aac", 0), ("mp4", "ac3", 0), ("mp4", "eac3", 0), ("mp4", "libmp3lame", 0),
    ("mp4", "libopus", 0), ("mp4", "flac", 0), ("mp4", "alac", 0), ("mp4", "pcm_s16le", 0),
    ("mov", "aac", 0), ("mov", "alac", 0), ("mov", "pcm_s16be", 0), ("mov", "pcm_s24le", 0),
    ("mov", "pcm_f32le", 0), ("mov", "pcm_mulaw", 0), ("mov", "adpcm_ima_qt", 0),
    ("ipod", "aac", 0), ("ipod", "alac", 0), ("3gp", "aac", 0),
    ("matroska", "aac", 0), ("matroska", "ac3", 0), ("matroska", "mp2", 0),
    ("matroska", "libmp3lame", 0), ("matroska", "libopus", 0), ("matroska", "flac", 0),
    ("matroska", "alac", 0), ("matroska", "pcm_s16le", 0), ("matroska", "pcm_s24be", 0),
    ("matroska", "pcm_f32le", 0), ("webm", "libopus", 0),
    ("mpegts", "aac", AAC), ("mpegts", "ac3", AC3), ("mpegts", "mp2", MP2),
    ("mpegts", "libmp3lame", MP3), ("mpegts", "libopus", OPUS),
    ("ogg", "libopus", 0), ("ogg", "flac", 0), ("opus", "libopus", 0), ("flac", "flac", 0),
    ("mp3", "libmp3lame", 0), ("mp2", "mp2", MP2), ("adts", "aac", AAC),
    ("asf", "aac", AAC), ("asf", "libmp3lame", MP3), ("asf", "pcm_s16le", 0),
    ("flv", "aac", AAC), ("flv", "libmp3lame", MP3),
    ("avi", "libmp3lame", MP3), ("avi", "ac3", AC3), ("avi", "pcm_s16le", 0), ("avi", "flac", 0),
    ("wav", "pcm_s24le", 0), ("wav", "pcm_f32le", 0), ("wav", "pcm_alaw", 0),
    ("wav", "adpcm_ms", 0), ("wav", "libmp3lame", MP3), ("wav", "ac3", AC3), ("w64", "pcm_s16le", 0),
    ("w64", "libmp3lame", MP3), ("aiff", "pcm_s16be", 0), ("aiff", "adpcm_ima_qt", 0),
    ("au", "pcm_mulaw", 0), ("caf", "pcm_s16le", 0), ("caf", "alac", 0), ("caf", "ac3", 0),
]  # fmt: skip
"""Muxers and encoders of FFmpeg, and the delay that the container cannot hold."""

NOT_WRITTEN = {
    ("matroska", "aac"): AAC, ("matroska", "ac3"): AC3, ("matroska", "mp2"): MP2,
    ("matroska", "libmp3lame"): MP3, ("caf", "ac3"): AC3,
}  # fmt: skip
"""Delays that FFmpeg before 8 does not write into these containers."""

BY_SNDFILE = [
    ("WAV", "PCM_16"), ("WAV", "PCM_U8"), ("WAV", "DOUBLE"), ("WAV", "ULAW"), ("WAV", "GSM610"),
    ("WAV", "MS_ADPCM"), ("WAV", "IMA_ADPCM"), ("WAVEX", "PCM_24"), ("RF64", "PCM_16"),
    ("W64", "FLOAT"), ("AIFF", "PCM_24"), ("AIFF", "ALAW"), ("AU", "FLOAT"), ("CAF", "PCM_32"),
    ("CAF", "ALAC_16"), ("FLAC", "PCM_16"), ("FLAC", "PCM_24"), ("OGG", "VORBIS"), ("OGG", "OPUS"),
    ("MP3", "MPEG_LAYER_III"), ("VOC", "PCM_16"), ("NIST", "PCM_16"), ("IRCAM", "PCM_16"),
    ("PAF", "PCM_16"), ("SVX", "PCM_16"), ("AVR", "PCM_16"), ("MAT5", "PCM_16"), ("PVF", "PCM_16"),
]  # fmt: skip
"""Formats of libsndfile."""


def written(kind, coding, samples=None, rate=0):
    rate = rate or (8_000 if coding == "GSM610" else 16_000)
    file = io.BytesIO()
    soundfile.write(file, click(rate) if samples is None else samples, rate, coding, format=kind)
    return file.getvalue()


def silent(kind, coding, seconds=2, rate=0):
    rate = rate or (8_000 if coding == "GSM610" else 16_000)
    return written(kind, coding, np.zeros(seconds * rate), rate)


def notes(recording):
    """Notes other than those on the speech that a click is not."""
    of_speech = ("speech", "voice", "silence:", "clipped", "DC offset")
    return [n for n in recording.warnings if not any(word in n for word in of_speech)]


@pytest.mark.parametrize(("kind", "codec", "delay"), COMBINATIONS)
def test_a_click_keeps_its_time_in_containers_of_ffmpeg(kind, codec, delay):
    if av.library_versions["libavformat"] < (62,):
        delay = NOT_WRITTEN.get((kind, codec), delay)
    recording = load_audio(movie(kind, [click(RATE)], codec=codec))
    assert click_time(recording.waveform) == pytest.approx(1 + delay, abs=EXACT)
    assert recording.duration == pytest.approx(2, abs=PACKET)
    assert notes(recording) == []


@pytest.mark.parametrize(("kind", "coding"), BY_SNDFILE)
def test_a_click_keeps_its_time_in_formats_of_libsndfile(kind, coding):
    recording = load_audio(written(kind, coding))
    assert click_time(recording.waveform) == pytest.approx(1, abs=EXACT)
    assert recording.duration == pytest.approx(2, abs=PACKET)
    assert notes(recording) == []


LATE = [
    ("mp4", "aac", "mpeg4"), ("mp4", "alac", "mpeg4"), ("mov", "aac", "mpeg4"),
    ("mov", "pcm_s16le", "mpeg4"), ("3gp", "aac", "mpeg4"), ("matroska", "aac", "mpeg4"),
    ("matroska", "libopus", "mpeg4"), ("matroska", "pcm_s16le", "mpeg4"),
    ("webm", "libopus", "libvpx"), ("mpegts", "aac", "mpeg2video"),
    ("mpegts", "mp2", "mpeg2video"), ("asf", "libmp3lame", "mpeg4"), ("flv", "libmp3lame", "flv"),
]  # fmt: skip


@pytest.mark.parametrize("start", [0.25, 1.5])
@pytest.mark.parametrize(("kind", "codec", "picture"), LATE)
def test_sound_that_starts_after_the_picture_is_silent_until_then(kind, codec, picture, start):
    data = movie(kind, [click(RATE)], codec=codec, starts=[start], picture=picture)
    recording = load_audio(data)
    assert click_time(recording.waveform) == pytest.approx(start + 1, abs=EXACT)
    assert recording.duration == pytest.approx(start + 2, abs=PACKET)
    assert len(notes(recording)) == 1 and "into the file: silent until then" in notes(recording)[0]


@pytest.mark.parametrize(("kind", "codec", "picture"), LATE)
def test_sound_that_starts_with_the_picture_has_no_silence_before_it(kind, codec, picture):
    recording = load_audio(movie(kind, [click(RATE)], codec=codec, picture=picture))
    # an encoder's delay comes before the picture where the container does not cut it off
    assert 1 - EXACT <= click_time(recording.waveform) <= 1 + MP3 + EXACT
    assert not any("silent until" in note for note in recording.warnings)


HOLES = [
    ("mp4", "aac"), ("mov", "alac"), ("matroska", "aac"), ("matroska", "libopus"),
    ("webm", "libopus"), ("mpegts", "aac"), ("asf", "libmp3lame"), ("flv", "libmp3lame"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "codec"), HOLES)
def test_a_hole_between_packets_is_silence(kind, codec):
    sound = click(RATE, 4, 3)
    sound[: 2 * RATE] += click(RATE, 2, 0.5)
    whole, holed = (
        load_audio(movie(kind, [sound], codec=codec, without=without))
        for without in ((0, 0), (1.0, 2.0))
    )
    assert click_time(holed.waveform[32_000:]) == pytest.approx(
        click_time(whole.waveform[32_000:]), abs=EXACT
    )
    assert holed.duration == pytest.approx(whole.duration, abs=EXACT)
    assert any("1 hole between its packets" in note for note in notes(holed)), holed.warnings
    if codec != "aac":  # whose packets overlap
        assert np.abs(holed.waveform[17_600:31_000]).max() < 1e-3


def test_a_movie_without_a_picture_begins_at_its_zero_and_a_cut_of_fragments_with_its_sound():
    """An empty edit delays a lone track; fragments that were cut out of a stream keep its times."""
    late = {"codec": "aac", "starts": [1.5]}
    movie_time = load_audio(movie("mp4", [click(RATE)], **late))
    assert click_time(movie_time.waveform) == pytest.approx(2.5, abs=EXACT)
    options = {"movflags": "frag_keyframe+empty_moov+default_base_moof", "frag_duration": "500000"}
    cut = load_audio(movie("mp4", [click(RATE)], options=options, **late))
    assert click_time(cut.waveform) == pytest.approx(1, abs=0.03)


def test_the_later_of_two_tracks_keeps_its_time():
    data = movie("matroska", [np.zeros(3 * RATE), click(RATE)], codec="flac", starts=[0.0, 0.7])
    recording = load_audio(data, track=2)
    assert click_time(recording.waveform) == pytest.approx(1.7, abs=EXACT)


JOINED = [
    ("WAV", "PCM_16"), ("WAV", "ULAW"), ("WAV", "GSM610"), ("WAV", "MS_ADPCM"), ("WAVEX", "PCM_24"),
    ("RF64", "PCM_16"), ("W64", "PCM_16"), ("AIFF", "PCM_16"), ("AU", "PCM_16"), ("CAF", "PCM_16"),
    ("CAF", "ALAC_16"), ("FLAC", "PCM_16"), ("OGG", "VORBIS"), ("OGG", "OPUS"),
    ("MP3", "MPEG_LAYER_III"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "coding"), JOINED)
def test_recordings_one_after_another_are_all_read(kind, coding):
    recording = load_audio(2 * silent(kind, coding) + written(kind, coding))
    assert click_time(recording.waveform) == pytest.approx(5, abs=EXACT)
    assert recording.duration == pytest.approx(6, abs=0.002)
    assert notes(recording) == ["3 recordings one after another: all were read"]


@pytest.mark.parametrize(
    ("kind", "codec", "delay"),
    [
        ("mp4", "aac", 0), ("mov", "pcm_s16le", 0), ("matroska", "libopus", 0),
        ("webm", "libopus", 0), ("ogg", "libopus", 0), ("ogg", "flac", 0), ("avi", "pcm_s16le", 0),
        ("mp3", "libmp3lame", 0), ("adts", "aac", AAC), ("mp2", "mp2", MP2), ("mpegts", "aac", AAC),
        ("asf", "pcm_s16le", 0), ("flv", "libmp3lame", MP3),
    ],
)  # fmt: skip
def test_files_of_ffmpeg_one_after_another_are_all_read(kind, codec, delay):
    quiet = movie(kind, [np.zeros(2 * RATE, np.float32)], codec=codec)
    recording = load_audio(2 * quiet + movie(kind, [click(RATE)], codec=codec))
    # every delay that a container cannot hold stands before its recording, with its last packet
    most = 3 * delay + 2 * PACKET * bool(delay)
    assert 5 - EXACT <= click_time(recording.waveform) <= 5 + most + EXACT
    assert 6 - EXACT <= recording.duration <= 6 + most + PACKET


@pytest.mark.parametrize("form", [(8_000, 1), (22_050, 2), (48_000, 1), (44_100, 6)])
@pytest.mark.parametrize("kind", ["WAV", "FLAC", "OGG", "MP3"])
def test_recordings_of_other_rates_and_channels_are_made_alike(kind, form):
    rate, channels = form
    if kind == "MP3" and channels > 2:
        pytest.skip("MP3 has two channels at most")
    coding = {"OGG": "VORBIS", "MP3": "MPEG_LAYER_III"}.get(kind, "PCM_16")
    other = written(kind, coding, np.repeat(click(rate)[:, None], channels, axis=1), rate)
    recording = load_audio(silent(kind, coding) + other)
    assert (recording.source_rate, recording.channels) == (16_000, 1)
    assert click_time(recording.waveform) == pytest.approx(3, abs=EXACT)
    assert np.abs(recording.waveform).max() == pytest.approx(0.7, abs=0.15)
    many = f"{channels} channel{'s' * (channels > 1)} at {rate} Hz"
    assert f"changes at 2.00 s ({many}): made alike" in notes(recording)[-1]


def test_recordings_of_which_one_is_damaged_are_read_with_a_note(rng):
    noise = written("FLAC", "PCM_16", 0.1 * rng.standard_normal(32_000))
    recording = load_audio(noise[: len(noise) // 2] + written("FLAC", "PCM_16"))
    assert recording.duration > 2.5
    assert any("cut short" in note for note in recording.warnings)
    whole = written("OGG", "OPUS")
    recording = load_audio(whole + whole[: len(whole) // 2] + whole)
    assert recording.duration == pytest.approx(4, abs=EXACT)
    assert any("recording 2 of 3 is left out" in note for note in recording.warnings)


def test_very_many_recordings_in_one_file_are_refused_in_one_line():
    one = written("WAV", "PCM_16", np.zeros(160))
    assert load_audio(500 * one).duration == pytest.approx(5)
    with one_line(AudioError, "1000", "one header"):
        load_audio(10_000 * one)
    link = written("OGG", "OPUS", np.zeros(480), 48_000)
    with one_line(AudioError, "1000"):
        load_audio(10_000 * link)
