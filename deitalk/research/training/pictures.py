"""Pictures of an evaluation while training: fixed clips over time, target and prediction.

``curves/<step>.png`` of a run folder, where matplotlib is installed.

Letters: S samples, T frames.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.data.clips import Clip
from deitalk.evaluation.captures import SHOWN_SECONDS
from deitalk.evaluation.figures import can_draw, draw_waveform, drawing
from deitalk.evaluation.smoothness import Example, lips_together, load_example, predict
from deitalk.evaluation.validation import JAW
from deitalk.models.curve_model import DEITalk
from rig import ControlSet
from rig.arrays import AnyFloat
from rig.files import remove_leftovers

N_SHOWN = 2
"""Validation clips that are drawn at every evaluation."""
LIMITS = (-0.05, 1.05)
"""Limits of the axes of a picture."""


class Row(NamedTuple):
    """One quantity of a clip over time."""

    label: str
    target: AnyFloat | None
    """[shape=(T,)], NaN where unknown; drawn as an area."""
    predicted: AnyFloat | None
    """[shape=(T,)]; drawn as a line."""
    limits: tuple[float, float] | None = None
    """Limits of the axis; None: from 0 to the largest number."""


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


class DrawsClips:
    """A task whose evaluations draw clips."""

    rows: Sequence[ClipRows] = ()
    """Rows of the last evaluation."""

    def draw(self, out: Path, step: int) -> None:
        """Draw the clips of an evaluation into a run folder; names sort by step."""
        if self.rows and can_draw():
            folder = out / "curves"
            folder.mkdir(exist_ok=True)
            remove_leftovers(folder)  # of a run that was killed
            draw_clips(folder / f"{step:06d}.png", self.rows)


def shown_examples(clips: Sequence[Clip], controls: ControlSet) -> dict[str, Example]:
    """Load the first and the last clip, of the recorded ones where there are any, by name."""
    chosen = [clip for clip in clips if clip.source == "recording"] or list(clips)
    places = np.unique(np.linspace(0, len(chosen) - 1, min(N_SHOWN, len(chosen))).astype(int))
    return {chosen[i].name: load_example(chosen[i], controls) for i in places}


def clip_rows(name: str, example: Example, model: DEITalk) -> ClipRows:
    """Jaw, lips and intensity of a clip: the targets, and what a model predicts.

    Of a rig other than the board, the three controls that move most.

    Parameters
    ----------
    name : str
        Of the clip.
    example : Example
        The targets.
    model : DEITalk
        In evaluation mode.
    """
    curves, intensity = predict(model, example)
    if JAW not in model.controls.names:
        places = np.argsort(-example.curves.std(axis=0), kind="stable")[:3]
        most = [
            Row(model.controls.names[i], example.curves[:, i], curves[:, i], LIMITS) for i in places
        ]
        return ClipRows(f"{name} ({example.emotion})", example.waveform, most, FRAME_RATE)
    jaw = model.controls.index(JAW)
    target, predicted = (lips_together(c, model.controls) for c in (example.curves, curves))
    rows = (
        Row("jaw", example.curves[:, jaw], curves[:, jaw], LIMITS),
        Row("lips together", target, predicted, LIMITS),
        Row("intensity", example.intensity, intensity, LIMITS),
    )
    return ClipRows(f"{name} ({example.emotion})", example.waveform, rows, FRAME_RATE)
