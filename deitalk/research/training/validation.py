"""Validation clips that select the weights of a training.

Recordings of people come first, where the data has any: the score is measured on voices and
microphones that are not in the loss.
"""

from dataclasses import dataclass

import numpy as np
import torch

from deitalk.data.clips import MEASURED, Clip, spread_clips
from deitalk.evaluation.scores import (
    correlation,
    emotion_parameter_error,
    lip_parameter_error,
    mean_of_finite,
)
from deitalk.evaluation.smoothness import (
    MAX_CLIPS,
    Example,
    knows_contact,
    lips_together,
    load_example,
    predict,
    speaking_frames,
)
from deitalk.evaluation.validation import ClosureScores, closure_scores, summarise_closures
from deitalk.models.curve_model import DEITalk
from rig import ControlSet
from rig.arrays import Bool, Float32

ARTICULATION = (
    "CTRL_C_jaw.ty",
    "CTRL_L_mouth_lipsTogetherD.ty",
    "CTRL_L_mouth_pressD.ty",
    "CTRL_L_mouth_lipBiteD.ty",
    "CTRL_L_mouth_funnelU.ty",
    "CTRL_L_mouth_purseU.ty",
    "CTRL_L_mouth_stretch.ty",
    "CTRL_L_mouth_upperLipRaise.ty",
    "CTRL_L_mouth_lowerLipDepress.ty",
    "CTRL_C_tongue_tipMove.ty",
    "CTRL_C_tongue_bendTwist.ty",
    "CTRL_C_jaw_fwdBack.ty",
)
"""One control for every articulation channel (the left one of a pair)."""


@dataclass(frozen=True)
class ValidationSet:
    """Clips and their control set."""

    examples: tuple[Example, ...]
    controls: ControlSet

    @classmethod
    def of(cls, clips: list[Clip], controls: ControlSet) -> "ValidationSet":
        """Choose up to 60 clips: recorded ones first, evenly spread over the list."""
        recorded = [clip for clip in clips if clip.source in ("recording", MEASURED)]
        chosen = recorded or clips
        spread = spread_clips(chosen, MAX_CLIPS)
        return cls(tuple(load_example(clip, controls) for clip in spread), controls)

    @torch.no_grad()
    def score(self, model: DEITalk) -> dict[str, float]:
        """Errors, correlations and closures; ``score`` selects the weights.

        ``score`` is the mean of the closures' window AUC and hit rate, the jaw's r, the mean r
        over `ARTICULATION`, and the r of the intensity within speech, equally weighted. Data
        without phones or intensity is scored by the rest; an empty set by 0. Controls that a clip
        does not know are left out.

        Parameters
        ----------
        model : DEITalk
            On any device, in evaluation mode.
        """
        rows: list[dict[str, float]] = []
        closures: list[ClosureScores] = []
        for example in self.examples:
            predicted, strength = predict(model, example)
            rows.append(self._row(example, predicted, strength))
            if knows_contact(example.known, self.controls):
                lips = lips_together(predicted, self.controls)
                closures.append(closure_scores(lips, example.phones))
        names = rows[0] if rows else {}
        means = {name: mean_of_finite([row[name] for row in rows]) for name in names}
        pooled = summarise_closures(closures)
        means |= {"auc": pooled.window_auc, "hits": pooled.hit_rate}
        parts = [means.get(name, 0.0) for name in ("auc", "hits", "jaw_r", "mean_r", "intensity_r")]
        finite = [part for part in parts if np.isfinite(part)]
        return means | {"score": float(np.mean(finite)) if finite else 0.0}

    def _row(
        self, example: Example, predicted: Float32, strength: Float32 | None
    ) -> dict[str, float]:
        target = example.curves
        rs = articulation(target, predicted, example.known, self.controls)
        row = {
            "lpe": lip_parameter_error(target, predicted, self.controls, example.known),
            "epe": emotion_parameter_error(target, predicted, self.controls, example.known),
            "jaw_r": rs[0],
            "mean_r": mean_of_finite(rs),
        }
        known = np.isfinite(example.intensity) & speaking_frames(example)
        row["intensity_r"] = (
            correlation(example.intensity[known], strength[known])
            if strength is not None and known.any()
            else float("nan")
        )
        return row


def articulation(
    target: Float32, predicted: Float32, known: Bool, controls: ControlSet
) -> list[float]:
    """Pearson's r of each of `ARTICULATION`; NaN where it is not known, or still."""
    places = [controls.index(name) for name in ARTICULATION]
    return [
        correlation(target[:, i], predicted[:, i]) if known[i] else float("nan") for i in places
    ]
