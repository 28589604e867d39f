"""Pictures of a video, upright, at most 30 a second, with their times on the clock of its sound."""

from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from deitalk.audio.ffmpeg import lenient, refuse_other
from deitalk.audio.frames import FRAME_RATE
from deitalk.errors import DataError
from rig import limits
from rig.face.render.picture import Picture

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer

LONG_SIDE = 1280
"""Larger pictures are scaled down: a face is measured at 192 pixels."""
MOST_DAMAGED = 100
"""Packets that may be damaged."""
_DECODERS = (
    "h264 hevc mpeg4 vp8 vp9 libvpx libvpx-vp9 av1 libdav1d libaom-av1 prores mjpeg "
    "aac mp3 mp3float opus libopus vorbis alac flac ac3 eac3 pcm_s16le pcm_s16be pcm_s24le "
    "pcm_s24be pcm_s32le pcm_f32le amrnb amrwb"
)


def read_pictures(path: Path) -> Iterator[tuple[float, Picture, float]]:
    """Pictures of the first video track.

    Parameters
    ----------
    path : Path
        A video.

    Yields
    ------
    seconds : float
        Since the first sample of the sound; 0 is the first picture in a video without sound.
    picture : array of uint8 [shape=(height, width, 3)]
        RGB, turned as the camera was held, at most `LONG_SIDE` long.
    share : float
        Of the video that is read, 0 to 1.

    Raises
    ------
    DataError
        If the file is no video, too large or damaged.
    """
    import av

    if path.stat().st_size > limits.VIDEO_BYTES:
        raise DataError(f"{path}: larger than {limits.VIDEO_BYTES} bytes; cut it or lower its size")
    try:
        start = _sound_start(path)
        with path.open("rb") as file, _opened(file) as container:
            yield from _pictures(path, container, start)
    except (av.FFmpegError, OSError, MemoryError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or type(error).__name__
        raise DataError(
            f"{path}: cannot be decoded as a video ({reason}); export it again"
        ) from error


def _opened(file: IO[bytes]) -> "InputContainer":
    import av

    container: InputContainer = av.open(
        file,
        "r",
        container_options={"codec_whitelist": ",".join(_DECODERS.split())},
        io_open=refuse_other,
        **lenient(av.__version__),
    )
    return container


def _sound_start(path: Path) -> float | None:
    """Time of the first sample of the sound; None without sound."""
    with path.open("rb") as file, _opened(file) as container:
        if not container.streams.audio:
            return None
        frame = next(container.decode(audio=0), None)
        return None if frame is None or frame.time is None else float(frame.time)


def _pictures(
    path: Path, container: "InputContainer", start: float | None
) -> Iterator[tuple[float, Picture, float]]:
    if not container.streams.video:
        raise DataError(f"{path}: has no video track; give the video, not its sound")
    stream = container.streams.video[0]
    stream.thread_type = "AUTO"
    total = float(container.duration or 0) / 1e6
    taken = last = -np.inf
    for frame in _frames(path, container, stream):
        seconds = frame.time
        if seconds is None:
            continue
        start = seconds if start is None else start
        seconds -= start
        if seconds <= last or seconds < -0.5 / FRAME_RATE:
            continue
        last = seconds
        # Of fast videos the frames that are half a step or more beyond the last one.
        if seconds - taken < 0.75 / FRAME_RATE:
            continue
        if seconds > limits.SECONDS:
            raise DataError(f"{path}: lasts more than {limits.SECONDS:.0f} s; cut it")
        taken = seconds
        yield max(seconds, 0.0), _upright(path, frame), min(seconds / total, 1.0) if total else 0.0
    if not np.isfinite(last):
        raise DataError(f"{path}: holds no picture that can be decoded; export it again")


def _frames(path: Path, container: "InputContainer", stream: Any) -> "Iterator[VideoFrame]":
    """Decoded frames; damaged packets are left out, which leaves frames out."""
    import av

    damaged = 0
    for packet in container.demux(stream):
        try:
            yield from packet.decode()
        except av.FFmpegError:
            damaged += 1
            if damaged > MOST_DAMAGED:
                raise DataError(
                    f"{path}: damaged in more than {MOST_DAMAGED} places; export it again"
                ) from None


def _upright(path: Path, frame: "VideoFrame") -> Picture:
    """RGB of a frame, scaled down and turned."""
    if frame.width * frame.height > limits.VIDEO_PIXELS:
        raise DataError(
            f"{path}: {frame.width} x {frame.height} pixels; at most {limits.VIDEO_PIXELS}"
        )
    scale = min(LONG_SIDE / max(frame.width, frame.height), 1.0)
    width, height = (max(round(scale * side / 2) * 2, 2) for side in (frame.width, frame.height))
    picture = frame.reformat(width=width, height=height, format="rgb24").to_ndarray()
    return np.ascontiguousarray(np.rot90(picture, round(frame.rotation / 90)))
