"""The review video: two views of the face over the sound and the curves, with the recording."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deitalk.errors import MissingError
from deitalk.preview.source import PreviewError, PreviewSource, check_board, load_source
from deitalk.preview.strip import Panel, label
from rig.arrays import AnyFloat, Float32
from rig.emotions import LABELS
from rig.face import build_head
from rig.face.accents import accents
from rig.face.head_pose import neck_share, turned
from rig.face.identity import Identity
from rig.face.render import VIEWS
from rig.face.render.picture import Picture
from rig.files import atomic_write, check_file

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import OutputContainer

# Encoding of pictures and sound to MP4 by FFmpeg's libraries (PyAV).

ENCODERS: tuple[tuple[str, dict[str, str]], ...] = (
    ("libx264", {"preset": "veryfast", "crf": "21"}),
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


WIDTH, FACE_HEIGHT, PANEL_HEIGHT = 960, 480, 240
FACE_WIDTH = 540
BATCH = 32
Progress = Callable[[float], None]


def render_video(
    source: Path | str | PreviewSource,
    out: Path | str,
    *,
    audio: Path | str | None = None,
    identity: int | str | Identity = 0,
    second_view: str = "mouth",
    force: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Render a take as an MP4 with its recording.

    Frame i of the video shows the curves at i/fps and the sound starts with frame 0, so that
    picture and sound agree exactly. Curves longer than the recording continue in silence.

    Parameters
    ----------
    source : Path, str or PreviewSource
        Take folder, or a file of curves.
    out : Path or str
        The ``.mp4`` to write.
    audio : Path or str, optional
        Recording, if the source has none. Without one the video is silent.
    identity : int, str or Identity, optional
        Head of the video.
    second_view : str, optional
        Name of the right-hand camera, one of `rig.face.render.VIEWS`.
    force : bool, optional
        Replace an existing file.
    progress : callable, optional
        Called with the share done, 0 to 1.

    Raises
    ------
    PreviewError
        If the source cannot be shown or the target is no video.
    rig.errors.TargetError
        If the target exists and `force` is not set, or it cannot be written.
    MissingError
        If there is no encoder for it.
    """
    out = Path(out)
    if out.suffix.lower() != ".mp4":
        raise PreviewError(f"{out} has suffix {out.suffix or 'none'!r}; a video is a .mp4 file")
    check_file(out, force=force)
    if second_view not in VIEWS:
        raise PreviewError(f"view {second_view!r} is unknown; use one of {', '.join(VIEWS)}")
    encoder = find_encoder()
    shown = source if isinstance(source, PreviewSource) else load_source(source, audio)
    check_board(shown)
    frames = draw_frames(shown, identity=identity, second_view=second_view)
    with atomic_write(out) as beside:
        write_mp4(
            beside,
            _counted(frames, len(shown.curves), progress),
            fps=shown.curves.fps,
            size=(WIDTH, FACE_HEIGHT + PANEL_HEIGHT),
            samples=shown.samples,
            sample_rate=shown.sample_rate,
            encoder=encoder,
        )
    return out


def draw_frames(
    source: PreviewSource,
    *,
    identity: int | str | Identity = 0,
    second_view: str = "mouth",
) -> Iterator[Picture]:
    """Pictures (720, 960, 3) of every frame, in order."""
    from rig.face.render.software import Renderer  # compiles; half a second to import

    head = build_head(identity)
    widths = ("face", FACE_WIDTH), (second_view, WIDTH - FACE_WIDTH)
    views = [Renderer(head.mesh, (width, FACE_HEIGHT), VIEWS[name]) for name, width in widths]
    panel = Panel(source, (WIDTH, PANEL_HEIGHT))
    values, share = source.curves.values, neck_share(head.mesh.vertices)
    for start in range(0, len(values), BATCH):
        poses: AnyFloat = head.pose(values[start : start + BATCH])
        accent = accents(head, values[start : start + BATCH], poses)
        if source.curves.head is not None:
            poses = turned(poses, source.curves.head[start : start + BATCH], share)
        for k, pose in enumerate(poses):
            normals = head.mesh.normals(pose)
            picture = np.empty((FACE_HEIGHT + PANEL_HEIGHT, WIDTH, 3), np.uint8)
            picture[:FACE_HEIGHT, :FACE_WIDTH] = views[0].render(pose, normals, accent[k])
            picture[:FACE_HEIGHT, FACE_WIDTH:] = views[1].render(pose, normals, accent[k])
            picture[FACE_HEIGHT:] = panel.at(start + k)
            # Title, time code, emotion and intensity over the faces.
            time_code = panel.time_code(start + k)
            frame = start + k
            label(picture, source.title[:40], (14, 14))
            label(picture, time_code, (14, FACE_HEIGHT - 24))
            curves = source.curves
            words = []
            if curves.emotion is not None:
                strongest = int(curves.emotion[frame].argmax())
                words.append(f"{LABELS[strongest]} {curves.emotion[frame, strongest]:.0%}")
            if curves.intensity is not None:
                words.append(f"intensity {curves.intensity[frame]:.2f}")
            if words:
                label(picture, "  ".join(words), (FACE_WIDTH + 14, 14))
            yield picture


def _counted(frames: Iterator[Picture], total: int, progress: Progress | None) -> Iterator[Picture]:
    """The frames; `progress` is called with the share done."""
    for done, frame in enumerate(frames, 1):
        yield frame
        if progress is not None:
            progress(done / total)
