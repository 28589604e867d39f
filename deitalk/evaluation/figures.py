"""Figures drawn with matplotlib: curves, clips of a training."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.errors import MissingError
from rig import RigCurves
from rig.arrays import AnyFloat, Float32
from rig.files import atomic_write

MOST_COLUMNS = 2000
"""Most columns of a drawn waveform."""


def can_draw() -> bool:
    """Whether matplotlib is installed."""
    return find_spec("matplotlib") is not None


def check_drawing() -> None:
    """Check that pictures can be drawn.

    Raises
    ------
    MissingError
        If matplotlib is not installed.
    """
    if not can_draw():
        raise MissingError("pictures need matplotlib; pip install matplotlib")


@contextmanager
def drawing(path: Path, size: tuple[float, float], dpi: int = 90) -> Iterator[Any]:
    """Yield a figure; write it to `path` when the block is done.

    Parameters
    ----------
    path : Path
        .png, .svg or .pdf; its folder must exist.
    size : (float, float)
        Width and height, inches.
    dpi : int
        Pixels per inch of a .png.

    Raises
    ------
    MissingError
        If matplotlib is not installed.
    """
    check_drawing()
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # not those of a matplotlibrc in the working folder
        figure = Figure(figsize=size, layout="constrained")
        yield figure
        with atomic_write(path) as beside:
            figure.savefig(beside, dpi=dpi)


def draw_waveform(axis: Any, waveform: Float32) -> None:
    """Draw the band between the lowest and the highest sample of every column, over seconds."""
    step = max(len(waveform) // MOST_COLUMNS, 1)
    blocks = waveform[: len(waveform) // step * step].reshape(-1, step)
    times = np.arange(len(blocks)) * step / SAMPLE_RATE
    axis.fill_between(times, blocks.min(axis=1), blocks.max(axis=1), color="0.6", lw=0)


# Figure of curves against the waveform: ``deitalk animate -o curves.png``.

ROWS = (
    ("jaw", ("CTRL_C_jaw.ty",)),
    ("lips together", ("CTRL_L_mouth_lipsTogetherD.ty",)),
    ("rounding", ("CTRL_L_mouth_funnelU.ty", "CTRL_L_mouth_purseU.ty")),
    ("lip on teeth", ("CTRL_L_mouth_lipBiteD.ty",)),
    ("expression", ("CTRL_L_mouth_cornerPull.ty", "CTRL_L_mouth_cornerDepress.ty",
                    "CTRL_L_brow_down.ty", "CTRL_L_brow_raiseIn.ty", "CTRL_L_eye_cheekRaise.ty")),
    ("lids", ("CTRL_L_eye_blink.ty",)),
)  # fmt: skip
"""Rows of the picture: a title and the controls drawn."""


def draw_curves(curves: RigCurves, waveform: Float32, path: Path, title: str) -> None:
    """Draw curves against the sound: waveform with intensity, then a row per group of controls.

    Parameters
    ----------
    curves : RigCurves
        Board curves with the intensity track.
    waveform : array [shape=(S,)]
        Mono at 16 kHz.
    path : Path
        .png, .svg or .pdf.
    title : str
        Printed above the waveform.

    Raises
    ------
    MissingError
        If matplotlib is not installed.
    """
    with drawing(path, (12, 1.3 * (len(ROWS) + 1.6))) as figure:
        axes = figure.subplots(
            len(ROWS) + 1, 1, sharex=True, height_ratios=[1.6, *([1.0] * len(ROWS))]
        )
        axis = axes[0]
        draw_waveform(axis, waveform)
        strength = axis.twinx()
        strength.plot(curves.times, curves.intensity, color="crimson")
        strength.set_ylim(0, 1.05)
        strength.set_ylabel("intensity", color="crimson")
        axis.set_title(title, loc="left")
        times = curves.times
        for axis, (label, names) in zip(axes[1:], ROWS, strict=True):
            for name in names:
                short = name.removeprefix("CTRL_").removesuffix(".ty")
                axis.plot(times, curves[name], lw=1.2, label=short)
            axis.set_ylabel(label, rotation=0, ha="right", va="center")
            axis.set_ylim(-0.05, 1.05)
            axis.legend(loc="upper right", fontsize=7, ncols=len(names), frameon=False)
        axes[-1].set_xlabel("seconds")


# Clips over time, target and prediction: the picture of an evaluation while training.
#
# Letters: S samples, T frames.

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
