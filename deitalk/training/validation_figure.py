"""The same few clips at every evaluation of a training: ``RUN/curves/<step>.png``.

A score says that a network got better, a picture at what: lips that meet, a jaw that follows, an
intensity that moves with the voice. Letters: T frames, C controls.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.data.clips import Clip
from deitalk.evaluation.validation import Example, lips_together, load_example, predict
from deitalk.figures.canvas import draw_waveform, drawing
from deitalk.models.curve_model import DEITalk
from rig import ControlSet
from rig.arrays import Float32

N_CLIPS = 2
SHOWN_SECONDS = 8.0
"""Of longer clips the beginning is shown."""
JAW = "CTRL_C_jaw.ty"


@dataclass(frozen=True)
class FixedClips:
    """Whole clips by name."""

    examples: dict[str, Example]
    controls: ControlSet

    @classmethod
    def of(cls, clips: Sequence[Clip], controls: ControlSet) -> "FixedClips":
        """Choose the first and the last clip, of the recorded ones where there are any."""
        chosen = [clip for clip in clips if clip.source == "recording"] or list(clips)
        places = np.unique(np.linspace(0, len(chosen) - 1, min(N_CLIPS, len(chosen))).astype(int))
        return cls({chosen[i].name: load_example(chosen[i], controls) for i in places}, controls)

    def draw(self, model: DEITalk, path: Path) -> None:
        """Draw waveform, jaw, lips and intensity: the targets, and what a model predicts.

        Parameters
        ----------
        model : DEITalk
            In evaluation mode.
        path : Path
            .png, .svg or .pdf; its folder must exist.

        Raises
        ------
        MissingError
            If matplotlib is not installed.
        """
        size = (7 * max(len(self.examples), 1), 7)
        with drawing(path, size) as figure:
            grid = figure.subplots(4, max(len(self.examples), 1), sharex="col", squeeze=False)
            for column, (name, example) in zip(grid.T, self.examples.items(), strict=False):
                self._draw_clip(column, model, example)
                column[0].set_title(f"{name} ({example.emotion})", loc="left")

    def _draw_clip(self, column: Sequence[Any], model: DEITalk, example: Example) -> None:
        curves, strength = predict(model, example)
        draw_waveform(column[0], example.waveform)
        jaw = self.controls.index(JAW)
        rows = (
            ("jaw", example.curves[:, jaw], curves[:, jaw]),
            (
                "lips together",
                lips_together(example.curves, self.controls),
                lips_together(curves, self.controls),
            ),
            ("intensity", example.intensity, strength),
        )
        for axis, (label, target, predicted) in zip(column[1:], rows, strict=True):
            _draw_pair(axis, label, target, predicted)
        column[1].legend(loc="upper right", fontsize=7, ncols=2, frameon=False)
        column[-1].set_xlabel("seconds")
        column[-1].set_xlim(0, min(len(curves) / 30, SHOWN_SECONDS))


def _draw_pair(axis: Any, label: str, target: Float32, predicted: Float32 | None) -> None:
    """A target as an area, a prediction as a line; an intensity may be unknown or not predicted."""
    times = np.arange(len(target)) / 30
    axis.fill_between(times, 0, np.nan_to_num(target), color="0.8", lw=0, label="target")
    if predicted is not None:
        axis.plot(times, predicted, color="C3", lw=1.1, label="predicted")
    axis.set_ylabel(label)
    axis.set_ylim(-0.05, 1.05)
