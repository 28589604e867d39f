"""What every training of a DEITalk model has: its network, and clips that are drawn (DEITalk §4.1).

The loop is `deitalk.training.trainer`.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.config.curves import Config
from deitalk.config.rig_file import read_controls
from deitalk.data.clips import Clip
from deitalk.data.frozen_features import FrozenFeatures
from deitalk.data.windows import Window, count_windows
from deitalk.evaluation.clips_figure import ClipRows, Row
from deitalk.evaluation.smoothness import Example, lips_together, load_example, predict
from deitalk.models.checkpoint import network_class
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import network_shapes
from deitalk.training.run_folder import record_data
from deitalk.training.trainer import Task
from rig import ControlSet

N_SHOWN = 2
"""Validation clips that are drawn at every evaluation."""
JAW = "CTRL_C_jaw.ty"
LIMITS = (-0.05, 1.05)
"""Of the axes of a picture."""


class CurveTask(Task[Window]):
    """DEITalk's network on windows of curves.

    Parameters
    ----------
    config : Config
        Model, loss, data and schedule.
    data : Path
        Dataset folder.
    frozen_features : FrozenFeatures or None
        Those of the frontend, where several runs share them.

    Raises
    ------
    ConfigError
        If the network is too large.
    """

    config: Config
    model: DEITalk
    clips: Sequence[Clip]
    """Those to train on."""

    def __init__(
        self, config: Config, data: Path, *, frozen_features: FrozenFeatures | None = None
    ) -> None:
        self.config, self.data, self.frozen_features = config, data, frozen_features
        self.controls = read_controls(config.model.control_set)
        network_shapes(self._network)  # not too large to be built

    def _network(self, pretrained: bool = False) -> DEITalk:
        config = self.config
        network = network_class(config.model)
        return network(config.model, self.controls, pretrained=pretrained, rules=config.rules)

    def read(self, out: Path) -> None:
        """Check that a resumed run has its own data."""
        record_data(out, self.data)

    def epoch_size(self) -> int:
        """All windows of all clips."""
        return count_windows(self.clips, self.config.data)


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
