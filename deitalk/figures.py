"""Figures drawn with matplotlib: curves, evaluations, clips of a training."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deitalk.emotions import EMOTIONS
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
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    yield figure
    with atomic_write(path) as beside:
        figure.savefig(beside, dpi=dpi)


def draw_waveform(axis: Any, waveform: Float32, sample_rate: int = 16_000) -> None:
    """Draw the band between the lowest and the highest sample of every column, over seconds."""
    step = max(len(waveform) // MOST_COLUMNS, 1)
    blocks = waveform[: len(waveform) // step * step].reshape(-1, step)
    times = np.arange(len(blocks)) * step / sample_rate
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
        _waveform(axes[0], curves, waveform, title)
        times = curves.times
        for axis, (label, names) in zip(axes[1:], ROWS, strict=True):
            for name in names:
                short = name.removeprefix("CTRL_").removesuffix(".ty")
                axis.plot(times, curves[name], lw=1.2, label=short)
            axis.set_ylabel(label, rotation=0, ha="right", va="center")
            axis.set_ylim(-0.05, 1.05)
            axis.legend(loc="upper right", fontsize=7, ncols=len(names), frameon=False)
        axes[-1].set_xlabel("seconds")


def _waveform(axis: Any, curves: RigCurves, waveform: Float32, title: str) -> None:
    draw_waveform(axis, waveform)
    strength = axis.twinx()
    strength.plot(curves.times, curves.intensity, color="crimson")
    strength.set_ylim(0, 1.05)
    strength.set_ylabel("intensity", color="crimson")
    axis.set_title(title, loc="left")


# Figure of the evaluation: closures, channels, styles, noise.


def draw_evaluation(report: dict[str, Any], path: Path) -> None:
    """Draw a report of `deitalk.evaluation.curves.evaluate`.

    Parameters
    ----------
    report : dict
        Groups, phones, styles and noise; the panel of a missing part is empty.
    path : Path
        .png, .svg or .pdf.

    Raises
    ------
    MissingError
        If matplotlib is not installed.
    """
    with drawing(path, (13, 8), dpi=100) as figure:
        axes = figure.subplots(2, 2)
        _phones(axes[0, 0], report["phones"])
        _channels(axes[0, 1], report["groups"])
        _distances(axes[1, 0], report.get("styles", {}))
        _noise(axes[1, 1], report.get("noise", {}))


def _bars(axis: Any, series: dict[str, dict[str, float]]) -> None:
    """Draw grouped bars: one colour per series, one group per name."""
    names = list(dict.fromkeys(name for values in series.values() for name in values))
    width = 0.8 / max(len(series), 1)
    for i, (label, values) in enumerate(series.items()):
        heights = [values.get(name, np.nan) for name in names]
        axis.bar(np.arange(len(names)) + i * width, heights, width, label=label)
    axis.set_xticks(np.arange(len(names)) + 0.4 - width / 2, names, rotation=40, ha="right")
    axis.set_ylim(0, 1.15)  # room for the legend
    if series:
        axis.legend(fontsize=7, frameon=False, loc="upper center", ncols=len(series))


def _phones(axis: Any, groups: dict[str, Any]) -> None:
    series = {
        name: {p: s["hits"] for phones in gestures.values() for p, s in phones.items() if s["n"]}
        for name, gestures in groups.items()
        if " " not in name
    }
    _bars(axis, series)
    axis.set_title("hit rate at 5 % false alarms over the counter-examples", loc="left")


def _channels(axis: Any, groups: dict[str, dict[str, Any]]) -> None:
    series = {
        name: {k.removeprefix("r "): v for k, v in scores.items() if k.startswith("r ")}
        for name, scores in groups.items()
        if " " not in name
    }
    _bars(axis, series)
    axis.set_title("correlation with the procedural target, per channel", loc="left")


def _distances(axis: Any, groups: dict[str, Any]) -> None:
    matrix = np.zeros((len(EMOTIONS), len(EMOTIONS)))
    for scores in groups.values():
        for pair, value in scores["distances"].items():
            i, j = (EMOTIONS.index(name) for name in pair.split("-"))
            matrix[[i, j], [j, i]] += value / len(groups)
    axis.imshow(matrix, cmap="viridis", vmax=1.5 * matrix.max() or 1.0)
    axis.set_xticks(range(len(EMOTIONS)), EMOTIONS)
    axis.set_yticks(range(len(EMOTIONS)), EMOTIONS)
    for (i, j), value in np.ndenumerate(matrix):
        axis.text(j, i, f"{value:.2f}", ha="center", va="center", color="w")
    axis.set_title("distance of two styles' mean faces, control units", loc="left")


def _noise(axis: Any, steps: dict[str, dict[str, float]]) -> None:
    for name in ("bilabial_window_auc", "bilabial_hits_at_5_percent", "jaw_r"):
        axis.plot([scores[name] for scores in steps.values()], marker="o", label=name)
    axis.set_xticks(range(len(steps)), list(steps))
    axis.set_ylim(0, 1)
    axis.legend(fontsize=7, frameon=False)
    axis.set_title("in noise", loc="left")


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
            _draw_clip(column, clip)


def _draw_clip(column: Sequence[Any], clip: ClipRows) -> None:
    column[0].set_title(clip.title, loc="left")
    draw_waveform(column[0], clip.waveform)
    for axis, row in zip(column[1:], clip.rows, strict=True):
        _draw_row(axis, row, clip.fps)
    column[1].legend(loc="upper right", fontsize=7, ncols=2, frameon=False)
    seconds = max(len(curve) for row in clip.rows for curve in row[1:3] if curve is not None)
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
