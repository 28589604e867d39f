"""Bytes of a file by their places, and windows of it that are files of their own."""

import io
import re
from collections.abc import Iterator
from typing import IO, NamedTuple

BLOCK_BYTES = 1 << 22
MOST_FOUND = 100_000  # places of a text that are looked at: other files have few
START_BYTES = 64
CHANNELS = (
    "FL", "FR", "FC", "LFE", "BL", "BR", "FLC", "FRC", "BC", "SL", "SR", "TC", "TFL", "TFC", "TFR",
    "TBL", "TBC", "TBR",
)  # fmt: skip
"""Names of the bits of a WAV's mask, from the lowest on, as FFmpeg has them."""
W64 = {
    name: name.encode() + bytes.fromhex(rest)
    for name, rest in {
        "riff": "2e91cf11a5d628db04c10000",
        "wave": "f3acd3118cd100c04f8edb8a",
        "fmt ": "f3acd3118cd100c04f8edb8a",
        "data": "f3acd3118cd100c04f8edb8a",
    }.items()
}
"""Names of chunks of a Sony Wave64 file."""

# First bytes of a recording of each format, after a literal that is searched for.
RIFF = (b"WAVE", re.compile(rb"(RIFF|RF64|BW64)....WAVE", re.DOTALL), 8)
STARTS = {
    "wav": RIFF,
    "w64": (W64["riff"], re.compile(re.escape(W64["riff"])), 0),
    "aiff": (b"FORM", re.compile(rb"FORM....AIF[FC]", re.DOTALL), 0),
    "au": (b".snd\0\0", re.compile(rb"\.snd\x00\x00.{6}\x00{3}[\x01-\x1b]", re.DOTALL), 0),
    "caf": (b"caff\0\1\0", re.compile(rb"caff\x00\x01..desc\x00{7}\x20", re.DOTALL), 0),
    "avi": (b"AVI LIST", re.compile(rb"RIFF....AVI LIST....hdrl", re.DOTALL), 8),
    "flac": (b"fLaC", re.compile(rb"fLaC[\x00\x80]\x00\x00\x22", re.DOTALL), 0),
    "amr": (b"#!AMR", re.compile(rb"#!AMR(\n|-WB\n)"), 0),
    "asf": (
        b"\x30\x26\xb2\x75\x8e\x66\xcf\x11", re.compile(rb".{8}\xa6\xd9\x00\xaa", re.DOTALL), 0,
    ),
    "flv": (b"FLV\x01", re.compile(rb"FLV\x01[\x01\x04\x05]\x00{3}\x09\x00{4}"), 0),
    "matroska": (
        b"\x1a\x45\xdf\xa3", re.compile(rb"\x1a\x45\xdf\xa3.{4,48}(webm|matroska)", re.DOTALL), 0,
    ),
}  # fmt: skip


LONGEST_CUT_SECONDS = 3 * 3600.0  # a longer length in a header is no sound that was cut off


class Part(NamedTuple):
    """One recording: bytes of the file, a header to put before them, and what the old one says."""

    start: int
    stop: int
    head: bytes = b""
    note: str = ""
    """On its length."""
    layout: tuple[str, ...] = ()
    """Names of its channels, such as FL and FR, where they are known."""
    samples: int = 0
    """Number of samples without the padding of the last block; 0 if unknown."""


class Window:
    """A part of a file as a file of its own: seeking to an invalid position has no effect.

    In a callback of libsndfile an exception would be printed as a traceback on standard error.
    Without a name, since libsndfile decodes any file named ``.mp3`` as MPEG audio; FFmpeg can
    read and seek it but not close the file.
    """

    def __init__(self, file: IO[bytes], part: Part) -> None:
        self.file, self.part, self.place = file, part, 0
        self.size = len(part.head) + part.stop - part.start

    def read(self, count: int = -1) -> bytes:
        """Read at most `count` bytes from the position on."""
        left = self.size - self.place
        count = left if count < 0 else min(count, left)
        if count <= 0:
            return b""
        before = len(self.part.head)
        data = self.part.head[self.place : self.place + count] if self.place < before else b""
        if len(data) < count:
            self.file.seek(self.part.start + self.place + len(data) - before)
            rest = self.file.read(count - len(data))
            data = data + rest if data else rest
        self.place += len(data)
        return data

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Go to a position; stay if it does not exist."""
        place = offset + (0, self.place, self.size)[whence]
        if place >= 0:
            self.place = place
        return self.place

    def tell(self) -> int:
        """The position."""
        return self.place


def tag_bytes(head: bytes) -> int:
    """Bytes of the ID3 tag whose first ten are given; 0 if they are of none."""
    if head[:3] != b"ID3" or len(head) < 10:
        return 0
    a, b, c, d = (byte & 0x7F for byte in head[6:10])
    # the size without these 10 bytes, in 4 times 7 bits
    return 10 + (a << 21) + (b << 14) + (c << 7) + d


class Content:
    """Bytes of a file by their places; `first` is that after an ID3 tag."""

    def __init__(self, file: IO[bytes] | Window) -> None:
        self.file, self.size = file, file.seek(0, io.SEEK_END)
        self.first = tag_bytes(self.at(0, 10))

    def at(self, place: int, count: int) -> bytes:
        """Read at most so many bytes from a place on."""
        self.file.seek(place)
        return self.file.read(count)

    def find(self, mark: bytes, start: int) -> Iterator[int]:
        """Places of a text from a place on, at most `MOST_FOUND`."""
        left = MOST_FOUND
        for begin in range(start, self.size, BLOCK_BYTES):
            block = self.at(begin, BLOCK_BYTES + len(mark) - 1)
            place = block.find(mark)
            while place >= 0 and left:
                yield begin + place
                left -= 1
                place = block.find(mark, place + 1)

    def starts(self, demuxer: str, start: int) -> Iterator[int]:
        """Places from a place on where a recording of a format begins."""
        literal, pattern, before = STARTS[demuxer]
        for place in self.find(literal, start):
            first = place - before
            if first >= start and pattern.match(self.at(first, START_BYTES)):
                yield first

    def next_start(self, demuxer: str, start: int) -> int:
        """The first of them; the end of the file if there is none."""
        return next(self.starts(demuxer, start), self.size)


def length_note(found: float, stated: float | None, slack: float = 0.0) -> str:
    """A note on a length in a header that the sound contradicts, seconds; else empty.

    `stated` is None where the header holds a placeholder.
    """
    if stated is None:
        return f"its header holds no length: all of the {found:.2f} s there were read"
    if abs(stated - found) <= slack:
        return ""
    if found < stated <= LONGEST_CUT_SECONDS:
        return f"cut short: {found:.2f} s of {stated:.2f} s are there"
    return f"its header states {stated:.2f} s: all of the {found:.2f} s there were read"
