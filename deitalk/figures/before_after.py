"""Captured curves, and those of a model before and after it was tuned."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.figures.canvas import drawing
from deitalk.figures.validation import SHOWN_SECONDS
from rig.arrays import Float32

COLOURS = {"before": "C0", "after": "C3"}


class Shown(NamedTuple):
    """One clip: a column of the picture."""

    captured: dict[str, Float32]
    """By control [shape=(T,)]."""
    predicted: dict[str, dict[str, Float32]]
    """By ``before`` and ``after``, then by control."""


def draw_before_after(path: Path, clips: Sequence[Shown]) -> None:
    """Draw clips side by side, a row for each control.

    Parameters
    ----------
    path : Path
        .png, .svg or .pdf; its folder must exist.
    clips : sequence of Shown
        At least one; all of the same controls.

    Raises
    ------
    MissingError
        If matplotlib is not installed.
    """
    names = list(clips[0].captured)
    with drawing(path, (7 * len(clips), 1.9 * len(names))) as figure:
        grid = figure.subplots(len(names), len(clips), sharex="col", squeeze=False)
        for column, clip in zip(grid.T, clips, strict=True):
            for axis, name in zip(column, names, strict=True):
                times = np.arange(len(clip.captured[name])) / FRAME_RATE
                axis.fill_between(times, 0, clip.captured[name], color="0.8", lw=0, label="capture")
                for system, curves in clip.predicted.items():
                    axis.plot(times, curves[name], color=COLOURS[system], lw=1.1, label=system)
                axis.set_title(name, loc="left", fontsize=9)
            column[0].legend(loc="upper right", fontsize=7, ncols=3, frameon=False)
            column[-1].set_xlabel("seconds")
            column[-1].set_xlim(0, min(times[-1] + 1 / FRAME_RATE, SHOWN_SECONDS))
