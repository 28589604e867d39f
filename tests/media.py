"""Sound and video files for tests, written by FFmpeg's libraries (PyAV)."""

import io
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


CLICK_HZ, CLICK_SECONDS = 1500, 0.002


def click(rate: int, seconds: float = 2.0, at: float = 1.0) -> np.ndarray:
    """Silence with a short burst of a tone around a time [shape=(S,)]."""
    apart = np.arange(round(rate * seconds)) / rate - at
    burst = np.exp(-((apart / CLICK_SECONDS) ** 2)) * np.cos(2 * np.pi * CLICK_HZ * apart)
    return (0.7 * burst).astype(np.float32)


def click_time(waveform: np.ndarray, rate: int = 16_000) -> float:
    """Time of the click in a waveform, seconds."""
    energy = np.square(waveform.astype(np.float64))
    first = max(int(energy.argmax()) - rate // 100, 0)
    around = energy[first : first + rate // 50]
    return (first + float((around * np.arange(len(around))).sum() / around.sum())) / rate


def packets_of(track, samples: np.ndarray, rate: int, start: float = 0.0) -> list:
    """Packets of samples (N, C) that begin at a time, all of them but for what an encoder holds."""
    layout = track.codec_context.layout.name
    frame = av.AudioFrame.from_ndarray(
        np.ascontiguousarray(samples.astype(np.float32).reshape(1, -1)), format="flt", layout=layout
    )
    frame.sample_rate, frame.pts, frame.time_base = rate, round(start * rate), Fraction(1, rate)
    return track.encode(frame)


def movie(
    kind: str,
    sounds: list[np.ndarray],
    rate: int = 48_000,
    *,
    codec: str,
    starts: list[float] | None = None,
    picture: str = "",
    without: tuple[float, float] = (0.0, 0.0),
    titles: list[str] | None = None,
    options: dict[str, str] | None = None,
) -> bytes:
    """A file of one or several sound tracks (N,) or (N, C).

    Parameters
    ----------
    kind : str
        Muxer of FFmpeg.
    sounds : list of array
        Of the tracks.
    rate : int
        Hz.
    codec : str
        Of all tracks.
    starts : list of float, optional
        Time of the first sample of each, seconds.
    picture : str
        Codec of a picture of 3 s, from 0 on; none if empty.
    without : pair of float
        Packets that begin within this time are left out.
    titles : list of str, optional
        Of the tracks.
    options : dict, optional
        Of the muxer.
    """
    file = io.BytesIO()
    with av.open(file, "w", format=kind, options=options or {}) as container:
        packets = []
        if picture:
            still = container.add_stream(picture, rate=25)
            still.width = still.height = 64
            still.pix_fmt = "yuv420p"
        for number, sound in enumerate(sounds):
            columns = sound.reshape(len(sound), -1)
            layout = {1: "mono", 2: "stereo", 6: "5.1"}[columns.shape[1]]
            track = container.add_stream(codec, rate=rate, layout=layout)
            if titles:
                track.metadata["title"] = titles[number]
            start = starts[number] if starts else 0.0
            packets += [*packets_of(track, columns, rate, start), *track.encode(None)]
        begin, end = without
        packets = [p for p in packets if not begin <= float(p.pts * p.time_base) < end]
        if picture:
            for _ in range(75):
                black = av.VideoFrame.from_ndarray(np.zeros((64, 64, 3), np.uint8), format="rgb24")
                packets += still.encode(black)
            packets += still.encode(None)
        for packet in sorted(packets, key=lambda p: float(p.dts * p.time_base)):
            container.mux(packet)
    return file.getvalue()
