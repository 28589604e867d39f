"""Recordings in one file: where each begins and ends, by the bytes that are there.

A file may hold several recordings one after another (joined WAVs, chained Ogg, sentences of a
speech server), and the length in a header may be a placeholder or wrong. WAV, RF64, W64, AIFF, AU
and CAF get a header with the true length; other formats hold none that matters.
"""

import io
import re
import struct
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import IO, NamedTuple

from deitalk.errors import AudioError

MOST_PARTS = 1000
"""Recordings in one file."""
MOST_CHUNKS = 1000  # of a header that are searched for its samples
MOST_BOXES = 500_000  # of a movie
TAIL_BYTES = 1 << 20  # searched for chunks after samples of unknown length
BLOCK_BYTES = 1 << 22
LONGEST_CUT_SECONDS = 3 * 3600.0  # a longer length in a header is no sound that was cut off
UNKNOWN_BYTES = 0x7FFF0000  # such sizes and larger ones are placeholders of programs that stream

_LATER_CHUNKS = (
    b"LIST", b"id3 ", b"ID3 ", b"bext", b"iXML", b"cue ", b"smpl", b"fact", b"PEAK", b"JUNK",
    b"junk", b"axml", b"inst", b"plst", b"_PMX", b"umid", b"afsp", b"DISP", b"FLLR", b"PAD ",
    b"minf", b"elm1", b"regn", b"link", b"levl", b"chna", b"NAME", b"AUTH", b"ANNO", b"MARK",
    b"INST", b"COMT", b"APPL", b"CHAN", b"info", b"strg", b"mark", b"free", b"uuid", b"peak",
)  # fmt: skip
CHANNELS = (
    "FL", "FR", "FC", "LFE", "BL", "BR", "FLC", "FRC", "BC", "SL", "SR", "TC", "TFL", "TFC", "TFR",
    "TBL", "TBC", "TBR",
)  # fmt: skip
"""Of the mask of a WAV, from its lowest bit on; FFmpeg's names."""
_TAGS = (b"ID3", b"TAG", b"APETAGEX")
_PCM_CODES = (1, 3, 6, 7, 0xFFFE)  # integers, floats, A-law, mu-law, extensible
_AIFF_BYTES = {b"ulaw": 1, b"alaw": 1, b"ULAW": 1, b"ALAW": 1}
_AIFF_PLAIN = (
    b"NONE", b"sowt", b"twos", b"fl32", b"FL32", b"fl64", b"FL64", b"raw ", b"in24", b"in32",
    b"42ni", b"23ni",
)  # fmt: skip
_AU_BYTES = {1: 1, 2: 1, 3: 2, 4: 3, 5: 4, 6: 4, 7: 8, 27: 1}
_W64 = {
    name: name.encode() + bytes.fromhex(rest)
    for name, rest in {
        "riff": "2e91cf11a5d628db04c10000",
        "wave": "f3acd3118cd100c04f8edb8a",
        "fmt ": "f3acd3118cd100c04f8edb8a",
        "data": "f3acd3118cd100c04f8edb8a",
    }.items()
}

# First bytes of a recording of each format, after a literal that is searched for.
_RIFF = (b"WAVE", re.compile(rb"(RIFF|RF64|BW64)....WAVE", re.DOTALL), 8)
_STARTS = {
    "wav": _RIFF,
    "w64": (_W64["riff"], re.compile(re.escape(_W64["riff"])), 0),
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
START_BYTES = 64


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
        """At most `count` bytes from the position on."""
        left = self.size - self.place
        count = left if count < 0 else min(count, left)
        if count <= 0:
            return b""
        data = self.part.head[self.place : self.place + count]
        if len(data) < count:
            self.file.seek(self.part.start + self.place + len(data) - len(self.part.head))
            data += self.file.read(count - len(data))
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


def parts_of(file: IO[bytes], demuxer: str | None) -> list[Part]:
    """Recordings of a file, one after another; one of the whole file where it is of no such format.

    Parameters
    ----------
    file : binary file
        Its position is changed.
    demuxer : str or None
        The format, of `deitalk.audio.formats.sniff`.

    Raises
    ------
    AudioError
        If there are more than `MOST_PARTS`.
    """
    content = _Content(file)
    find = _FINDERS.get(demuxer or "", _found_starts)
    parts = []
    for part in find(content, demuxer or ""):
        parts.append(part)
        if len(parts) > MOST_PARTS:
            raise AudioError(
                f"more than {MOST_PARTS} recordings one after another in one file; write one "
                "header for all of them"
            )
    return parts or [Part(0, content.size)]


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


class _Content:
    """Bytes of a file by their places."""

    def __init__(self, file: IO[bytes] | Window) -> None:
        self.file, self.size = file, file.seek(0, io.SEEK_END)

    def at(self, place: int, count: int) -> bytes:
        self.file.seek(place)
        return self.file.read(count)

    def find(self, mark: bytes, start: int) -> Iterator[int]:
        """Places of a text from a place on."""
        for begin in range(start, self.size, BLOCK_BYTES):
            block = self.at(begin, BLOCK_BYTES + len(mark) - 1)
            place = block.find(mark)
            while place >= 0:
                yield begin + place
                place = block.find(mark, place + 1)

    def starts(self, demuxer: str, start: int) -> Iterator[int]:
        """Places from a place on where a recording of a format begins."""
        literal, pattern, before = _STARTS[demuxer]
        for place in self.find(literal, start):
            first = place - before
            if first >= start and pattern.match(self.at(first, START_BYTES)):
                yield first

    def next_start(self, demuxer: str, start: int) -> int:
        """The first of them; the end of the file if there is none."""
        return next(self.starts(demuxer, start), self.size)


def _found_starts(content: _Content, demuxer: str) -> Iterator[Part]:
    """Parts from each beginning of a recording to the next."""
    starts = list(_limited(content.starts(demuxer, 1))) if demuxer in _STARTS else []
    yield from _between([0, *starts, content.size])


def _between(places: list[int]) -> Iterator[Part]:
    yield from (Part(*pair) for pair in pairwise(places))


def _limited(places: Iterator[int]) -> Iterator[int]:
    """Places, not many more than may be."""
    return (place for place, _ in zip(places, range(MOST_PARTS + 1), strict=False))


def _ogg(content: _Content, demuxer: str) -> Iterator[Part]:
    """Links of a chained Ogg: each begins with one or more first pages (RFC 3533)."""
    starts, end = [], -1
    for place in content.find(b"OggS\0\x02", 0):
        page = content.at(place, 27 + 255)
        if place != end:
            starts.append(place)
            if len(starts) > MOST_PARTS + 1:
                break
        count = page[26] if len(page) > 26 else 0
        end = place + 27 + count + sum(page[27 : 27 + count])
    yield from _between([*starts, content.size] if starts else [0, content.size])


def _boxes(content: _Content) -> Iterator[tuple[int, bytes]]:
    """Place and name of each box of a movie (ISO 14496-12)."""
    place = 0
    for _ in range(MOST_BOXES):
        head = content.at(place, 16)
        if len(head) < 8:
            return
        size, name = struct.unpack(">I4s", head[:8])
        yield place, name
        if size == 1 and len(head) == 16:
            (size,) = struct.unpack(">Q", head[8:])
        if size < 8 or place + size >= content.size:
            return
        place += size


def _movies(content: _Content, demuxer: str) -> Iterator[Part]:
    """Movies one after another: a box `ftyp` after a `moov` begins the next."""
    starts, has_movie = [0], False
    for place, name in _boxes(content):
        if name == b"ftyp" and has_movie:
            starts.append(place)
            has_movie = False
        has_movie = has_movie or name == b"moov"
    yield from _between([*starts, content.size])


def has_fragments(file: IO[bytes] | Window) -> bool:
    """Whether a movie is one of fragments, whose time may begin anywhere."""
    return any(name == b"moof" for _, name in _boxes(_Content(file)))


# MPEG audio has no header; the first frame of an encoder's file counts the others.


_MPEG_COUNTS = (b"Xing", b"Info", b"VBRI")
_COUNT_PLACES = (
    36,
    21,
    13,
)  # in the first frame: MPEG-1 stereo, mono or MPEG-2 stereo, MPEG-2 mono


def _mpeg(content: _Content, demuxer: str) -> Iterator[Part]:
    """MPEG recordings that begin with a frame of counts, each with the tag before it."""
    starts = []
    for mark in _MPEG_COUNTS:
        for place in content.find(mark, 0):
            frames = (place - back for back in _COUNT_PLACES if place >= back)
            first = next((at for at in frames if _is_count_frame(content, at, place)), None)
            if first is not None:
                starts.append(_before_tag(content, first))
            if len(starts) > MOST_PARTS + 1:
                break
    starts.sort()
    sound = tag_bytes(content.at(0, 10))
    if starts and (starts[0] <= sound or content.at(sound, 1) != b"\xff"):
        starts[0] = 0  # of the first recording
    yield from _between([0, *(place for place in starts if place), content.size])


def _is_count_frame(content: _Content, first: int, mark: int) -> bool:
    """Whether an MPEG frame that is empty up to a mark begins at a place."""
    head = content.at(first, mark - first)
    is_sync = head[0] == 0xFF and head[1] & 0xE6 == 0xE2 and head[2] & 0xF0 not in (0, 0xF0)
    return is_sync and not any(head[4:])


def _before_tag(content: _Content, place: int) -> int:
    """The place of the ID3 tag that ends at a place; that place if there is none."""
    begin = max(0, place - TAIL_BYTES)
    block = content.at(begin, place - begin)
    at = block.rfind(b"ID3")
    while at >= 0:
        if at + tag_bytes(block[at : at + 10]) == len(block):
            return begin + at
        at = block.rfind(b"ID3", 0, at)
    return place


def tag_bytes(head: bytes) -> int:
    """Bytes of the ID3 tag whose first ten are given; 0 if they are of none."""
    if head[:3] != b"ID3" or len(head) < 10:
        return 0
    a, b, c, d = (byte & 0x7F for byte in head[6:10])
    # the size without these 10 bytes, in 4 times 7 bits
    return 10 + (a << 21) + (b << 14) + (c << 7) + d


# Formats whose header states how many bytes of samples there are.


class _Chunks(NamedTuple):
    """How chunks of a format are written."""

    id_bytes: int
    size: struct.Struct
    counts_head: bool
    align: int

    def step(self, content: _Content, place: int) -> tuple[bytes, int, int] | None:
        """Name, first byte of the content, and size of the chunk at a place; None without one."""
        head = content.at(place, self.id_bytes + self.size.size)
        if len(head) < self.id_bytes + self.size.size:
            return None
        size = int(self.size.unpack(head[self.id_bytes :])[0])
        if self.counts_head:
            size -= len(head)
        return head[: self.id_bytes], place + len(head), size

    def after(self, begin: int, size: int) -> int:
        return begin + size + -size % self.align


_RIFF_CHUNKS = _Chunks(4, struct.Struct("<I"), False, 2)
_FORM_CHUNKS = _Chunks(4, struct.Struct(">I"), False, 2)
_CAF_CHUNKS = _Chunks(4, struct.Struct(">q"), False, 1)
_W64_CHUNKS = _Chunks(16, struct.Struct("<q"), True, 8)


class _Header(NamedTuple):
    """What the header of a recording says, and how one of another length is written."""

    begin: int
    """First byte of the samples."""
    claimed: int
    """Bytes of samples; negative or very many where they were not known."""
    byte_rate: float
    """Bytes a second; 0 if unknown."""
    chunks: _Chunks | None
    """What may follow the samples."""
    made: Callable[[int, bool], bytes]
    """Header for a number of bytes; with what counts samples if the old number holds."""
    layout: tuple[str, ...] = ()
    samples: int = 0


def _with_headers(content: _Content, demuxer: str) -> Iterator[Part]:
    place = 0
    while place < content.size:
        header = _READERS[demuxer](content, place)
        if header is None:
            following = content.next_start(demuxer, place + 1)
            yield Part(place, following)
            place = following
            continue
        stop, following, is_true = _extent(content, demuxer, header)
        note = "" if is_true else _note(header, stop)
        head = header.made(stop - header.begin, is_true)
        samples = header.samples if is_true else 0
        yield Part(header.begin, stop, head, note, header.layout, samples)
        place = following


def _note(header: _Header, stop: int) -> str:
    rate = header.byte_rate
    if not rate or stop == header.begin + header.claimed:
        return ""
    is_known = 0 < header.claimed < UNKNOWN_BYTES
    return length_note((stop - header.begin) / rate, header.claimed / rate if is_known else None)


def _extent(content: _Content, demuxer: str, header: _Header) -> tuple[int, int, bool]:
    """End of the samples, beginning of the next recording, whether the header is right.

    It is where the bytes after its samples are no sound: the end of the file, chunks, a recording.
    """
    stop = header.begin + header.claimed
    if header.claimed >= 0 and stop <= content.size:
        following = _following(content, demuxer, header, stop)
        if following is not None:
            return stop, following, True
    following = content.next_start(demuxer, header.begin)
    return _without_chunks(content, header, following), following, False


def _following(content: _Content, demuxer: str, header: _Header, stop: int) -> int | None:
    """Where the next recording begins after samples that end at a place, over chunks and tags.

    None if there is what looks like more samples.
    """
    aligned = header.chunks.after(header.begin, header.claimed) if header.chunks else stop
    pattern = _STARTS[demuxer][1]
    for place in dict.fromkeys((aligned, stop)):
        is_chunk = place >= content.size - 7
        while place < content.size - 7:
            if pattern.match(content.at(place, START_BYTES)):
                return place
            step = header.chunks.step(content, place) if header.chunks else None
            if step is None or not _is_name(step[0]) or step[2] < 0:
                break
            whole = header.chunks.after(*step[1:])  # type: ignore[union-attr]
            is_chunk = is_chunk or step[0][:4] in _LATER_CHUNKS or whole >= content.size > whole - 8
            if step[1] + step[2] > content.size:
                break
            place = whole
        if is_chunk:
            return content.size
    rest = content.at(stop, BLOCK_BYTES)
    return content.size if rest.startswith(_TAGS) or (header.claimed and not any(rest)) else None


def _is_name(name: bytes) -> bool:
    return all(0x20 <= byte < 0x7F for byte in name[:4])


def _without_chunks(content: _Content, header: _Header, end: int) -> int:
    """End of samples before `end` without the chunks that lead exactly to it."""
    if header.chunks is None:
        return end
    begin = max(header.begin, end - TAIL_BYTES)
    tail = content.at(begin, end - begin)
    for found in re.finditer(b"|".join(map(re.escape, _LATER_CHUNKS)), tail):
        place = begin + found.start()
        while place < end - 7:
            step = header.chunks.step(content, place)
            if step is None or not _is_name(step[0]) or step[2] < 0:
                break
            place = header.chunks.after(*step[1:])
        if -8 < place - end <= 1 and place > begin + found.start():
            return begin + found.start()
    return end


def _riff(content: _Content, at: int) -> _Header | None:
    """Header of a RIFF, RF64 or BW64 file (EBU Tech 3306)."""
    place, form, fact, long = at + 12, b"", b"", -1
    if not _RIFF[1].match(content.at(at, 12)):
        return None
    for _ in range(MOST_CHUNKS):
        step = _RIFF_CHUNKS.step(content, place)
        if step is None:
            return None
        name, begin, size = step
        if name == b"data":
            break
        if name == b"ds64":
            (long,) = struct.unpack("<8xQ", content.at(begin, 16).ljust(16, b"\0"))
        elif name == b"fmt ":
            form = content.at(begin, min(size, 4096))
        elif name == b"fact":
            fact = content.at(begin, min(size, 64))
        place = _RIFF_CHUNKS.after(begin, size)
    else:
        return None
    claimed = long if size == 0xFFFFFFFF and long >= 0 else size
    return None if len(form) < 16 else _wave(form, fact, begin, claimed, _RIFF_CHUNKS)


def _w64(content: _Content, at: int) -> _Header | None:
    """Header of a Sony Wave64 file, whose chunks are those of a WAV with longer names."""
    place, form = at + 40, b""
    for _ in range(MOST_CHUNKS):
        step = _W64_CHUNKS.step(content, place)
        if step is None:
            return None
        name, begin, size = step
        if name == _W64["data"]:
            return None if len(form) < 16 else _wave(form, b"", begin, size, _W64_CHUNKS)
        if name == _W64["fmt "]:
            form = content.at(begin, min(max(size, 0), 4096))
        if size < 0:
            return None
        place = _W64_CHUNKS.after(begin, size)
    return None


def _wave(form: bytes, fact: bytes, begin: int, claimed: int, chunks: _Chunks) -> _Header:
    code, _, rate, byte_rate, block = struct.unpack("<HHIIH", form[:14])

    def made(n_bytes: int, is_true: bool) -> bytes:
        parts = {b"fmt ": form} | ({b"fact": fact} if fact and is_true else {})
        body = b"".join(
            name + struct.pack("<I", len(data)) + data + bytes(len(data) % 2)
            for name, data in parts.items()
        )
        whole = 4 + len(body) + 8 + n_bytes
        if whole <= 0xFFFFFFFF:
            size = struct.pack("<I", n_bytes)
            return b"RIFF" + struct.pack("<I", whole) + b"WAVE" + body + b"data" + size
        long = b"ds64" + struct.pack("<IQQQI", 28, whole + 36, n_bytes, 0, 0)
        return b"RF64\xff\xff\xff\xffWAVE" + long + body + b"data\xff\xff\xff\xff"

    byte_rate = rate * block if code in _PCM_CODES else byte_rate
    samples = 0 if code in _PCM_CODES else int.from_bytes(fact[:4], "little")
    return _Header(begin, claimed, byte_rate, chunks, made, _layout(code, form), samples)


def _layout(code: int, form: bytes) -> tuple[str, ...]:
    """Names of channels by the mask of an extensible WAV; none if it does not name all."""
    if code != _PCM_CODES[-1] or len(form) < 24:
        return ()
    mask = int.from_bytes(form[20:24], "little")
    names = tuple(name for bit, name in enumerate(CHANNELS) if mask >> bit & 1)
    return names if len(names) == int.from_bytes(form[2:4], "little") else ()


def _aiff(content: _Content, at: int) -> _Header | None:
    """Header of an AIFF or AIFC file; None where its format stands after its samples."""
    form, place, common = content.at(at, 12), at + 12, b""
    for _ in range(MOST_CHUNKS):
        step = _FORM_CHUNKS.step(content, place)
        if step is None:
            return None
        name, begin, size = step
        if name == b"SSND":
            break
        if name == b"COMM":
            common = content.at(begin, min(size, 512))
        place = _FORM_CHUNKS.after(begin, size)
    else:
        return None
    if len(common) < 18:
        return None
    channels, _, bits, exponent, mantissa = struct.unpack(">HIHHQ", common[:18])
    kind = common[18:22] or b"NONE"
    width = _AIFF_BYTES.get(kind, -(-bits // 8) if kind in _AIFF_PLAIN else 0) * channels
    rate = mantissa * 2.0 ** ((exponent & 0x7FFF) - 16383 - 63)
    offset = content.at(begin, 8)

    def made(n_bytes: int, is_true: bool) -> bytes:
        frames = struct.pack(">I", min(n_bytes // width, 0xFFFFFFFF)) if width else common[2:6]
        body = b"COMM" + struct.pack(">I", len(common)) + common[:2] + frames + common[6:]
        body += bytes(len(common) % 2)
        body += b"SSND" + struct.pack(">I", min(n_bytes + 8, 0xFFFFFFFF)) + offset
        whole = min(4 + len(body) + n_bytes, 0xFFFFFFFF)
        return b"FORM" + struct.pack(">I", whole) + form[8:] + body

    return _Header(begin + 8, size - 8, width * rate, _FORM_CHUNKS, made)


def _au(content: _Content, at: int) -> _Header | None:
    head = content.at(at, 24)
    if len(head) < 24:
        return None
    length, claimed, code, rate, channels = struct.unpack(">IIIII", head[4:])
    width = _AU_BYTES.get(code, 0) * channels
    whole = content.at(at, min(length, TAIL_BYTES))

    def made(n_bytes: int, is_true: bool) -> bytes:
        return whole[:8] + struct.pack(">I", min(n_bytes, 0xFFFFFFFF)) + whole[12:]

    return _Header(at + length, claimed, width * rate, None, made)


def _caf(content: _Content, at: int) -> _Header | None:
    """Header of a CAF file; None of coded sound, whose packets may be listed after it."""
    place, rate, width = at + 8, 0.0, 0
    for _ in range(MOST_CHUNKS):
        step = _CAF_CHUNKS.step(content, place)
        if step is None:
            return None
        name, begin, size = step
        if name == b"data":
            break
        if name == b"desc":
            form = content.at(begin, 32).ljust(32, b"\0")
            rate, kind, _, width = struct.unpack(">d4sII", form[:20])
            if kind not in (b"lpcm", b"ulaw", b"alaw"):
                return None
        if size < 0:
            return None
        place = _CAF_CHUNKS.after(begin, size)
    else:
        return None
    before = content.at(at, min(begin - 8 - at, TAIL_BYTES)) + b""
    edits = content.at(begin, 4)

    def made(n_bytes: int, is_true: bool) -> bytes:
        return before + struct.pack(">q", n_bytes + 4) + edits

    return _Header(begin + 4, size - 4, width * rate, _CAF_CHUNKS, made)


_READERS = {"wav": _riff, "w64": _w64, "aiff": _aiff, "au": _au, "caf": _caf}
_FINDERS: dict[str, Callable[[_Content, str], Iterator[Part]]] = {
    **dict.fromkeys(_READERS, _with_headers), "ogg": _ogg, "mov": _movies, "mp3": _mpeg,
}  # fmt: skip
