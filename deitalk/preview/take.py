"""A page among the files of a take."""

from pathlib import Path

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.pipeline.performance import Performance
from deitalk.preview.page import render_page
from deitalk.preview.source import PreviewSource
from rig.face.identity import Identity


def add_preview(
    folder: Path, performance: Performance, identity: int | str | Identity = 0
) -> dict[str, str]:
    """Write ``preview.html`` into a take folder.

    Parameters
    ----------
    folder : Path
        Must exist.
    performance : Performance
        Its curves, neutral reading and recording are shown.
    identity : int, str or Identity
        Head that is shown.

    Returns
    -------
    dict
        File name and its description, for ``take.json``.

    Raises
    ------
    MissingError
        Without the built page.
    """
    source = PreviewSource(
        title=Path(performance.recording.source).stem,
        curves=performance.curves,
        samples=performance.recording.waveform,
        sample_rate=SAMPLE_RATE,
        neutral=performance.neutral.values,
    )
    render_page(source, folder / "preview.html", identity=identity)
    about = "face, sound and every curve in one page; the intensity can be dragged"
    return {"preview.html": about if source.is_board else "sound and every curve in one page"}
