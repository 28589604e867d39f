"""One recording of a file by FFmpeg's libraries (PyAV): its tracks, and its sound in its time.

FFmpeg reads through a Python file, with one demuxer that is chosen here and a list of audio
decoders, and cannot open another file, as a playlist would. It removes the delay of encoders where
a container states it; times of packets are believed where a container keeps them.

Letters: n samples of a block at the file's rate, C channels.
"""

from collections.abc import Iterator, Sized
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from deitalk.audio.content import CHANNELS, Content, Window, length_note
from deitalk.audio.parts import has_fragments
from deitalk.errors import AudioError
from rig.arrays import Float32

if TYPE_CHECKING:
    from av import AudioFrame, AudioStream
    from av.container import InputContainer

LENGTH_SLACK_SECONDS = 0.1  # a container's duration is rounded, and may count encoder padding
LONGEST_LOSS_SECONDS = 1.0  # of one damaged packet; a longer one states a wrong duration
MOST_DAMAGED = 100  # packets more than sound ones
JITTER_SECONDS = 0.01  # times of packets are rounded; a lost packet is longer
LONGEST_HOLE_SECONDS = 3600.0  # beyond it, a clock that was set
LONGEST_OVERLAP_SECONDS = 1.0
LONGEST_HOLE_OF_STREAM_SECONDS = 10.0
"""Longest hole of a transport stream, whose clock may start anew."""
LEAST_BYTE_RATE = 300.0  # a file of fewer bytes a second states a wrong duration
SILENT_SAMPLES = 1 << 16  # of one block

TIMED = ("mov", "matroska", "mpegts", "asf", "flv", "ogg")
"""Demuxers whose packets have times that mean something; sound of others has no holes."""
_KEEP_LENGTH = ("mov", "matroska", "flac", "ogg")  # durations of others are estimates by size
_MP3_LENGTHS = (b"Xing", b"Info", b"VBRI")  # marks of a first mp3 frame that counts the others
UNTITLED = ("und", "SoundHandler", "Sound Media Handler")
_DECODERS = frozenset(
    "aac mp1 mp1float mp2 mp2float mp3 mp3float opus libopus vorbis libvorbis flac alac ac3 eac3 "
    "wmav1 wmav2 wmapro wmalossless wmavoice amrnb amrwb libopencore_amrnb libopencore_amrwb "
    "adpcm_ms adpcm_ima_wav adpcm_ima_qt gsm gsm_ms speex pcm_alaw pcm_mulaw pcm_u8 pcm_s8 "
    "pcm_s16le pcm_s16be pcm_s24le pcm_s24be pcm_s32le pcm_s32be pcm_f32le pcm_f32be pcm_f64le "
    "pcm_f64be".split()
)


class Piece(NamedTuple):
    """Samples that follow those before."""

    samples: Float32
    """(n, C), full scale 1."""
    rate: int
    """Hz."""


class FFmpegReader:
    """One sound track of a recording.

    Parameters
    ----------
    name : str
        Of the recording, for messages.
    window : Window
        Its bytes.
    demuxer : str
        Of FFmpeg.
    track : int
        Number from 1 on; 0: the first one that can be decoded.

    Attributes
    ----------
    rate, channels, layout : int, int, tuple of str
        Of its first samples.
    tracks : tuple of str
        Titles of all sound tracks, where they have any; empty ones else.
    track : int
        The number.
    seconds : float
        Length according to its header; 0 where that holds none, or none that can be true.
    notes : list of str
        What `pieces` found.
    """

    def __init__(self, name: str, window: Window, demuxer: str, track: int = 0) -> None:
        self.name, self.window, self.demuxer, self.track = name, window, demuxer, track
        self.notes: list[str] = []
        is_movie = demuxer == "mov" and not has_fragments(window)
        with self._container() as container:
            stream = self._stream(container)
            self.coding = _codec(stream)
            titles = [
                [track.metadata.get(key, "") for key in ("title", "handler_name", "language")]
                for track in container.streams.audio
            ]
            self.tracks = tuple(
                next((name for name in names if name and name not in UNTITLED), "")
                for names in titles
            )
            first = next((frame for frame, _ in self._frames(container) if frame), None)
            if first is None:
                raise AudioError(
                    f"{name} has a sound track with 0 samples that can be decoded; export it again"
                )
            self.rate, self.channels = first.sample_rate, first.layout.nb_channels
            names = tuple(str(channel.name) for channel in first.layout.channels)
            self.layout = names if set(names) <= set(CHANNELS) else ()
            self.stated = self._stated(container, stream)
            self.origin = 0.0 if is_movie else _origin(container)
        is_true = self.stated * LEAST_BYTE_RATE <= self.window.size
        self.seconds = self.stated if is_true else 0.0

    def pieces(self, size: int) -> Iterator[Piece]:
        """Sound in pieces of one or several packets; silence where there is none."""
        timeline = _Timeline(self.origin, self.demuxer)
        pieces = self._pieces(timeline)
        is_vorbis = self.coding == "vorbis" and self.demuxer == "ogg"
        if self.stated and (is_vorbis or self.demuxer == "mov"):
            pieces = _to_length(pieces, timeline, self.stated, fills=is_vorbis)
        return pieces

    def _pieces(self, timeline: "_Timeline") -> Iterator[Piece]:
        damaged: list[float] = []
        with self._container() as container:
            for frame, lost_seconds in self._frames(container):
                if frame is None:
                    damaged.append(timeline.position)
                    yield from _silence(lost_seconds, self.rate, self.channels)
                    timeline.position += lost_seconds
                    continue
                samples, rate = _samples(frame), frame.sample_rate
                ticks, unit = frame.pts, frame.time_base
                at = None if ticks is None or unit is None else float(ticks * unit)
                gap = timeline.gap_before(at)
                if gap > 0:
                    yield from _silence(gap, rate, samples.shape[1])
                else:
                    samples = samples[round(-gap * rate) :]
                timeline.position += max(gap, 0.0) + len(samples) / rate
                yield Piece(samples, rate)
        found = timeline.position - timeline.lead
        is_edited = self.demuxer == "mov" and (timeline.lead or found > self.stated)
        # of a movie with edits the stated length may count the silence, or leave out what it holds
        slack = LENGTH_SLACK_SECONDS + (max(timeline.lead, found - self.stated) if is_edited else 0)
        cut = length_note(found, self.stated or found, slack)
        self.notes = [*filter(None, [cut]), *timeline.notes]
        if damaged:
            self.notes.append(
                f"{len(damaged)} damaged pieces are silent now, the first at {damaged[0]:.2f} s"
            )

    @contextmanager
    def _container(self) -> "Iterator[InputContainer]":
        """Open the file in FFmpeg; its exceptions become an AudioError."""
        import av

        self.window.seek(0)
        try:
            with av.open(
                self.window,
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

    def _stream(self, container: "InputContainer") -> "AudioStream":
        """The track; the first one that can be decoded where no number is given."""
        streams = list(container.streams.audio)
        if not streams:
            raise AudioError(f"{self.name} has no sound track; export it with its sound")
        if self.track > len(streams):
            raise AudioError(
                f"{self.name} has {len(streams)} sound track{'s' * (len(streams) > 1)}; there is "
                f"no track {self.track}"
            )
        able = [number for number, stream in enumerate(streams, 1) if _codec(stream) in _DECODERS]
        self.track = self.track or next(iter(able), 0)
        if self.track not in able:
            stream = streams[max(self.track, 1) - 1]
            raise AudioError(
                f"{self.name} holds sound coded as {_codec(stream) or 'a way unknown'}; "
                "convert it to wav first"
            )
        return streams[self.track - 1]

    def _frames(self, container: "InputContainer") -> "Iterator[tuple[AudioFrame | None, float]]":
        """Decoded frames; None and the seconds lost for a packet that cannot be decoded."""
        import av

        damaged = 0
        for packet in container.demux(self._stream(container)):
            try:
                frames = packet.decode()
            except (av.FFmpegError, ValueError):
                damaged += 1
                if damaged > MOST_DAMAGED:
                    raise AudioError(
                        f"{self.name} is damaged in more than {MOST_DAMAGED} places; "
                        "export it again"
                    ) from None
                lost = float((packet.duration or 0) * (packet.time_base or 0))
                yield None, min(max(lost, 0.0), LONGEST_LOSS_SECONDS)
                continue
            for frame in frames:
                yield frame, 0.0

    def _stated(self, container: "InputContainer", track: "AudioStream") -> float:
        """Length of the sound by the header, seconds; 0 where it holds none."""
        import av

        keeps_length = self.demuxer in _KEEP_LENGTH
        if self.demuxer == "mp3":  # its first frame may hold the number of frames
            content = Content(self.window)
            head = content.at(content.first, 256)
            keeps_length = any(mark in head for mark in _MP3_LENGTHS)
        if not keeps_length:
            return 0.0
        if track.duration is not None and track.time_base is not None:
            seconds = float(track.duration * track.time_base)
        elif container.duration is not None and len(container.streams) == 1:
            seconds = (container.duration - max(container.start_time or 0, 0)) / av.time_base
        else:
            return 0.0
        return max(0.0, seconds)


class _Timeline:
    """Places of the frames by their times, and the corrections that these need."""

    def __init__(self, origin: float | None, demuxer: str) -> None:
        self.is_kept = demuxer in TIMED
        self.longest = LONGEST_HOLE_OF_STREAM_SECONDS
        if demuxer != "mpegts":
            self.longest = LONGEST_HOLE_SECONDS
        self.origin = origin
        self.offset: float | None = None  # time of the container when the position is 0
        self.position = 0.0  # seconds of sound and silence so far
        self.lead = 0.0  # silence before the first sample
        self.holes: list[tuple[float, float]] = []
        self.overlaps: list[tuple[float, float]] = []
        self.jumps: list[float] = []

    def gap_before(self, time: float | None) -> float:
        """Silence before a frame of a time, seconds; negative: part of the frame to leave out."""
        if time is None or not self.is_kept:
            return 0.0
        is_first = self.offset is None
        if self.offset is None:
            self.offset = (time if self.origin is None else self.origin) - self.position
        gap = time - self.offset - self.position
        if abs(gap) <= JITTER_SECONDS:
            return 0.0
        if not -LONGEST_OVERLAP_SECONDS <= gap <= self.longest or (is_first and gap < 0):
            self.offset += gap
            self.jumps += [] if is_first and gap < 0 else [self.position]
            return 0.0
        if is_first:
            self.lead = gap
        else:
            (self.holes if gap > 0 else self.overlaps).append((self.position, abs(gap)))
        return gap

    @property
    def notes(self) -> Iterator[str]:
        """Notes on sound that was lost or added."""
        if self.lead:
            yield f"the sound starts {self.lead:.2f} s into the file: silent until then"
        if self.holes:
            yield (
                f"{_counted(self.holes, 'hole')} between its packets, {_total(self.holes)}: "
                "silent now"
            )
        if self.overlaps:
            yield (
                f"{_counted(self.overlaps, 'packet')} overlapped the sound before, "
                f"{_total(self.overlaps)}: left out"
            )
        if self.jumps:
            yield (
                f"{_counted(self.jumps, 'jump')} of its clock, the first at {self.jumps[0]:.2f} s: "
                "read on without silence"
            )


def _counted(found: Sized, name: str) -> str:
    return f"{len(found)} {name}{'s' * (len(found) != 1)}"


def _total(found: list[tuple[float, float]]) -> str:
    total = sum(seconds for _, seconds in found)
    return f"{total:.2f} s in all, the first at {found[0][0]:.2f} s"


def _to_length(
    pieces: Iterator[Piece], timeline: _Timeline, seconds: float, *, fills: bool
) -> Iterator[Piece]:
    """Pieces without what is a little beyond a length; all of them if it is more than that.

    With `fills`, silence up to the length where little is missing.
    """
    position, beyond, rate, channels = 0.0, list[Piece](), 1, 1
    for samples, rate in pieces:
        channels = samples.shape[1]
        left = max(round((seconds + timeline.lead - position) * rate), 0)
        position += len(samples) / rate
        if position > seconds + timeline.lead + LENGTH_SLACK_SECONDS:
            yield from (*beyond, Piece(samples, rate))
            beyond.clear()
            continue
        if left:
            yield Piece(samples[:left], rate)
        if left < len(samples):
            beyond.append(Piece(samples[left:], rate))
    missing = seconds + timeline.lead - position
    if fills and 0 < missing <= LENGTH_SLACK_SECONDS:
        yield from _silence(missing, rate, channels)


def _silence(seconds: float, rate: int, channels: int) -> Iterator[Piece]:
    """Pieces of silence, none of them large."""
    n_samples = round(seconds * rate)
    for start in range(0, n_samples, SILENT_SAMPLES):
        shape = (min(n_samples - start, SILENT_SAMPLES), channels)
        yield Piece(np.zeros(shape, np.float32), rate)


def _samples(frame: "AudioFrame") -> Float32:
    """Samples (n, C) of a frame, full scale 1."""
    values: npt.NDArray[Any] = frame.to_ndarray()
    values = values.T if frame.format.is_planar else values.reshape(-1, frame.layout.nb_channels)
    if values.dtype == np.uint8:
        return (values.astype(np.float32) - np.float32(128)) / np.float32(128)
    if values.dtype.kind == "i":
        return np.asarray(values / np.float32(-float(np.iinfo(values.dtype).min)), np.float32)
    with np.errstate(invalid="ignore", over="ignore"):  # reported by the reader
        return values.astype(np.float32)


def _origin(container: "InputContainer") -> float | None:
    """Time of the container at which its picture or sound begins; None: with this sound alone."""
    # Whether a picture is the cover of a recording.
    starts = [
        float(stream.start_time * stream.time_base)
        for stream in container.streams
        if stream.type in ("audio", "video")
        and stream.start_time is not None
        and stream.time_base is not None
        and "attached_pic" not in str(getattr(stream, "disposition", "")).lower()
    ]
    # a time before 0 is that of an encoder's delay, which is not played
    return max(min(starts), 0.0) if len(starts) > 1 else None


def _codec(stream: "AudioStream") -> str:
    """Name of a track's coding; empty if it is unknown."""
    return "" if stream.codec_context is None else str(stream.codec_context.name)


def lenient(version: str) -> dict[str, Any]:
    """Arguments for PyAV to open a file whose tags are not UTF-8; 19 needs none."""
    return {"metadata_errors": "replace"} if int(version.partition(".")[0]) < 19 else {}


def refuse_other(url: str, flags: int, options: dict[str, str]) -> Any:
    """Callback of FFmpeg for opening another file: always an error."""
    raise PermissionError("it refers to another file")
