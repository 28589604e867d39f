"""The review video: two views of the face over the sound and the curves, with the recording."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deitalk.preview.mp4 import find_encoder, write_mp4
from deitalk.preview.source import PreviewError, PreviewSource, check_board, load_source
from deitalk.preview.strip import Panel, label
from rig.arrays import AnyFloat
from rig.emotions import LABELS
from rig.face import build_head
from rig.face.accents import accents
from rig.face.head_pose import neck_share, turned
from rig.face.identity import Identity
from rig.face.render import VIEWS
from rig.face.render.picture import Picture
from rig.files import atomic_write, check_file

if TYPE_CHECKING:
    pass

WIDTH, FACE_HEIGHT, PANEL_HEIGHT = 960, 480, 240
FACE_WIDTH = 540
BATCH = 64
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
    from rig.face.render.software import Renderer

    head = build_head(identity)
    widths = ("face", FACE_WIDTH), (second_view, WIDTH - FACE_WIDTH)
    views = [
        Renderer(head.mesh, (width, FACE_HEIGHT), VIEWS[name], many=True) for name, width in widths
    ]
    panel = Panel(source, (WIDTH, PANEL_HEIGHT))
    values, share = source.curves.values, neck_share(head.mesh.vertices)
    for start in range(0, len(values), BATCH):
        poses: AnyFloat = head.pose(values[start : start + BATCH])
        accent = accents(head, values[start : start + BATCH], poses)
        if source.curves.head is not None:
            poses = turned(poses, source.curves.head[start : start + BATCH], share)
        for k, pose in enumerate(poses):
            normals = views[0].normals(pose)
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
