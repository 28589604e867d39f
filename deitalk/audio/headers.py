"""Recordings whose header states how many bytes of samples there are: by the bytes that are there.

The size may be a placeholder of a program that streams, or wrong; what follows the samples tells
whether it is right. Each recording gets a header with the true size.
"""

import re
import struct
from collections.abc import Callable, Iterator
from typing import NamedTuple

from deitalk.audio.content import (
    BLOCK_BYTES,
    CHANNELS,
    RIFF,
    START_BYTES,
    STARTS,
    W64,
    Content,
    Part,
    length_note,
)

MOST_CHUNKS = 1000  # of a header that are searched for its samples
MOST_STEPS = 20_000  # over chunks after samples of unknown length
TAIL_BYTES = 1 << 20  # searched for chunks after samples of unknown length
UNKNOWN_BYTES = 0x7FFF0000  # such sizes and larger ones are placeholders of programs that stream

_LATER_CHUNKS = (
    b"LIST", b"id3 ", b"ID3 ", b"bext", b"iXML", b"cue ", b"smpl", b"fact", b"PEAK", b"JUNK",
    b"junk", b"axml", b"inst", b"plst", b"_PMX", b"umid", b"afsp", b"DISP", b"FLLR", b"PAD ",
    b"minf", b"elm1", b"regn", b"link", b"levl", b"chna", b"NAME", b"AUTH", b"ANNO", b"MARK",
    b"INST", b"COMT", b"APPL", b"CHAN", b"info", b"strg", b"mark", b"free", b"uuid", b"peak",
)  # fmt: skip
_TAGS = (b"ID3", b"TAG", b"APETAGEX")
_PCM_CODES = (1, 3, 6, 7, 0xFFFE)  # integers, floats, A-law, mu-law, extensible
_AIFF_BYTES = {b"ulaw": 1, b"alaw": 1, b"ULAW": 1, b"ALAW": 1}
_AIFF_PLAIN = (
    b"NONE", b"sowt", b"twos", b"fl32", b"FL32", b"fl64", b"FL64", b"raw ", b"in24", b"in32",
    b"42ni", b"23ni",
)  # fmt: skip
_AU_BYTES = {1: 1, 2: 1, 3: 2, 4: 3, 5: 4, 6: 4, 7: 8, 27: 1}


class Chunks(NamedTuple):
    """Layout of the chunks of a format."""

    id_bytes: int
    size: struct.Struct
    counts_head: bool
    align: int

    def step(self, content: Content, place: int) -> tuple[bytes, int, int] | None:
        """Name, first byte of the content, and size of the chunk at a place; None without one."""
        head = content.at(place, self.id_bytes + self.size.size)
        if len(head) < self.id_bytes + self.size.size:
            return None
        size = int(self.size.unpack(head[self.id_bytes :])[0])
        if self.counts_head:
            size -= len(head)
        return head[: self.id_bytes], place + len(head), size

    def after(self, begin: int, size: int) -> int:
        """The place after a content of some bytes."""
        return begin + size + -size % self.align

    def walk(
        self, content: Content, place: int, samples: bytes, wanted: dict[bytes, int]
    ) -> tuple[dict[bytes, bytes], int, int]:
        """Contents of chunks from a place on, and first byte and size of the samples after them.

        Of the chunks `wanted`, by their names, at most so many bytes. The first byte is 0 where
        there is no chunk of the name of the samples.
        """
        found: dict[bytes, bytes] = {}
        for _ in range(MOST_CHUNKS):
            step = self.step(content, place)
            if step is None:
                break
            name, begin, size = step
            if name == samples:
                return found, begin, size
            if name in wanted:
                found[name] = content.at(begin, min(max(size, 0), wanted[name]))
            if size < 0:
                break
            place = self.after(begin, size)
        return found, 0, 0


RIFF_CHUNKS = Chunks(4, struct.Struct("<I"), False, 2)
_FORM_CHUNKS = Chunks(4, struct.Struct(">I"), False, 2)
_CAF_CHUNKS = Chunks(4, struct.Struct(">q"), False, 1)
_W64_CHUNKS = Chunks(16, struct.Struct("<q"), True, 8)


class _Header(NamedTuple):
    """Content of a recording's header, and a function that writes one of another length."""

    begin: int
    """First byte of the samples."""
    claimed: int
    """Bytes of samples; negative or very many where they were not known."""
    byte_rate: float
    """Bytes a second; 0 if unknown."""
    chunks: Chunks | None
    """What may follow the samples."""
    made: Callable[[int, bool], bytes]
    """Header for a number of bytes; with what counts samples if the old number holds."""
    layout: tuple[str, ...] = ()
    samples: int = 0


def with_headers(content: Content, demuxer: str) -> Iterator[Part]:
    """Recordings of a format in `READERS`, one after another."""
    place = content.first
    while place < content.size:
        header = READERS[demuxer](content, place)
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


def _extent(content: Content, demuxer: str, header: _Header) -> tuple[int, int, bool]:
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


def _following(content: Content, demuxer: str, header: _Header, stop: int) -> int | None:
    """Place at which the next recording begins after samples, chunks and tags.

    None if there is what looks like more samples.
    """
    aligned = header.chunks.after(header.begin, header.claimed) if header.chunks else stop
    pattern = STARTS[demuxer][1]
    for place in dict.fromkeys((aligned, stop)):
        is_chunk = place >= content.size - 7
        for _ in range(MOST_CHUNKS):
            if place >= content.size - 7:
                break
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


def _without_chunks(content: Content, header: _Header, end: int) -> int:
    """End of samples before `end` without the chunks that lead exactly to it."""
    if header.chunks is None:
        return end
    begin = max(header.begin, end - TAIL_BYTES)
    tail = content.at(begin, end - begin)
    steps = 0
    for found in re.finditer(b"|".join(map(re.escape, _LATER_CHUNKS)), tail):
        place = begin + found.start()
        while place < end - 7 and steps < MOST_STEPS:
            steps += 1
            step = header.chunks.step(content, place)
            if step is None or not _is_name(step[0]) or step[2] < 0:
                break
            place = header.chunks.after(*step[1:])
        if -8 < place - end <= 1 and place > begin + found.start():
            return begin + found.start()
    return end


def _riff(content: Content, at: int) -> _Header | None:
    """Header of a RIFF, RF64 or BW64 file (EBU Tech 3306)."""
    if not RIFF[1].match(content.at(at, 12)):
        return None
    wanted = {b"ds64": 16, b"fmt ": 4096, b"fact": 64}
    found, begin, size = RIFF_CHUNKS.walk(content, at + 12, b"data", wanted)
    form = found.get(b"fmt ", b"")
    if size == 0xFFFFFFFF and b"ds64" in found:
        (size,) = struct.unpack("<8xQ", found[b"ds64"].ljust(16, b"\0"))
    if not begin or len(form) < 16:
        return None
    return _wave(form, found.get(b"fact", b""), begin, size, RIFF_CHUNKS)


def _w64(content: Content, at: int) -> _Header | None:
    """Header of a Sony Wave64 file, whose chunks are those of a WAV with longer names."""
    found, begin, size = _W64_CHUNKS.walk(content, at + 40, W64["data"], {W64["fmt "]: 4096})
    form = found.get(W64["fmt "], b"")
    return _wave(form, b"", begin, size, _W64_CHUNKS) if begin and len(form) >= 16 else None


def _wave(form: bytes, fact: bytes, begin: int, claimed: int, chunks: Chunks) -> _Header:
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


def _aiff(content: Content, at: int) -> _Header | None:
    """Header of an AIFF or AIFC file; None where its format stands after its samples."""
    form = content.at(at, 12)
    found, begin, size = _FORM_CHUNKS.walk(content, at + 12, b"SSND", {b"COMM": 512})
    common = found.get(b"COMM", b"")
    if not begin or len(common) < 18:
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


def _au(content: Content, at: int) -> _Header | None:
    head = content.at(at, 24)
    if len(head) < 24:
        return None
    length, claimed, code, rate, channels = struct.unpack(">IIIII", head[4:])
    width = _AU_BYTES.get(code, 0) * channels
    whole = content.at(at, min(length, TAIL_BYTES))

    def made(n_bytes: int, is_true: bool) -> bytes:
        return whole[:8] + struct.pack(">I", min(n_bytes, 0xFFFFFFFF)) + whole[12:]

    return _Header(at + length, claimed, width * rate, None, made)


def _caf(content: Content, at: int) -> _Header | None:
    """Header of a CAF file; None of coded sound, whose packets may be listed after it."""
    found, begin, size = _CAF_CHUNKS.walk(content, at + 8, b"data", {b"desc": 32})
    form = found.get(b"desc", b"").ljust(32, b"\0")
    rate, kind, _, width = struct.unpack(">d4sII", form[:20])
    if not begin or (found and kind not in (b"lpcm", b"ulaw", b"alaw")):
        return None
    before = content.at(at, min(begin - 8 - at, TAIL_BYTES)) + b""
    edits = content.at(begin, 4)

    def made(n_bytes: int, is_true: bool) -> bytes:
        return before + struct.pack(">q", n_bytes + 4) + edits

    return _Header(begin + 4, size - 4, width * rate, _CAF_CHUNKS, made)


READERS = {"wav": _riff, "w64": _w64, "aiff": _aiff, "au": _au, "caf": _caf}
