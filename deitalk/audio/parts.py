"""Recordings in one file: where each begins and ends, by the bytes that are there.

A file may hold several recordings one after another (joined WAVs, chained Ogg, sentences of a
speech server), and the length in a header may be a placeholder or wrong. WAV, RF64, W64, AIFF, AU
and CAF get a header with the true length (`deitalk.audio.headers`).
"""

import struct
from collections.abc import Callable, Iterator
from itertools import islice, pairwise
from typing import IO

from deitalk.audio.content import STARTS, Content, Part, Window, tag_bytes
from deitalk.audio.headers import READERS, TAIL_BYTES, with_headers
from deitalk.errors import AudioError

MOST_PARTS = 1000
"""Recordings in one file."""
MOST_BOXES = 200_000  # of a movie
MOST_MARKS = 100  # of a tag that are looked at before a recording


def parts_of(file: IO[bytes], demuxer: str | None) -> list[Part]:
    """Recordings of a file, one after another; one of the whole file where it is of no such format.

    Parameters
    ----------
    file : binary file
        Its position is changed.
    demuxer : str or None
        The format, of `deitalk.audio.decoding.sniff`.

    Raises
    ------
    AudioError
        If there are more than `MOST_PARTS`.
    """
    content = Content(file)
    if demuxer in _FINDERS:
        found = _FINDERS[demuxer](content, demuxer)
    else:  # from each beginning of a recording to the next
        first = content.first if demuxer in STARTS else 0
        starts = content.starts(demuxer, first + 1) if demuxer in STARTS else iter(())
        found = _between([first, *islice(starts, MOST_PARTS + 1), content.size])
    parts = []
    for part in found:
        parts.append(part)
        if len(parts) > MOST_PARTS:
            raise AudioError(
                f"more than {MOST_PARTS} recordings one after another in one file; write one "
                "header for all of them"
            )
    return parts or [Part(0, content.size)]


def _between(places: list[int]) -> Iterator[Part]:
    yield from (Part(*pair) for pair in pairwise(places))


def _ogg(content: Content, demuxer: str) -> Iterator[Part]:
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


def _boxes(content: Content) -> Iterator[tuple[int, bytes]]:
    """Place and name of each box of a movie (ISO 14496-12)."""
    place = content.first
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


def _movies(content: Content, demuxer: str) -> Iterator[Part]:
    """Movies one after another: a box `ftyp` after a `moov` begins the next."""
    starts, has_movie = [content.first], False
    for place, name in _boxes(content):
        if name == b"ftyp" and has_movie:
            starts.append(place)
            has_movie = False
        has_movie = has_movie or name == b"moov"
    yield from _between([*starts, content.size])


def has_fragments(file: IO[bytes] | Window) -> bool:
    """Whether a movie is one of fragments, whose time may begin anywhere."""
    return any(name == b"moof" for _, name in _boxes(Content(file)))


_MPEG_COUNTS = (b"Xing", b"Info", b"VBRI")
_COUNT_PLACES = (36, 21, 13)
"""Places in the first frame: of MPEG-1 stereo, mono or MPEG-2 stereo, MPEG-2 mono."""


def _mpeg(content: Content, demuxer: str) -> Iterator[Part]:
    """MPEG recordings that begin with a frame of counts, each with the tag before it.

    MPEG audio has no header; the first frame of an encoder's file counts the others.
    """
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
    if starts and (starts[0] <= content.first or content.at(content.first, 1) != b"\xff"):
        starts[0] = 0  # of the first recording
    yield from _between([0, *(place for place in starts if place), content.size])


def _is_count_frame(content: Content, first: int, mark: int) -> bool:
    """Whether an MPEG frame that is empty up to a mark begins at a place."""
    head = content.at(first, mark - first)
    is_sync = head[0] == 0xFF and head[1] & 0xE6 == 0xE2 and head[2] & 0xF0 not in (0, 0xF0)
    return is_sync and not any(head[4:])


def _before_tag(content: Content, place: int) -> int:
    """The place of the ID3 tag that ends at a place; that place if there is none."""
    begin = max(0, place - TAIL_BYTES)
    block = content.at(begin, place - begin)
    at = len(block)
    for _ in range(MOST_MARKS):
        at = block.rfind(b"ID3", 0, max(at, 0))
        if at >= 0 and at + tag_bytes(block[at : at + 10]) == len(block):
            return begin + at
    return place


_FINDERS: dict[str, Callable[[Content, str], Iterator[Part]]] = {
    **dict.fromkeys(READERS, with_headers), "ogg": _ogg, "mov": _movies, "mp3": _mpeg,
}  # fmt: skip
