"""Steps and jerk of curves, for comparison with captured curves.

Letters: T frames, C controls.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from deitalk.audio.frames import FRAME_RATE, frame_centres
from deitalk.audio.prosody import level_db
from deitalk.audio.voice_activity import speech_activity
from deitalk.data.clips import MEASURED, Clip, read_phones
from deitalk.data.waveforms import n_clip_frames, recorded_frames
from deitalk.data.windows import cut, load_clip
from deitalk.emotions import EMOTIONS
from deitalk.evaluation.scores import (
    correlation,
    emotion_parameter_error,
    lip_parameter_error,
)
from deitalk.evaluation.validation import ClosureScores, closure_scores, summarise_closures
from deitalk.models.curve_model import DEITalk
from rig import ControlSet
from rig.arrays import Bool, Float32

MOVING = 0.02
"""Least standard deviation of a moving control."""


def smoothness(curves: Float32) -> dict[str, float]:
    """Steps and jerk of the controls that move.

    Parameters
    ----------
    curves : ndarray [shape=(T, C)]
        Values at 30 Hz.

    Returns
    -------
    dict
        ``largest_step`` (control units per frame), ``step_p99`` (99th percentile of steps), and
        ``jerk_per_speed``: RMS of the third derivative over RMS of the first, 1/s², median of
        the controls; independent of their range.
    """
    moving = curves[:, curves.std(axis=0) > MOVING].astype(np.float64)
    if len(moving) < 4 or not moving.shape[1]:
        return {}
    steps = np.diff(moving, axis=0)
    speed = np.sqrt(np.square(steps).mean(axis=0)) * FRAME_RATE
    jerk = np.sqrt(np.square(np.diff(moving, 3, axis=0)).mean(axis=0)) * FRAME_RATE**3
    return {
        "largest_step": float(np.abs(steps).max()),
        "step_p99": float(np.percentile(np.abs(steps), 99)),
        "jerk_per_speed": float(np.median(jerk / speed)),
    }


MAX_CLIPS = 60
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


class Example(NamedTuple):
    """A whole clip at 30 frames per second."""

    waveform: Float32
    curves: Float32
    emotion: str
    intensity: Float32
    phones: list[tuple[float, float, str]]
    known: Bool
    """Controls that the curves hold [shape=(C,)]."""
    speaker: str


def lips_together(curves: Float32, controls: ControlSet) -> Float32:
    """Mean of the four lips-together controls [shape=(T,)]."""
    places = [i for i, name in enumerate(controls.names) if "lipsTogether" in name]
    mean: Float32 = curves[:, places].mean(axis=1)
    return mean


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
        places = np.linspace(0, len(chosen) - 1, min(MAX_CLIPS, len(chosen))).round().astype(int)
        return cls(tuple(load_example(chosen[i], controls) for i in places), controls)

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
        means = {name: _mean([row[name] for row in rows]) for name in names}
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
            "mean_r": _mean(rs),
        }
        known = np.isfinite(example.intensity) & speaking_frames(example)
        row["intensity_r"] = (
            correlation(example.intensity[known], strength[known])
            if strength is not None and known.any()
            else float("nan")
        )
        return row


def speaking_frames(example: Example) -> Bool:
    """Frames with speech [shape=(T,)]; a last frame that is begun only has none."""
    speaking = np.zeros(len(example.curves), bool)
    found = speech_activity(example.waveform)[: len(speaking)]
    speaking[: len(found)] = found > 0
    return speaking


def knows_contact(known: Bool, controls: ControlSet) -> bool:
    """Whether curves hold the lips-together controls, so that their contacts can be scored."""
    return bool(all(known[i] for i, name in enumerate(controls.names) if "lipsTogether" in name))


def articulation(
    target: Float32, predicted: Float32, known: Bool, controls: ControlSet
) -> list[float]:
    """Pearson's r of each of `ARTICULATION`; NaN where it is not known, or still."""
    places = [controls.index(name) for name in ARTICULATION]
    return [
        correlation(target[:, i], predicted[:, i]) if known[i] else float("nan") for i in places
    ]


def load_example(clip: Clip, controls: ControlSet, *, sound: bool = True) -> Example:
    """Read a whole clip, resampled to 30 frames per second; without `sound` it is silent."""
    loaded = load_clip(clip, controls, sound=sound)
    n_samples = len(loaded.waveform)
    n_frames = n_clip_frames(n_samples) if sound else recorded_frames(str(clip.audio))
    waveform, curves, intensity, _ = cut(loaded, 0, n_frames)
    phones = read_phones(clip.phones) if clip.phones else []
    return Example(waveform, curves, clip.emotion, intensity, phones, loaded.known, clip.speaker)


@torch.no_grad()
def predict(model: DEITalk, example: Example) -> tuple[Float32, Float32 | None]:
    """The network's curves [shape=(T, C)] and intensity [shape=(T,)] before any rule."""
    n_frames = len(example.curves)
    device = next(model.parameters()).device
    analysis = model.analyse(torch.from_numpy(example.waveform).to(device), n_frames)
    one_hot = torch.eye(len(EMOTIONS), device=device)[EMOTIONS.index(example.emotion)]
    styles = model.styles(one_hot.expand(n_frames, -1), example.speaker)
    curves: Float32 = model.decode(analysis, styles).cpu().numpy()
    return curves, None if analysis.strength is None else analysis.strength.cpu().numpy()


def _mean(values: list[float]) -> float:
    finite = [value for value in values if np.isfinite(value)]
    return float(np.mean(finite)) if finite else float("nan")


def loudness(waveform: Float32, n_frames: int) -> Float32:
    """Level of the recording on a scale of 40 dB [shape=(T,), range 0 to 1]: the baseline."""
    level = level_db(waveform, frame_centres(np.arange(n_frames)))
    top = np.percentile(level, 95)
    scaled: Float32 = np.clip(1 + (level - top) / 40, 0, 1).astype(np.float32)
    return scaled
