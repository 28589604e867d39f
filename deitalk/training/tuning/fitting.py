"""A tuned model on new captures: scored on them, or fitted to a few seconds of a take.

Seconds of captures teach no map of the sound, but they tell which convention a take has, how its
face rests and how far each control moves: the nearest style, gains and offsets.
"""

import copy
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import nn

from deitalk.data.clips import Clip
from deitalk.errors import DataError
from deitalk.evaluation.captures import System, by_model, write_comparison
from deitalk.evaluation.comparison import CaptureSet, mean_pose
from deitalk.evaluation.smoothness import load_example, predict
from deitalk.models.curve_model import DEITalk
from deitalk.training.tuning.recipe import learnt_controls
from rig import ControlSet
from rig.arrays import Bool, Float32, Float64
from rig.errors import ControlError

PRIOR_FRAMES = 150.0
"""Frames that the model's own spread and rest count as: 5 s."""
GAINS = (0.3, 3.0)
"""Range of the gains."""


class Fit(NamedTuple):
    """A fitted model."""

    model: DEITalk
    """Without a name its face is the fitted one; actors stay as they were."""
    style: str
    """The style that was nearest; empty: the model's own or the mean one."""
    error: float
    """Squared error on the clips over that of the model before, without a name."""


def score_model(model: DEITalk, clips: Sequence[Clip], folder: Path) -> dict[str, Any]:
    """Score a model on clips it never saw, and write the report of `write_comparison`.

    Parameters
    ----------
    model : DEITalk
        Of the clips' rig.
    clips : sequence of Clip
        Each is predicted in the style of its actor, if the model has it.
    folder : Path
        Exists.

    Returns
    -------
    dict
        Scores of each system; ``after`` is the model, and beside it are its styles, the mean pose
        of these clips and loudness.

    Raises
    ------
    DataError
        If there is no clip, or they are of another rig.
    """
    if not clips:
        raise DataError("no clips to score on")
    controls, learnt = model.controls, learnt_controls(model.rules, model.controls)
    with _of_one_rig(clips, controls):
        captures = CaptureSet.of(clips, controls, mean_pose(clips, controls, learnt), learnt)
    plain = by_model(model)

    def styled(name: str) -> System:
        return lambda example: plain(example._replace(speaker=name))

    systems = {"after": plain} | {f"style {name}": styled(name) for name in model.actors}
    return write_comparison(folder, systems, captures, clips, held="of captures that are given")


@contextmanager
def _of_one_rig(clips: Sequence[Clip], controls: ControlSet) -> Iterator[None]:
    """Reading of clips, which say so where they are of another rig than some controls."""
    try:
        yield
    except ControlError as error:
        text = f"{clips[0].curves}: curves of another rig than {controls.id} ({error})"
        raise DataError(text) from None


class _Sums:
    """Sums of predicted and captured values of every control."""

    def __init__(self, n_controls: int) -> None:
        self.count, self.x, self.y, self.xx, self.xy, self.yy = np.zeros((6, n_controls))

    def add(self, given: Float32, target: Float32, known: Bool) -> None:
        x, y = (part.astype(np.float64) * known for part in (given, target))
        self.count += len(x) * known
        for total, part in ((self.x, x), (self.y, y)):
            total += part.sum(axis=0)
        for total, part in ((self.xx, x * x), (self.xy, x * y), (self.yy, y * y)):
            total += part.sum(axis=0)

    def line(self) -> tuple[Float64, Float64]:
        """Gain and offset of every control, held by `PRIOR_FRAMES` at 1 and 0 [shape=(C,)]."""
        count = np.maximum(self.count, 1)
        mean, wanted = self.x / count, self.y / count
        spread = self.xx / count - np.square(mean)
        together = self.xy / count - mean * wanted
        held = PRIOR_FRAMES / count
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = (together + held * spread) / (spread * (1 + held))
        gain = np.where(spread > 1e-8, np.clip(np.nan_to_num(gain, nan=1.0), *GAINS), 1.0)
        gain = np.where(self.count > 0, gain, 1.0)
        met = mean + (wanted - mean) / (1 + held)
        return gain, np.where(self.count > 0, met - gain * mean, 0.0)

    def error(self, gain: Float64, offset: Float64) -> float:
        """Squared error of all controls with a gain and an offset."""
        error = self.yy + gain**2 * self.xx + offset**2 * self.count
        error += 2 * gain * offset * self.x - 2 * gain * self.xy - 2 * offset * self.y
        return float(error.sum())


@torch.no_grad()
def fit_model(model: DEITalk, clips: Sequence[Clip]) -> Fit:
    """Fit a model to clips of a take.

    Parameters
    ----------
    model : DEITalk
        Of the clips' rig; not changed.
    clips : sequence of Clip
        At least one.

    Raises
    ------
    DataError
        If there is no clip, or they are of another rig.
    """
    if not clips:
        raise DataError("no clips to fit to")
    names, controls = ("", *model.actors), model.controls
    sums = {name: _Sums(len(controls)) for name in names}
    for clip in clips:
        with _of_one_rig([clip], controls):
            example = load_example(clip, controls)
        for name in names:
            curves, _ = predict(model, example._replace(speaker=name))
            sums[name].add(curves, example.curves, example.known)
    lines = {name: sums[name].line() for name in names}
    errors = {name: sums[name].error(*lines[name]) for name in names}
    style = min(names, key=errors.__getitem__)
    before = sums[""].error(np.ones(len(controls)), np.zeros(len(controls)))
    fitted = copy.deepcopy(model).eval()
    _set_face(fitted, style, *lines[style])
    return Fit(fitted, style, errors[style] / max(before, 1e-12))


def _set_face(model: DEITalk, style: str, gain: Float64, offset: Float64) -> None:
    """Make a style with gains and offsets that of nobody, in place; actors stay."""
    decoder = model.rig_decoder
    output, layers = decoder.output, decoder.actor_layers
    slope, shift = (torch.from_numpy(part).to(output.bias) for part in (gain, offset))
    weight, bias = output.weight.clone(), output.bias.clone()
    if layers is not None and not layers.weight.shape[-1]:  # of offsets: the map of each is theirs
        layers.weight = nn.Parameter(weight.new_zeros(*layers.bias.shape, weight.shape[1]))
        model.config = model.config.model_copy(update={"actor_layers": True})
    if style and layers is not None:
        place = model.actors.index(style)
        weight, bias = weight + layers.weight[place], bias + layers.bias[place]
    weight, bias = slope[:, None] * weight, slope * bias + shift
    if layers is not None:
        layers.weight.add_(output.weight - weight)
        layers.bias.add_(output.bias - bias)
    output.weight.copy_(weight)
    output.bias.copy_(bias)
