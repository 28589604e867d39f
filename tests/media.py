"""Sound and video files for tests, written by FFmpeg's libraries (PyAV)."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np

CODECS = {
    "m4a": "aac", "mp4": "aac", "mov": "aac", "aac": "aac", "webm": "libopus", "mka": "flac",
    "wma": "wmav2", "mp3": "libmp3lame", "avi": "pcm_s16le", "mkv": "pcm_s16le",
}  # fmt: skip


def write_sound(
    path: Path,
    samples: np.ndarray,
    rate: int,
    *,
    faststart: bool = True,
    picture: bool = False,
    title: str | None = None,
) -> Path:
    """Encode samples (N, C) with the usual codec of the suffix, optionally with a picture."""
    options = {"movflags": "+faststart"} if faststart and path.suffix[1:] in ("m4a", "mp4") else {}
    formats = {"m4a": "mp4", "mka": "matroska", "mkv": "matroska", "aac": "adts", "wma": "asf"}
    kind = formats.get(path.suffix[1:], path.suffix[1:])
    with av.open(f"file:{path}", "w", format=kind, options=options) as container:
        if title is not None:
            container.metadata["title"] = title
        layout = {1: "mono", 2: "stereo"}[samples.shape[1]]
        track = container.add_stream(CODECS[path.suffix[1:]], rate=rate, layout=layout)
        track.bit_rate = 128_000
        still = container.add_stream("mpeg4", rate=25) if picture else None
        if still is not None:
            _encode_stills(container, still, seconds=len(samples) / rate)
        frame = av.AudioFrame.from_ndarray(
            np.ascontiguousarray(samples.astype(np.float32).reshape(1, -1)),
            format="flt", layout=layout,
        )  # fmt: skip
        frame.sample_rate, frame.pts, frame.time_base = rate, 0, Fraction(1, rate)
        container.mux(track.encode(frame))
        container.mux(track.encode(None))
    return path


def write_silent_video(path: Path) -> Path:
    """A video of a second without a sound track."""
    with av.open(str(path), "w") as container:
        still = container.add_stream("mpeg4", rate=25)
        _encode_stills(container, still, seconds=1.0)
    return path


def _encode_stills(container, stream, *, seconds: float) -> None:
    stream.width = stream.height = 64
    stream.pix_fmt = "yuv420p"
    for _ in range(round(25 * seconds)):
        picture = av.VideoFrame.from_ndarray(np.zeros((64, 64, 3), np.uint8), format="rgb24")
        container.mux(stream.encode(picture))
    container.mux(stream.encode(None))
