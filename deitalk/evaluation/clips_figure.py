"""Clips over time, target and prediction: the picture of an evaluation while training.

Letters: S samples, T frames.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deitalk.evaluation.figures import draw_waveform, drawing
from rig.arrays import AnyFloat

SHOWN_SECONDS = 8.0
"""Of longer clips the beginning is shown."""


class Row(NamedTuple):
    """One quantity of a clip over time."""

    label: str
    target: AnyFloat | None
    """[shape=(T,)], NaN where unknown; drawn as an area."""
    predicted: AnyFloat | None
    """[shape=(T,)]; drawn as a line."""
    limits: tuple[float, float] | None = None
    """Of the axis; None: from 0 to the largest number."""


class ClipRows(NamedTuple):
    """One clip: a column of the picture."""

    title: str
    waveform: AnyFloat
    """[shape=(S,), 16 kHz]."""
    rows: Sequence[Row]
    fps: float


def draw_clips(path: Path, clips: Sequence[ClipRows]) -> None:
    """Draw clips side by side: the waveform, and below it the rows.

    Parameters
    ----------
    path : Path
        .png, .svg or .pdf; its folder must exist.
    clips : sequence of ClipRows
        At least one; all with as many rows.

    Raises
    ------
    MissingError
        If matplotlib is not installed.
    """
    n_rows = 1 + len(clips[0].rows)
    with drawing(path, (7 * len(clips), 1.75 * n_rows)) as figure:
        grid = figure.subplots(n_rows, len(clips), sharex="col", squeeze=False)
        for column, clip in zip(grid.T, clips, strict=True):
            column[0].set_title(clip.title, loc="left")
            draw_waveform(column[0], clip.waveform)
            for axis, row in zip(column[1:], clip.rows, strict=True):
                _draw_row(axis, row, clip.fps)
            column[1].legend(loc="upper right", fontsize=7, ncols=2, frameon=False)
            seconds = max(
                len(curve) for row in clip.rows for curve in row[1:3] if curve is not None
            )
            column[-1].set_xlabel("seconds")
            column[-1].set_xlim(0, min(seconds / clip.fps, SHOWN_SECONDS))


def _draw_row(axis: Any, row: Row, fps: float) -> None:
    if row.target is not None:
        times = np.arange(len(row.target)) / fps
        target = np.nan_to_num(row.target)
        axis.fill_between(times, 0, target, color="0.8", lw=0, label="target")
    if row.predicted is not None:
        times = np.arange(len(row.predicted)) / fps
        axis.plot(times, row.predicted, color="C3", lw=1.1, label="predicted")
    axis.set_ylabel(row.label)
    axis.set_ylim(*(row.limits or (0, None)))
