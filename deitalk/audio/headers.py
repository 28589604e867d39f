"""First bytes of a recording: format, ID3 tag and length."""

import io
import struct
from typing import IO

RECORDINGS = (
    ".wav", ".flac", ".mp3", ".m4a", ".ogg", ".opus", ".aac", ".aif", ".aiff", ".mp4", ".mov",
    ".webm", ".wma",
)  # fmt: skip
"""Suffixes of recordings; a file given by name is recognised by its content, whatever its name."""

MOST_CHUNKS = 1000  # of a wav or aiff file that are searched for its samples
_MPEG_TAGS = (b"\x50\0", b"\x55\0")  # coding of a wav file: layers I to III
# Offset and first bytes -> FFmpeg's demuxer.
_SIGNATURES = (
    (4, b"ftyp", "mov"),  # m4a, mp4, mov, 3gp
    (4, b"moov", "mov"),
    (4, b"mdat", "mov"),
    (4, b"wide", "mov"),
    (0, b"\x1a\x45\xdf\xa3", "matroska"),  # webm, mka, mkv
    (0, b"\x30\x26\xb2\x75", "asf"),  # wma
    (0, b"#!AMR", "amr"),
    (0, b"OggS", "ogg"),
    (0, b"fLaC", "flac"),
    (0, b"caff", "caf"),
    (8, b"AVI ", "avi"),
    (8, b"WAVE", "wav"),
)


def sniff(file: IO[bytes]) -> tuple[str | None, bool]:
    """Format of a file by its first bytes.

    Parameters
    ----------
    file : binary file
        Left at its beginning.

    Returns
    -------
    demuxer : str or None
        Of FFmpeg; None if it does not read the format.
    is_mpeg : bool
        Whether it holds MPEG audio. FFmpeg decodes it to the same samples; libsndfile's decoder
        would print warnings about the file to standard error.
    """
    has_tag = skip_id3(file)
    first = file.read(32)
    file.seek(0)
    if len(first) > 1 and first[0] == 0xFF and first[1] & 0xE0 == 0xE0:
        return ("mp3" if first[1] & 0x06 else "aac"), True  # the layer; 0 is AAC in ADTS
    for offset, mark, demuxer in _SIGNATURES:
        if first[offset : offset + len(mark)] == mark:
            return demuxer, demuxer == "wav" and first[20:22] in _MPEG_TAGS
    return ("mp3", True) if has_tag else (None, False)


def skip_id3(file: IO[bytes]) -> bool:
    """Go to the end of the ID3 tag at the beginning of a file; False and the beginning if none."""
    file.seek(0)
    head = file.read(10)
    has_tag = head[:3] == b"ID3" and len(head) == 10
    a, b, c, d = (byte & 0x7F for byte in head[6:]) if has_tag else (0, 0, 0, 0)
    # the size without these 10 bytes, in 4 times 7 bits
    file.seek(10 + (a << 21) + (b << 14) + (c << 7) + d if has_tag else 0)
    return has_tag


def missing_share(file: IO[bytes]) -> float:
    """Number of samples in a wav or aiff header over the number of samples in the file.

    Parameters
    ----------
    file : binary file
        Left at its beginning.

    Returns
    -------
    float
        1 for a whole file, for another format, and where the length was not known when the header
        was written (nearly all ones, as programs do that write to a pipe).
    """
    head = file.read(12)
    order, mark = {b"RIFF": ("<", b"data"), b"FORM": (">", b"SSND")}.get(head[:4], ("", b""))
    share = 1.0
    for _ in range(MOST_CHUNKS if order else 0):
        chunk = file.read(8)
        if len(chunk) < 8:
            break
        size = int(struct.unpack(f"{order}I", chunk[4:])[0])
        if chunk[:4] == mark:
            here = file.tell()
            left = file.seek(0, io.SEEK_END) - here
            share = size / left if 0 < left < size < 0x7FFFF000 else 1.0
            break
        file.seek(size + size % 2, io.SEEK_CUR)
    file.seek(0)
    return share
