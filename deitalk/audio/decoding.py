"""Sound from a file: libsndfile for the formats it supports, FFmpeg's libraries otherwise.

The decoder is chosen by the first bytes. A file may hold several recordings one after another and
a recording several tracks; what is read is one signal in its time (`deitalk.audio.parts`,
`deitalk.audio.ffmpeg`).

Letters: n samples of a block at the file's rate, C channels.
"""

import hashlib
import io
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import IO, Any, Protocol

import numpy as np

from deitalk.audio.choice import ENCODINGS, AudioChoice, RawFormat
from deitalk.audio.content import Content, Part, Window
from deitalk.audio.ffmpeg import FFmpegReader, Piece
from deitalk.audio.parts import parts_of
from deitalk.errors import AudioError
from deitalk.signals import held
from rig.arrays import Float32

RECORDINGS = (
    ".wav", ".flac", ".mp3", ".m4a", ".ogg", ".opus", ".aac", ".aif", ".aiff", ".mp4", ".mov",
    ".webm", ".wma", ".mkv", ".mka", ".oga", ".amr", ".3gp", ".caf", ".w64", ".rf64", ".au",
)  # fmt: skip
"""Suffixes of recordings; a file given by name is recognised by its content, whatever its name."""

_MPEG_CODES = (b"\x50\0", b"\x55\0")  # coding of a wav file: layers I to III
_CODE_PLACE = slice(20, 22)  # of the coding in the header that a wav file gets
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
    (0, b"FLV\x01", "flv"),
    (0, b".snd", "au"),
    (8, b"AVI ", "avi"),
    (8, b"WAVE", "wav"),
    (0, b"riff\x2e\x91\xcf\x11", "w64"),
    (8, b"AIFF", "aiff"),
    (8, b"AIFC", "aiff"),
)
_TS_PLACES = ((0, 188, 376), (4, 196, 388))  # of the first bytes of packets of a transport stream
MOST_PADDING = 8192  # samples of a coded WAV's last block
SHORT_SECONDS = 60.0
"""Longest FLAC that is read at once."""
_FLAC_CHECKSUM = slice(26, 42)
"""MD5 of the samples, at the end of the first block of metadata (RFC 9639, section 8.2)."""
_FLAC_LAYOUTS = {1: ("FC",), 2: ("FL", "FR")}
_BY_SNDFILE = ("wav", "w64", "aiff", "au", "caf")
"""Formats that libsndfile reads first, of those that FFmpeg reads as well."""
KNOWN = "wav, flac, ogg, opus, mp3, m4a, mp4, mov, webm, aac or wma"
_NOT_AUDIO = (
    f"{{}} is not audio that can be read; give a {KNOWN} file, or name the form of samples without "
    "a header: `raw=s16le,24000,1`"
)
_MPEG_ENDINGS = (".mp3", ".mp2", ".mpga")


class SoundSource(Protocol):
    """An open recording.

    Attributes
    ----------
    rate, channels : int
        Hz and C.
    layout : tuple of str
        Names of the channels, such as FL, FR and FC; empty where they are not known.
    expected : int
        Samples per channel that the file can hold by its header; 0 where that holds no length.
    notes : list of str
        What `blocks` corrected, or replaced by silence.
    tracks : tuple of str
        Titles of the sound tracks; an empty one for each without.
    track : int
        Number of the one that is read, from 1 on.
    """

    rate: int
    channels: int
    layout: tuple[str, ...]
    expected: int
    notes: list[str]
    tracks: tuple[str, ...]
    track: int

    def blocks(self, size: int) -> Iterator[Float32]:
        """Blocks (n, C) of about `size` samples, from the beginning to the end."""
        ...

    def on(self, track: int) -> "SoundSource":
        """Open the same recording on another track."""
        ...


def sniff(file: IO[bytes]) -> str | None:
    """Format of a file by its first bytes: a demuxer of FFmpeg; None if it does not read it."""
    content = Content(file)
    first = content.at(content.first, 400)
    if len(first) > 1 and first[0] == 0xFF and first[1] & 0xE0 == 0xE0:
        return "mp3" if first[1] & 0x06 else "aac"  # the layer; 0 is AAC in ADTS
    for offset, mark, demuxer in _SIGNATURES:
        if first[offset : offset + len(mark)] == mark:
            return demuxer
    if any(all(first[at : at + 1] == b"G" for at in places) for places in _TS_PLACES):
        return "mpegts"
    return "mp3" if content.first else None


@contextmanager
def open_sound(
    name: str, data: bytes | None, choice: AudioChoice = AudioChoice()
) -> Iterator[SoundSource]:
    """Open a recording.

    Parameters
    ----------
    name : str
        A path, or the name of `data` in messages.
    data : bytes or None
        The content, unless `name` is a path.
    choice : AudioChoice
        Its track, or the form of samples without a header; `deitalk.audio.load.read_sound` takes
        the channel.

    Raises
    ------
    AudioError
        If the file is no audio, is damaged, has no such track, or its coding is not supported.
    """
    with open(name, "rb") if data is None else io.BytesIO(data) as file:
        if choice.raw is not None:
            # All whole samples of a file without a header.
            known = sniff(file)
            if known not in (None, "mp3", "aac", "mpegts"):  # bytes of samples may look like those
                raise AudioError(f"{name} has a header ({known}): leave `raw` out", parameter="raw")
            size = file.seek(0, io.SEEK_END)
            rest = size % choice.raw.frame_bytes
            note = (
                f"{rest} bytes at the end are no whole sample of {choice.raw}: left out"
                if rest
                else ""
            )
            parts = [Part(0, size - rest, note=note)]
            yield _Recordings(name, partial(_SndfileReader, name, file, raw=choice.raw), parts)
            return
        demuxer = sniff(file)
        if demuxer is None and name.lower().endswith(_MPEG_ENDINGS):
            demuxer = "padded"
        opened = partial(_opened, name, file, demuxer)
        yield _Recordings(name, opened, parts_of(file, demuxer), choice.track or 0)


def _opened(
    name: str, file: IO[bytes], demuxer: str | None, part: Part, track: int
) -> "_SndfileReader | FFmpegReader":
    """A reader of one recording of a file."""
    window = Window(file, part)
    if demuxer == "padded":
        # MPEG audio with padding or other bytes before its first frame
        try:
            return FFmpegReader(name, window, "mp3", track)
        except AudioError:
            raise AudioError(_NOT_AUDIO.format(name), parameter="raw") from None
    if demuxer == "flac":
        with suppress(_NotSupportedError):
            return _ShortFlac(name, file, part, track)
    is_mpeg = demuxer == "wav" and part.head[_CODE_PLACE] in _MPEG_CODES
    if demuxer is None or (demuxer in _BY_SNDFILE and not is_mpeg):
        try:
            return _SndfileReader(name, file, part, track)
        except _NotSupportedError:
            if demuxer is None:
                raise AudioError(_NOT_AUDIO.format(name), parameter="raw") from None
    demuxer = "wav" if demuxer == "w64" and part.head else demuxer
    return FFmpegReader(name, window, demuxer or "", track)


class _NotSupportedError(Exception):
    """libsndfile does not read a format."""


class _SndfileReader:
    """A recording that libsndfile reads, with one track."""

    tracks = ("",)
    track = 1

    def __init__(
        self, name: str, file: IO[bytes], part: Part, track: int = 0, raw: RawFormat | None = None
    ) -> None:
        self.name, self.file, self.part, self.raw = name, file, part, raw
        if track > 1:
            raise AudioError(f"{name} has 1 sound track; there is no track {track}")
        with self._open() as sound:
            self.rate, self.channels = int(sound.samplerate), int(sound.channels)
            padding = sound.frames - part.samples
            self.most = part.samples if part.samples and 0 < padding < MOST_PADDING else 2**40
            self.seconds = min(sound.frames, self.most) % 2**40 / self.rate
        self.layout = part.layout
        self.notes = [part.note] if part.note else []

    def _open(self) -> Any:
        """The file at its beginning: some formats cannot be sought."""
        import soundfile

        form = {}
        if self.raw is not None:
            subtype, endian, _ = ENCODINGS[self.raw.encoding]
            form = {"format": "RAW", "subtype": subtype, "endian": endian,
                    "samplerate": self.raw.rate, "channels": self.raw.channels}  # fmt: skip
        try:
            return soundfile.SoundFile(Window(self.file, self.part), **form)
        except (RuntimeError, TypeError):
            raise _NotSupportedError from None

    def pieces(self, size: int) -> Iterator[Piece]:
        """Pieces of `size` samples, the last one shorter."""
        start = 0
        try:
            with self._open() as sound:
                while len(block := sound.read(size, dtype="float32", always_2d=True)):
                    yield Piece(block[: self.most - start], self.rate)
                    start += len(block)
        except RuntimeError as error:
            raise AudioError(
                f"{self.name} is damaged after {start / self.rate:.2f} s; export it again"
            ) from error


class _ShortFlac(_SndfileReader):
    """A short FLAC in 16 bits with the checksum of its samples: nothing is missing or damaged.

    libsndfile is loaded in a third of the time of FFmpeg, which reads the other ones.
    """

    def __init__(self, name: str, file: IO[bytes], part: Part, track: int = 0) -> None:
        super().__init__(name, file, part, track)
        self.layout = _FLAC_LAYOUTS.get(self.channels, ())
        if not self.layout or not 0 < self.seconds <= SHORT_SECONDS:
            raise _NotSupportedError
        try:
            with self._open() as sound:
                self.samples = sound.read(dtype="int16", always_2d=True)
        except RuntimeError:
            raise _NotSupportedError from None
        window = Window(file, part)
        window.seek(_FLAC_CHECKSUM.start)
        checksum = window.read(_FLAC_CHECKSUM.stop - _FLAC_CHECKSUM.start)
        found = hashlib.md5(self.samples.astype("<i2").tobytes(), usedforsecurity=False)
        if found.digest() != checksum:  # or it has another number of bits
            raise _NotSupportedError

    def pieces(self, size: int) -> Iterator[Piece]:
        """All of it."""
        yield Piece(self.samples / np.float32(1 << 15), self.rate)


def _undisturbed(pieces: Iterator[Piece]) -> Iterator[Piece]:
    """Pieces, between which signals act; while a decoder reads one would end the sound unseen."""
    while True:
        with held():
            piece = next(pieces, None)
        if piece is None:
            return
        yield piece


class _Recordings:
    """All recordings of a file as one, with the rate and the channels of the first."""

    def __init__(self, name: str, opened: Any, parts: list[Part], track: int = 0) -> None:
        self.name, self.opened, self.parts, self.asked = name, opened, parts, track
        self.first = self._open(parts[0])
        self.rate, self.channels = self.first.rate, self.first.channels
        self.layout = self.first.layout
        self.tracks, self.track = self.first.tracks, self.first.track
        self.expected = round(self.first.seconds * self.rate) if len(parts) == 1 else 0
        self.notes: list[str] = []

    def _open(self, part: Part) -> "_SndfileReader | FFmpegReader":
        with held():
            opened: _SndfileReader | FFmpegReader = self.opened(part, self.asked)
        return opened

    def on(self, track: int) -> "_Recordings":
        """Open the same file on another track."""
        return _Recordings(self.name, self.opened, self.parts, track)

    def blocks(self, size: int) -> Iterator[Float32]:
        """Blocks (n, C) of `size` samples or a packet more."""
        held: list[Float32] = []
        n_held = 0
        for samples in self._alike(size):
            held.append(samples)
            n_held += len(samples)
            if n_held >= size:
                yield np.concatenate(held)
                held, n_held = [], 0
        if n_held:
            yield np.concatenate(held)

    def _alike(self, size: int) -> Iterator[Float32]:
        """Samples of all recordings with the first one's rate and channels."""
        alike = _Alike(self.rate, self.channels)
        notes: dict[str, int] = {}
        lost: list[str] = []
        for number, part in enumerate(self.parts, 1):
            try:
                reader = self.first if number == 1 else self._open(part)
            except AudioError as error:
                reason = str(error).removeprefix(f"{self.name} ").partition(";")[0]
                lost.append(f"recording {number} of {len(self.parts)} is left out: it {reason}")
                continue
            for piece in _undisturbed(reader.pieces(size)):
                yield from alike.taken(piece)
            for note in reader.notes:
                notes[note] = notes.get(note, 0) + 1
        yield from alike.rest()
        several = f"{len(self.parts)} recordings one after another"
        self.notes = [f"{several}: all were read"] if len(self.parts) > 1 and not lost else lost
        self.notes += [note + f" ({n} times)" * (n > 1) for note, n in notes.items()]
        self.notes += alike.notes


class _Alike:
    """Pieces of any rate and channels to those of the first."""

    def __init__(self, rate: int, channels: int) -> None:
        self.rate, self.channels = rate, channels
        self.seconds = 0.0
        self.other: tuple[int, int] | None = None
        self.resampler: Any = None
        self.changes: list[str] = []

    def taken(self, piece: Piece) -> Iterator[Float32]:
        """Samples (n, C) of a piece, after those held back of the one before."""
        samples, form = piece.samples, (piece.rate, piece.samples.shape[1])
        if form == (self.rate, self.channels):
            yield from self.rest()
            self.seconds += len(samples) / self.rate
            yield samples
            return
        if form != self.other:
            yield from self.rest()
            self._begin(*form)
        self.seconds += len(samples) / piece.rate
        if form[1] != self.channels:
            samples = np.repeat(samples.mean(axis=1, keepdims=True), self.channels, axis=1)
        if self.resampler is not None:
            samples = self.resampler.resample_chunk(np.ascontiguousarray(samples))
        yield samples

    def rest(self) -> Iterator[Float32]:
        """Samples that a resampler holds back."""
        if self.resampler is not None:
            empty = np.zeros((0, self.channels), np.float32)
            yield self.resampler.resample_chunk(empty, last=True)
        self.resampler = self.other = None

    def _begin(self, rate: int, channels: int) -> None:
        import soxr

        self.other = (rate, channels)
        if rate != self.rate:
            self.resampler = soxr.ResampleStream(
                rate, self.rate, self.channels, dtype="float32", quality="HQ"
            )
        self.changes.append(f"{self.seconds:.2f} s ({_form(rate, channels)})")

    @property
    def notes(self) -> list[str]:
        """Note on the places where rate or channels change."""
        if not self.changes:
            return []
        return [
            f"it begins with {_form(self.rate, self.channels)} and changes at "
            f"{', '.join(self.changes[:3])}{' …' * (len(self.changes) > 3)}: made alike"
        ]


def _form(rate: int, channels: int) -> str:
    return f"{channels} channel{'s' * (channels != 1)} at {rate} Hz"
