"""A review video and a page among the files of a take."""

from collections.abc import Iterable
from pathlib import Path

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.pipeline.performance import Performance
from deitalk.preview.encoding import find_encoder
from deitalk.preview.page import check_player, render_page
from deitalk.preview.source import PreviewError, PreviewSource
from deitalk.preview.video import render_video
from rig.face.identity import Identity
from rig.face.render.renderer import Backend, check_backend


def check_preview(folder: Path) -> tuple[str, ...]:
    """Check the requirements of `add_preview`; return notes on the files it will write.

    Raises
    ------
    MissingError
        Without the built page, or without a video encoder.
    """
    return check_needs([folder / "preview.html", folder / "preview.mp4"])


def add_preview(
    folder: Path, performance: Performance, identity: int | str | Identity = 0
) -> dict[str, str]:
    """Write ``preview.html`` and ``preview.mp4`` into a take folder; of another rig the page alone.

    Parameters
    ----------
    folder : Path
        Must exist.
    performance : Performance
        Its curves, neutral reading and recording are shown.
    identity : int, str or Identity
        Head of page and video.

    Returns
    -------
    dict
        File names and their descriptions, for ``take.json``.
    """
    source = PreviewSource(
        title=Path(performance.recording.source).stem,
        curves=performance.curves,
        samples=performance.recording.waveform,
        sample_rate=SAMPLE_RATE,
        neutral=performance.neutral.values,
    )
    render_page(source, folder / "preview.html", identity=identity)
    if not source.is_board:
        return {"preview.html": "sound and every curve in one page"}
    render_video(source, folder / "preview.mp4", identity=identity)
    return {
        "preview.html": "face, sound and every curve in one page; the intensity can be dragged",
        "preview.mp4": "review video",
    }


# Requirements of a preview, checked before the work begins.


PAGES, VIDEOS = (".html", ".htm"), (".mp4",)


def check_needs(targets: Iterable[Path], backend: Backend = "auto") -> tuple[str, ...]:
    """Check that this installation can make every given file.

    Parameters
    ----------
    targets : paths
        ``.html`` and ``.mp4`` files to write.
    backend : {'auto', 'opengl', 'software'}
        Renderer of a video.

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
    RigError
        If the backend is unknown, or is ``opengl`` and OpenGL is missing.
    """
    notes = []
    for target in targets:
        suffix = target.suffix.lower()
        if suffix in PAGES:
            check_player()
        elif suffix in VIDEOS:
            notes.append(find_encoder().note)
            check_backend(backend)
        else:
            raise PreviewError(
                f"{target} has suffix {target.suffix or 'none'!r}; use .mp4 or .html"
            )
    return tuple(note for note in notes if note)
