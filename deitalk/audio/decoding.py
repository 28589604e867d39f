"""Sound from a file: libsndfile for the formats it supports, FFmpeg's libraries (PyAV) otherwise.

The decoder is chosen by the first bytes. FFmpeg reads through a Python file, with one demuxer
chosen here and a list of audio decoders, and cannot open another file, as a playlist would.

Letters: n samples of a block at the file's rate, C channels.
"""

import io
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from deitalk.errors import AudioError
from rig.arrays import Float32

if TYPE_CHECKING:
    from av import AudioFrame, AudioStream, Packet
    from av.container import InputContainer

# First bytes of a recording: format, ID3 tag and length.

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


KNOWN = "wav, flac, ogg, opus, mp3, m4a, mp4, mov, webm, aac or wma"
_NOT_AUDIO = f"{{}} is not audio that can be read; give a {KNOWN} file"
LENGTH_SLACK_SECONDS = 0.1  # a container's duration is rounded, and may count encoder padding
LONGEST_LOSS_SECONDS = 1.0  # of one damaged packet; a longer one states a wrong duration
MOST_DAMAGED = 100  # packets more than sound ones

_KEEP_LENGTH = ("mov", "matroska")  # durations of the others are estimates by size
_MP3_LENGTHS = (b"Xing", b"Info", b"VBRI")  # marks of a first mp3 frame that counts the others
_MPEG_ENDINGS = (".mp3", ".mp2", ".mpga")
_DECODERS = frozenset(
    "aac mp1 mp1float mp2 mp2float mp3 mp3float opus libopus vorbis libvorbis flac alac ac3 eac3 "
    "wmav1 wmav2 wmapro wmalossless wmavoice amrnb amrwb libopencore_amrnb libopencore_amrwb "
    "adpcm_ms adpcm_ima_wav adpcm_ima_qt gsm gsm_ms speex pcm_alaw pcm_mulaw pcm_u8 pcm_s8 "
    "pcm_s16le pcm_s16be pcm_s24le pcm_s24be pcm_s32le pcm_s32be pcm_f32le pcm_f32be pcm_f64le "
    "pcm_f64be".split()
)


class SoundSource(Protocol):
    """An open recording.

    Attributes
    ----------
    rate, channels : int
        Hz and C.
    expected : int
        Samples per channel according to the header; 0 where it holds no length.
    slack : int
        Tolerance of `expected`, samples.
    notes : list of str
        Damage that `blocks` replaced by silence.
    """

    rate: int
    channels: int
    expected: int
    slack: int
    notes: list[str]

    def blocks(self, size: int) -> Iterator[Float32]:
        """Blocks (n, C) of about `size` samples, from the beginning to the end."""
        ...


@contextmanager
def open_sound(name: str, data: bytes | None) -> Iterator[SoundSource]:
    """Open a recording.

    Parameters
    ----------
    name : str
        A path, or the name of `data` in messages.
    data : bytes or None
        The content, unless `name` is a path.

    Raises
    ------
    AudioError
        If the file is no audio, is damaged, has no sound track, or its coding is not supported.
    """
    with open(name, "rb") if data is None else io.BytesIO(data) as file:
        demuxer, is_mpeg = sniff(file)
        source = None if is_mpeg else _SndfileSource.opened(name, file)
        if source is not None:
            with source.file:
                yield source
        elif demuxer is not None:
            yield _FFmpegSource(name, file, demuxer)
        elif name.lower().endswith(_MPEG_ENDINGS):
            yield _padded_mpeg(name, file)
        else:
            raise AudioError(_NOT_AUDIO.format(name))


def _padded_mpeg(name: str, file: IO[bytes]) -> "_FFmpegSource":
    """MPEG audio with padding or other bytes before its first frame."""
    try:
        return _FFmpegSource(name, file, "mp3")
    except AudioError:
        raise AudioError(_NOT_AUDIO.format(name)) from None


class _SndfileSource:
    """A recording that libsndfile reads."""

    def __init__(self, name: str, file: Any, expected: int) -> None:
        self.name, self.file = name, file
        self.rate, self.channels = int(file.samplerate), int(file.channels)
        self.expected, self.slack = expected, 0
        self.notes: list[str] = []

    @classmethod
    def opened(cls, name: str, file: IO[bytes]) -> "_SndfileSource | None":
        """The open source; None if libsndfile does not support the format.

        libsndfile reads a file without a name, since it decodes any file named ``.mp3`` as MPEG
        audio.
        """
        import soundfile

        share = missing_share(file)
        try:
            opened = soundfile.SoundFile(_Nameless(file))
        except (RuntimeError, TypeError):
            return None
        frames = opened.frames if opened.frames < 2**40 else 0
        return cls(name, opened, round(frames * share))

    def blocks(self, size: int) -> Iterator[Float32]:
        """Blocks (n, C) of `size` samples, the last one shorter."""
        start = 0
        try:
            self.file.seek(0)
            while len(block := self.file.read(size, dtype="float32", always_2d=True)):
                yield block
                start += len(block)
        except RuntimeError as error:
            raise AudioError(
                f"{self.name} is damaged after {start / self.rate:.2f} s; export it again"
            ) from error


class _FFmpegSource:
    """The first sound track of a container, decoded packet by packet."""

    def __init__(self, name: str, file: IO[bytes], demuxer: str) -> None:
        self.name, self.file, self.demuxer = name, file, demuxer
        self.rate = self.channels = self.expected = 0
        self.notes: list[str] = []
        with self._container() as container:
            first = next((frame for frame, _ in self._frames(container) if frame), None)
            if first is None:
                raise AudioError(
                    f"{name} has a sound track with 0 samples that can be decoded; export it again"
                )
            self.rate, self.channels = first.sample_rate, first.layout.nb_channels
            self.expected = self._expected(container)
        self.slack = round(LENGTH_SLACK_SECONDS * self.rate)

    def blocks(self, size: int) -> Iterator[Float32]:
        """Blocks (n, C) of `size` samples or a packet more; silence where a packet is damaged."""
        held: list[Float32] = []
        damaged: list[float] = []
        start = n_held = 0
        with self._container() as container:
            for frame, lost_seconds in self._frames(container):
                if frame is None:
                    damaged.append(start / self.rate)
                    part = np.zeros((round(lost_seconds * self.rate), self.channels), np.float32)
                else:
                    part = self._samples(frame, start)
                held.append(part)
                start += len(part)
                n_held += len(part)
                if n_held >= size:
                    yield np.concatenate(held)
                    held, n_held = [], 0
        if n_held:
            yield np.concatenate(held)
        self.notes = [] if not damaged else [
            f"{len(damaged)} damaged pieces are silent now, the first at {damaged[0]:.2f} s"
        ]  # fmt: skip

    @contextmanager
    def _container(self) -> "Iterator[InputContainer]":
        """Open the file in FFmpeg; its exceptions become an AudioError."""
        import av

        self.file.seek(0)
        try:
            with av.open(
                _OnlyRead(self.file),
                "r",
                format=self.demuxer,
                container_options={"codec_whitelist": ",".join(sorted(_DECODERS))},
                io_open=refuse_other,
                **lenient(av.__version__),
            ) as container:
                yield container
        except (av.FFmpegError, OSError, MemoryError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or type(error).__name__
            raise AudioError(
                f"{self.name} cannot be decoded ({reason}): it is cut off or damaged; "
                "export it again, as wav if you can"
            ) from error

    def _track(self, container: "InputContainer") -> "AudioStream":
        """The first sound track that can be decoded."""
        if not container.streams.audio:
            raise AudioError(f"{self.name} has no sound track; export it with its sound")
        known = [s for s in container.streams.audio if s.codec_context is not None]
        for track in known:
            if track.codec_context.name in _DECODERS:
                return track
        coded = known[0].codec_context.name if known else "a way unknown"
        raise AudioError(f"{self.name} holds sound coded as {coded}; convert it to wav first")

    def _frames(self, container: "InputContainer") -> "Iterator[tuple[AudioFrame | None, float]]":
        """Decoded frames; None and the seconds lost for a packet that cannot be decoded."""
        import av

        damaged = 0
        for packet in container.demux(self._track(container)):
            try:
                frames = packet.decode()
            except (av.FFmpegError, ValueError):
                damaged += 1
                if damaged > MOST_DAMAGED:
                    raise AudioError(
                        f"{self.name} is damaged in more than {MOST_DAMAGED} places; "
                        "export it again"
                    ) from None
                yield None, _seconds(packet)
                continue
            for frame in frames:
                yield frame, 0.0

    def _samples(self, frame: "AudioFrame", start: int) -> Float32:
        """Samples (n, C) of a frame, full scale 1."""
        if (frame.sample_rate, frame.layout.nb_channels) != (self.rate, self.channels):
            raise AudioError(
                f"{self.name} changes from {self.channels} channels at {self.rate} Hz to "
                f"{frame.layout.nb_channels} at {frame.sample_rate} Hz after "
                f"{start / self.rate:.2f} s; export it as wav"
            )
        values: npt.NDArray[Any] = frame.to_ndarray()
        values = values.T if frame.format.is_planar else values.reshape(-1, self.channels)
        if values.dtype == np.uint8:
            return (values.astype(np.float32) - np.float32(128)) / np.float32(128)
        if values.dtype.kind == "i":
            return np.asarray(values / np.float32(-float(np.iinfo(values.dtype).min)), np.float32)
        with np.errstate(invalid="ignore", over="ignore"):  # reported by the reader
            return values.astype(np.float32)

    def _expected(self, container: "InputContainer") -> int:
        """Samples according to the header; 0 where it holds no length."""
        import av

        if self.demuxer not in _KEEP_LENGTH and not self._counts_frames():
            return 0
        track = self._track(container)
        if track.duration is not None and track.time_base is not None:
            seconds = float(track.duration * track.time_base)
        elif container.duration is not None and len(container.streams) == 1:
            seconds = container.duration / av.time_base
        else:
            return 0
        return max(0, round(seconds * self.rate))

    def _counts_frames(self) -> bool:
        """Whether this is an mp3 whose first frame holds their number."""
        if self.demuxer != "mp3":
            return False
        skip_id3(self.file)
        head = self.file.read(256)
        return any(mark in head for mark in _MP3_LENGTHS)


def _seconds(packet: "Packet[AudioStream]") -> float:
    """Duration of a packet according to its header, seconds."""
    if packet.duration is None or packet.time_base is None:
        return 0.0
    return min(max(float(packet.duration * packet.time_base), 0.0), LONGEST_LOSS_SECONDS)


def lenient(version: str) -> dict[str, Any]:
    """Arguments for PyAV to open a file whose tags are not UTF-8; 19 needs none."""
    return {"metadata_errors": "replace"} if int(version.partition(".")[0]) < 19 else {}


class _Nameless:
    """A file without a name, in which seeking to an invalid position has no effect.

    In a callback of libsndfile an exception would be printed as a traceback on standard error.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self.read, self.tell = file.read, file.tell
        self._seek = file.seek

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Go to a position; stay if it does not exist."""
        try:
            return self._seek(offset, whence)
        except (ValueError, OverflowError, OSError):
            return self.tell()


class _OnlyRead:
    """A file without a name that FFmpeg can read and seek but not close."""

    def __init__(self, file: IO[bytes]) -> None:
        self.read, self.seek, self.tell = file.read, file.seek, file.tell


def refuse_other(url: str, flags: int, options: dict[str, str]) -> Any:
    """Callback of FFmpeg for opening another file: always an error."""
    raise PermissionError("it refers to another file")
