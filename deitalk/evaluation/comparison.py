"""Scores of curves on captures, for any rig, against the captures' mean pose.

An error in control units says little by itself: a face that does not move errs little on a calm
actor. So the squared error is divided by that of the mean pose of the training captures: 1 is as
good as a still face, 0 perfect. Letters: T frames, C controls.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from deitalk.data.clips import Clip, spread_clips
from deitalk.data.windows import load_clip
from deitalk.evaluation.scores import correlation, mean_of_finite
from deitalk.evaluation.smoothness import MAX_CLIPS, MOVING, Example, load_example, predict
from deitalk.models.curve_model import DEITalk
from rig import ControlSet
from rig.arrays import Bool, Float32

DEAD = 1e-3
"""Standard deviation over all captures below which a channel is dead."""
STILL = 1e-5
"""Standard deviation below which predicted curves have no correlation."""


class MeanPose(NamedTuple):
    """The face that captures have on the average."""

    values: Float32
    """Mean of every control over the clips that know it [shape=(C,)]; else its rest."""
    moving: Bool
    """Controls whose standard deviation is above 0.02 [shape=(C,)]."""
    alive: Bool
    """Known controls that move at all [shape=(C,)]: a dead channel shows nothing of an actor."""


def mean_pose(clips: Iterable[Clip], controls: ControlSet, learnt: Bool) -> MeanPose:
    """Mean and motion of captures.

    Parameters
    ----------
    clips : iterable of Clip
        At least one.
    controls : ControlSet
        Columns of the curves.
    learnt : array [shape=(C,)]
        Controls that were trained on captures; others do not count as moving.
    """
    count, total, square = (np.zeros(len(controls)) for _ in range(3))
    for clip in clips:
        loaded = load_clip(clip, controls, sound=False)
        values = loaded.values.astype(np.float64)
        count += len(values) * loaded.known
        total += values.sum(axis=0) * loaded.known
        square += np.square(values).sum(axis=0) * loaded.known
    known = count > 0
    mean = np.where(known, total / np.maximum(count, 1), controls.rest)
    variance = square / np.maximum(count, 1) - np.square(mean)
    moving = known & learnt & (variance > MOVING**2)
    return MeanPose(mean.astype(np.float32), moving, known & (variance > DEAD**2))


@dataclass(frozen=True)
class CaptureSet:
    """Captured clips that are held out."""

    examples: tuple[Example, ...]
    controls: ControlSet
    pose: MeanPose
    learnt: Bool

    @classmethod
    def of(
        cls, clips: Sequence[Clip], controls: ControlSet, pose: MeanPose, learnt: Bool
    ) -> "CaptureSet":
        """Read up to 60 clips, evenly spread over the list."""
        examples = tuple(load_example(clip, controls) for clip in spread_clips(clips, MAX_CLIPS))
        return cls(examples, controls, pose, learnt)

    @torch.no_grad()
    def score(self, model: DEITalk) -> dict[str, float]:
        """Scores of the network's curves before any rule; see `score_curves`."""
        curves = [
            np.clip(predict(model, example)[0], self.controls.minimum, self.controls.maximum)
            for example in self.examples
        ]
        return self.score_curves(curves)

    def score_curves(self, predicted: Sequence[Float32]) -> dict[str, float]:
        """Squared error by that of the mean pose, and mean r.

        Parameters
        ----------
        predicted : sequence of array [shape=(T, C)]
            For each example.

        Returns
        -------
        dict
            ``error_of_mean_pose``: squared error of all moving and known controls over that of the
            mean pose; ``error_at_best_gain``: the same where each predicted control has the
            factor, at least 0, and the offset with which its error on these examples is least: what
            timing and shape leave; ``mean_r``: Pearson's r, mean over clips and such controls;
            ``range``: the predicted standard deviation over the captured one, median; ``score``:
            1 less the first, the larger the better.
        """
        error, left, still, rs, ranges = 0.0, 0.0, 0.0, [], []
        for place in np.flatnonzero(self.pose.moving):
            pairs = [
                (example.curves[:, place], curves[: len(example.curves), place])
                for example, curves in zip(self.examples, predicted, strict=True)
                if example.known[place]
            ]
            rs += [_r(*pair) for pair in pairs]
            ranges += [_range(*pair) for pair in pairs]
            if pairs:
                target, given = (np.concatenate(values) for values in zip(*pairs, strict=True))
                error += float(np.square(target - given).sum())
                still += float(np.square(target - self.pose.values[place]).sum())
                unexplained = 1 - max(np.nan_to_num(_r(target, given)), 0) ** 2
                left += float(np.square(target - target.mean()).sum() * unexplained)
        share = error / still if still > 0 else float("nan")
        return {
            "error_of_mean_pose": share,
            "error_at_best_gain": left / still if still > 0 else float("nan"),
            "mean_r": mean_of_finite(rs),
            "range": float(np.nanmedian(ranges)) if np.isfinite(ranges).any() else float("nan"),
            "score": 1 - share if np.isfinite(share) else 0.0,
        }


def _r(target: Float32, given: Float32) -> float:
    """Pearson's r; NaN of a prediction that does not move."""
    return float("nan") if given.std() < STILL else correlation(target, given)


def _range(target: Float32, given: Float32) -> float:
    """The predicted standard deviation over the captured one; NaN of a still target."""
    return float(given.std() / target.std()) if target.std() > DEAD else float("nan")
