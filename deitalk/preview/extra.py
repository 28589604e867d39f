"""Previews inside a take folder: what ``deitalk animate --preview`` adds."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deitalk.preview.page import render_page
from deitalk.preview.source import PreviewSource
from deitalk.preview.video import render_video

if TYPE_CHECKING:
    from deitalk.animate import Performance

VIDEO, PAGE = "preview.mp4", "preview.html"


def write_previews(folder: Path, performance: "Performance") -> dict[str, str]:
    """Write the review video and the page into a take folder; an `Extra` of `write_take`.

    Returns
    -------
    dict of str to str
        File names and what they are.

    Raises
    ------
    MissingError
        If ffmpeg or the page's player is not installed.
    """
    source = performance_source(performance)
    render_video(source, folder / VIDEO)
    render_page(source, folder / PAGE)
    return {
        VIDEO: "review video: face, mouth, sound, emotion, intensity and key curves",
        PAGE: "page that plays the take; opens offline, intensity can be dragged",
    }


def performance_source(performance: "Performance") -> PreviewSource:
    """What a preview shows of a performance."""
    recording = performance.recording
    return PreviewSource(
        Path(recording.source).stem or "take",
        performance.curves,
        np.asarray(recording.waveform, np.float32),
        recording.sample_rate,
        np.asarray(performance.neutral.values, np.float32),
    )
