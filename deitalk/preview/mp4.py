"""Encoding of pictures and sound to MP4 by FFmpeg's libraries (PyAV)."""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deitalk.errors import MissingError
from deitalk.preview.source import PreviewError
from rig.arrays import Float32
from rig.face.render.picture import Picture

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import OutputContainer


ENCODERS: tuple[tuple[str, dict[str, str]], ...] = (
    ("libx264", {"preset": "superfast", "crf": "22", "x264-params": "b-adapt=0:scenecut=0"}),
    ("libopenh264", {}),
    ("h264_videotoolbox", {}),
    ("mpeg4", {}),
)
"""Video encoders, the best first, and their options; builds of FFmpeg have different encoders."""
BIT_RATES = {"libx264": 0, "mpeg4": 6_000_000}  # bit/s; 0 is set by the quality
USUAL_BIT_RATE = 4_000_000
BT709, VIDEO_RANGE, FULL_RANGE = 1, 1, 2  # FFmpeg's numbers of colour space and of range
KEYFRAME_FRAMES = 15  # between keyframes: a player seeks within half a second
SOUND_BIT_RATE = 160_000
SOUND_RATES = (8000, 11025, 12000, 16000, 22050, 24000, 32000, 44100, 48000)  # Hz, of AAC
SOUND_FRAME = 1024  # samples of an AAC frame


@dataclass(frozen=True)
class Encoder:
    """A video encoder of this installation."""

    name: str
    options: dict[str, str]

    @property
    def note(self) -> str | None:
        """Note for the user on the codec; None for H.264, which every player supports."""
        if self.name != "mpeg4":
            return None
        return "this build of PyAV has no H.264 encoder: the video is MPEG-4 Part 2"


def find_encoder() -> Encoder:
    """The best video encoder of this installation.

    Raises
    ------
    MissingError
        If PyAV has neither H.264 nor MPEG-4, or no AAC.
    """
    import av

    here = av.codecs_available
    for name, options in ENCODERS:
        if name in here and "aac" in here and _encodes(name):
            return Encoder(name, options)
    raise MissingError(
        "a video needs an H.264 or MPEG-4 encoder, which this build of PyAV lacks; "
        "pip install --force-reinstall --only-binary av av"
    )


def _encodes(name: str) -> bool:
    import av

    try:
        av.Codec(name, "w")
    except (av.FFmpegError, ValueError):
        return False
    return True


def write_mp4(
    out: Path,
    pictures: Iterator[Picture],
    *,
    fps: float,
    size: tuple[int, int],
    samples: Float32,
    sample_rate: int,
    encoder: Encoder | None = None,
) -> None:
    """Encode pictures and sound.

    Picture i is shown at i/fps exactly, and the first sample is played with picture 0: the silence
    that the sound's encoder puts before it is marked as not to be played.

    Parameters
    ----------
    out : Path
        Replaced; its folder must exist.
    pictures : iterator of uint8 array [shape=(height, width, 3)]
        RGB, of even width and height.
    fps : float
        29.97 stands for 30000/1001 (`rig.curves.snap_fps`).
    size : (int, int)
        Width and height.
    samples : array (N,) float32
        Full scale is 1.
    sample_rate : int
        Hz; 0 for no sound.
    encoder : Encoder, optional
        From `find_encoder`.

    Raises
    ------
    PreviewError
        If FFmpeg cannot encode or write.
    """
    import av

    chosen = find_encoder() if encoder is None else encoder
    try:
        with av.open(
            f"file:{out.absolute()}", "w", format="mp4", options={"movflags": "+faststart"}
        ) as container:
            video = _video_track(container, chosen, fps, size)
            sound = _Sound(container, samples, sample_rate) if sample_rate else None
            for index, picture in enumerate(pictures):
                frame = _bt709(av.VideoFrame.from_ndarray(picture, format="rgb24"))
                frame.pts, frame.time_base = index, video.codec_context.time_base
                container.mux(video.encode(frame))
                if sound is not None:
                    sound.write_until((index + 1) / fps)
            container.mux(video.encode(None))
            if sound is not None:
                sound.finish()
    except (av.FFmpegError, OSError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise PreviewError(f"the video cannot be written: {reason}") from error


def _video_track(
    container: "OutputContainer", encoder: Encoder, fps: float, size: tuple[int, int]
) -> Any:
    rate = Fraction(fps).limit_denominator(1001)
    track: Any = container.add_stream(encoder.name, rate=rate, options=encoder.options)
    track.width, track.height = size
    track.pix_fmt = "yuv420p"
    track.codec_context.time_base = 1 / rate
    track.codec_context.thread_count = 2
    track.codec_context.gop_size = KEYFRAME_FRAMES
    colors = track.codec_context
    colors.colorspace = colors.color_primaries = colors.color_trc = BT709
    colors.color_range = VIDEO_RANGE
    if bit_rate := BIT_RATES.get(encoder.name, USUAL_BIT_RATE):
        track.bit_rate = bit_rate
    return track


def _bt709(frame: "VideoFrame") -> "VideoFrame":
    """An RGB picture as yuv420p by ITU-R BT.709, levels 16 to 235."""
    converted = frame.reformat(
        format="yuv420p",
        dst_colorspace=BT709,
        src_color_range=FULL_RANGE,
        dst_color_range=VIDEO_RANGE,
    )
    converted.colorspace, converted.color_range = BT709, VIDEO_RANGE
    return converted


class _Sound:
    """The sound track, written together with the pictures in bounded memory."""

    def __init__(self, container: "OutputContainer", samples: Float32, sample_rate: int) -> None:
        self.container = container
        # The samples at a rate of AAC in MP4: unchanged, or resampled to 48 kHz.
        if sample_rate in SOUND_RATES:
            self.samples, self.rate = samples, sample_rate
        else:
            import soxr

            self.samples, self.rate = (
                np.asarray(soxr.resample(samples, sample_rate, 48_000), np.float32),
                48_000,
            )
        self.track: Any = container.add_stream("aac", rate=self.rate, layout="mono")
        self.track.bit_rate = SOUND_BIT_RATE
        self.written = 0

    def write_until(self, seconds: float) -> None:
        """Encode the whole AAC frames up to a time."""
        end = min(round(seconds * self.rate), len(self.samples))
        while self.written + SOUND_FRAME <= end:
            self._write(SOUND_FRAME)

    def finish(self) -> None:
        """Encode the remaining samples."""
        while self.written < len(self.samples):
            self._write(min(SOUND_FRAME, len(self.samples) - self.written))
        self.container.mux(self.track.encode(None))

    def _write(self, count: int) -> None:
        import av

        piece = np.clip(self.samples[self.written : self.written + count], -1, 1)
        frame = av.AudioFrame.from_ndarray(
            np.ascontiguousarray(piece[None], np.float32), format="fltp", layout="mono"
        )
        frame.sample_rate, frame.pts = self.rate, self.written
        frame.time_base = Fraction(1, self.rate)
        self.container.mux(self.track.encode(frame))
        self.written += count
