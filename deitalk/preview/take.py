"""A review video and a page among the files of a take."""

from pathlib import Path

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.pipeline.performance import Performance
from deitalk.preview.needs import check_needs
from deitalk.preview.page import render_page
from deitalk.preview.source import PreviewSource
from deitalk.preview.video import render_video
from rig.face.identity import Identity


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
