"""The review video: two views of the face over the sound and the curves, with the recording."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deitalk.errors import MissingError
from deitalk.preview.page import check_player
from deitalk.preview.source import PreviewError, PreviewSource, check_board, load_source
from rig.arrays import AnyFloat, Float32
from rig.emotions import COLORS, LABELS
from rig.face import build_head
from rig.face.accents import accents, neck_share, turned
from rig.face.identity import Identity
from rig.face.render import VIEWS
from rig.face.render.shading import Picture, text_width, write_text
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
    sizes = {"face": (FACE_WIDTH, FACE_HEIGHT), second_view: (WIDTH - FACE_WIDTH, FACE_HEIGHT)}
    views = [Renderer(head.mesh, size, VIEWS[name]) for name, size in sizes.items()]
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


# The strip under the faces: waveform, emotion, intensity, key curves, playhead and time.


KEY_CURVES: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("jaw open", ("CTRL_C_jaw.ty",)),
    ("lips together", tuple(f"CTRL_{s}_mouth_lipsTogether{v}.ty" for s in "LR" for v in "UD")),
    ("round lips", tuple(f"CTRL_{s}_mouth_{k}{v}.ty" for s in "LR" for v in "UD"
                         for k in ("funnel", "purse"))),
    ("smile", tuple(f"CTRL_{s}_mouth_cornerPull.ty" for s in "LR")),
    ("brow down", tuple(f"CTRL_{s}_brow_down.ty" for s in "LR")),
    ("blink", tuple(f"CTRL_{s}_eye_blink.ty" for s in "LR")),
)  # fmt: skip
"""Six lanes; each shows the maximum of its controls."""

CURVE_COLORS = (
    (240, 170, 90),
    (120, 200, 160),
    (120, 170, 240),
    (245, 200, 80),
    (226, 96, 84),
    (180, 150, 230),
)
_BACK, _LANE, _TEXT = (22, 24, 28), (34, 37, 43), (205, 210, 218)
_MARGIN = 108


class Panel:
    """Strip of lanes, drawn once, with a playhead drawn per frame.

    Parameters
    ----------
    source : PreviewSource
    size : (int, int)
        Width and height, pixels.
    """

    def __init__(self, source: PreviewSource, size: tuple[int, int]) -> None:
        self._source = source
        self._size = size
        self._seconds = max(source.curves.duration, 1 / source.curves.fps)
        # Name, top and height of every lane.
        height = self._size[1]
        plan = [("sound", 0.24), ("emotion", 0.08), ("intensity", 0.14)]
        plan += [(name, 0.54 / len(KEY_CURVES)) for name, _ in KEY_CURVES]
        lanes, top = [], 6.0
        for name, share in plan:
            tall = share * (height - 12)
            lanes.append((name, round(top), round(tall) - 3))
            top += tall
        self._lanes = lanes
        self._picture = self._draw()

    def at(self, frame: int) -> Picture:
        """The strip (height, width, 3) with the playhead at `frame`."""
        seconds = frame / self._source.curves.fps
        picture = self._picture.copy()
        column = int(_MARGIN + seconds / self._seconds * (self._size[0] - _MARGIN - 12))
        picture[:, column : column + 2] = (250, 250, 250)
        return picture

    def time_code(self, frame: int) -> str:
        """Minutes, seconds, frame of the second, and frame number."""
        fps = self._source.curves.fps
        whole, rest = divmod(frame / fps, 60)
        return f"{int(whole):02d}:{rest:06.3f}  frame {frame}  {fps:.6g} fps"

    def _draw(self) -> Picture:
        width, height = self._size
        picture = np.empty((height, width, 3), np.uint8)
        picture[:] = _BACK
        left, right = _MARGIN, width - 12
        for name, top, tall in self._lanes:
            lane = picture[top : top + tall, left:right]
            lane[:] = _LANE
            self._fill(name, lane)
        for name, top, tall in self._lanes:
            picture = write_text(picture, name, (8, top + tall // 2 - 4), height=9, color=_TEXT)
        return picture

    def _fill(self, name: str, lane: Picture) -> None:
        curves = self._source.curves
        if name == "sound":
            _draw_sound(lane, self._source, self._seconds)
        elif name == "emotion":
            # Colour of every frame's emotions, mixed by their weights.
            emotion = curves.emotion
            if emotion is not None:
                frames = np.linspace(0, len(emotion) - 1, lane.shape[1]).round().astype(int)
                weight = emotion[frames] / np.maximum(emotion[frames].sum(1, keepdims=True), 1e-6)
                lane[:] = (
                    weight @ np.array([[*bytes.fromhex(color[1:])] for color in COLORS.values()])
                ).astype(np.uint8)[None]
        elif name == "intensity":
            if curves.intensity is not None:
                _draw_curve(lane, curves.intensity / max(1.0, float(curves.intensity.max())),
                            (250, 250, 250))  # fmt: skip
        else:
            place = [key for key, _ in KEY_CURVES].index(name)
            controls = KEY_CURVES[place][1]
            values = np.max([np.maximum(curves[c], 0) for c in controls], axis=0)
            _draw_curve(lane, values, CURVE_COLORS[place])


def _draw_sound(lane: Picture, source: PreviewSource, seconds: float) -> None:
    """Smallest and largest sample of every column."""
    tall, width = lane.shape[:2]
    if not source.sample_rate:
        return
    edges = np.linspace(0, seconds * source.sample_rate, width + 1).astype(int)
    loudest = max(float(np.abs(source.samples).max(initial=0.0)), 1e-4)
    for x, (a, b) in enumerate(pairwise(edges)):
        part = source.samples[a : max(b, a + 1)]
        if len(part):
            low, high = (0.5 - 0.48 * part.max() / loudest, 0.5 - 0.48 * part.min() / loudest)
            lane[int(low * tall) : int(high * tall) + 1, x] = (110, 160, 200)


def _draw_curve(lane: Picture, values: Float32, color: tuple[int, int, int]) -> None:
    """A filled curve of values 0..1."""
    tall, width = lane.shape[:2]
    frames = np.linspace(0, len(values) - 1, width)
    level = np.interp(frames, np.arange(len(values)), np.clip(values, 0, 1))
    top = ((1 - level) * (tall - 2)).astype(int)
    rows = np.arange(tall)[:, None]
    lane[:] = np.where((rows > top)[..., None], lane * 0.55 + 0.45 * np.array(color) * 0.6, lane)
    line = np.abs(rows - top) <= 1
    lane[line] = color


def label(picture: Picture, text: str, place: tuple[int, int], height: int = 11) -> None:
    """Write `text` into `picture` on a dark plate, so that it can be read over a face."""
    x, y = place
    plate = picture[y - 4 : y + height + 4, x - 6 : x + text_width(text, height) + 4]
    plate[:] = write_text((plate * 0.35).astype(np.uint8), text, (6, 4), height=height)


# Requirements of a preview, checked before the work begins.


PAGES, VIDEOS = (".html", ".htm"), (".mp4",)


def check_needs(targets: Iterable[Path]) -> tuple[str, ...]:
    """Check that this installation can make every given file.

    Parameters
    ----------
    targets : paths
        ``.html`` and ``.mp4`` files to write.

    Returns
    -------
    tuple of str
        Notes for the user on the files to write.

    Raises
    ------
    PreviewError
        For another suffix.
    MissingError
        Without the built page, or without a video encoder.
    """
    notes = []
    for target in targets:
        suffix = target.suffix.lower()
        if suffix in PAGES:
            check_player()
        elif suffix in VIDEOS:
            notes.append(find_encoder().note)
        else:
            raise PreviewError(
                f"{target} has suffix {target.suffix or 'none'!r}; use .mp4 or .html"
            )
    return tuple(note for note in notes if note)
