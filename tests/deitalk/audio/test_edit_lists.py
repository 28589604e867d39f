"""Edit lists of movies: what is heard is what a player plays."""

import struct

import pytest

from deitalk.audio.load import load_audio
from tests.deitalk.audio.test_times import AAC, EXACT, PACKET, RATE, notes
from tests.media import click, click_time, movie


def boxes(data, names, start=0, end=None):
    """Places of boxes of a movie, each within the one before."""
    at = start
    while at < (len(data) if end is None else end):
        size, name = struct.unpack(">I4s", data[at : at + 8])
        if name == names[0]:
            return [at, *(boxes(data, names[1:], at + 8, at + size) if names[1:] else [])]
        at += size
    raise AssertionError(names)


def with_edits(data, edits):
    """A movie of one track with other edits: milliseconds, and the first sample or -1."""
    *around, place = boxes(data, [b"moov", b"trak", b"edts", b"elst"])
    (size,) = struct.unpack(">I", data[place : place + 4])
    rows = b"".join(struct.pack(">IiI", *edit, 0x10000) for edit in edits)
    new = struct.pack(">I4sII", 16 + len(rows), b"elst", 0, len(edits)) + rows
    made = bytearray(data[:place] + new + data[place + size :])
    for at in around:
        (whole,) = struct.unpack(">I", made[at : at + 4])
        made[at : at + 4] = struct.pack(">I", whole + len(new) - size)
    return bytes(made)


@pytest.mark.parametrize(
    ("edits", "at", "seconds", "tolerance"),
    [
        ([(2000, 0)], 1.5, 2, EXACT),
        ([(1000, RATE)], 0.5, 1, EXACT),  # the first second is cut off
        ([(500, -1), (2000, 0)], 2, 2.5, EXACT),
        ([(500, -1), (1000, RATE)], 1, 1.5, EXACT),
        ([(1000, 0), (1000, -1), (1000, RATE)], 2.5, 3, 1024 / RATE),  # FFmpeg cuts at packets
    ],
)
@pytest.mark.parametrize("codec", ["pcm_s16le", "aac"])
def test_edits_of_a_movie_are_kept(codec, edits, at, seconds, tolerance):
    data = with_edits(movie("mov", [click(RATE, 2, 1.5)], codec=codec), edits)
    recording = load_audio(data)
    delay = AAC if codec == "aac" else 0  # these edits do not cut it off
    assert click_time(recording.waveform) == pytest.approx(at + delay, abs=tolerance)
    assert recording.duration == pytest.approx(seconds, abs=PACKET)
    assert not any("header" in note or "cut short" in note for note in notes(recording))
