"""Strength of an expression, measured on captured curves.

DEITalk's intensity is learnt from captured motion (§3.3): which frames carry the emotion shows
in the face, not only in the voice. How much of its emotion a frame shows is a projection: on the
axis from the actor's neutral face to their face in the emotion, every control divided by its
variance within both, as in a linear discriminant of independent controls. A control that differs
between the emotions and hardly moves in speech, such as a brow, so counts more than the jaw.

Paper silent: the paper has no measure of intensity. Letters: T frames, C controls.
"""

import hashlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from deitalk.data.clips import Clip
from deitalk.data.windows import LoadedClip, load_clip
from deitalk.evaluation.smoothness import MOVING
from rig import ControlSet
from rig.arrays import Bool, Float32, Float64
from rig.curves.filters import gaussian_smooth
from rig.files import atomic_write

NEUTRAL = "neutral"
SMOOTHING_SECONDS = 0.25
"""Sigma: an expression does not follow single syllables."""
FULL = 0.95
"""Quantile over an actor's frames in an emotion that counts as strength 1."""
LEAST_SEPARATION = 1.5
"""Standard deviations between the neutral and the emotional mean from which on an expression is
measurable."""


@dataclass(frozen=True)
class ExpressionAxis:
    """From an actor's neutral face to an emotion.

    Attributes
    ----------
    weights : array [shape=(C,)]
        Of the controls in the projection.
    neutral, full : float
        Projection of the neutral face, and of a face of strength 1.
    """

    weights: Float64
    neutral: float
    full: float

    def strength(self, loaded: LoadedClip) -> Float32:
        """Strength of every frame of a clip [shape=(T,), range 0 to 1]."""
        share = (_projected(loaded, self.weights) - self.neutral) / (self.full - self.neutral)
        return np.clip(share, 0, 1).astype(np.float32)


def expression_axes(
    clips: Sequence[Clip], controls: ControlSet, learnt: Bool
) -> dict[tuple[str, str], ExpressionAxis]:
    """Axes of each actor's emotions that show in the captured curves.

    Parameters
    ----------
    clips : sequence of Clip
        To train on.
    controls : ControlSet
        Columns of the curves.
    learnt : array [shape=(C,)]
        Controls that count, as far as all clips of an actor's emotion know them.

    Returns
    -------
    dict
        By actor and emotion. Of an actor without neutral clips the face at rest is neutral, and
        lip controls, which speech moves away from it, do not count. An emotion that differs
        from neutral by less than `LEAST_SEPARATION` is left out.
    """
    groups: dict[tuple[str, str], list[Clip]] = defaultdict(list)
    for clip in clips:
        groups[clip.group].append(clip)
    found = {}
    for (actor, emotion), takes in groups.items():
        if emotion == NEUTRAL:
            continue
        axis = _axis(takes, groups.get((actor, NEUTRAL), []), controls, learnt)
        if axis is not None:
            found[actor, emotion] = axis
    return found


def label_intensity(
    clips: Sequence[Clip],
    axes: Mapping[tuple[str, str], ExpressionAxis],
    controls: ControlSet,
    folder: Path,
) -> list[Clip]:
    """The clips with measured intensity, written as files like those of a dataset folder.

    Parameters
    ----------
    clips : sequence of Clip
        One with labels of its own keeps them.
    axes : mapping
        From `expression_axes`. A neutral clip of an actor of these has intensity 0.
    controls : ControlSet
        Columns of the curves.
    folder : Path
        Gets ``<clip>.csv``; files that are there stay.
    """
    actors = {actor for actor, _ in axes}
    folder.mkdir(parents=True, exist_ok=True)
    labelled = []
    for clip in clips:
        axis = axes.get(clip.group)
        is_calm = clip.speaker in actors and clip.emotion == NEUTRAL
        if clip.intensity is not None or not (axis or is_calm):
            labelled.append(clip)
            continue
        path = folder / f"{hashlib.sha256(clip.name.encode()).hexdigest()[:12]}.csv"
        if not path.exists():
            loaded = load_clip(clip, controls, sound=False)
            values = axis.strength(loaded) if axis else np.zeros(len(loaded.times))
            rows = zip(loaded.times, values, strict=True)
            lines = [f"{time:.4f},{value:.4f}" for time, value in rows]
            with atomic_write(path) as beside:
                beside.write_text("\n".join(["time,intensity", *lines, ""]), encoding="utf-8")
        labelled.append(replace(clip, intensity=path))
    return labelled


def _axis(
    takes: Sequence[Clip], neutral: Sequence[Clip], controls: ControlSet, learnt: Bool
) -> ExpressionAxis | None:
    """Axis of some clips from others, or from the rest; None if they are too alike."""
    mean, variance, known = _moments(takes, controls)
    before, spread, known_before = (
        _moments(neutral, controls) if neutral else (controls.rest.astype(float), variance, known)
    )
    places = learnt & known & known_before
    if not neutral:
        places[controls.subset("lip")] = False
    weights = places * (mean - before) / ((variance + spread) / 2 + MOVING**2)
    shown = _projections(takes, controls, weights)
    still = _projections(neutral, controls, weights) if neutral else np.full(1, before @ weights)
    deviation = np.sqrt((shown.var() + (still.var() if neutral else shown.var())) / 2)
    if shown.mean() - still.mean() < LEAST_SEPARATION * max(deviation, 1e-9):
        return None
    return ExpressionAxis(weights, float(still.mean()), float(np.quantile(shown, FULL)))


def _moments(clips: Sequence[Clip], controls: ControlSet) -> tuple[Float64, Float64, Bool]:
    """Mean and variance of every control, and whether all clips know it [shape=(C,)]."""
    count, total, square = 0, np.zeros(len(controls)), np.zeros(len(controls))
    known = np.ones(len(controls), bool)
    for clip in clips:
        loaded = load_clip(clip, controls, sound=False)
        values = loaded.values.astype(np.float64)
        count += len(values)
        total += values.sum(axis=0)
        square += np.square(values).sum(axis=0)
        known &= loaded.known
    mean = total / max(count, 1)
    return mean, np.maximum(square / max(count, 1) - np.square(mean), 0), known


def _projections(clips: Sequence[Clip], controls: ControlSet, weights: Float64) -> Float64:
    """Smoothed projections of the frames of all clips."""
    read = (load_clip(clip, controls, sound=False) for clip in clips)
    return np.concatenate([_projected(loaded, weights) for loaded in read])


def _projected(loaded: LoadedClip, weights: Float64) -> Float64:
    """Smoothed projection of every frame [shape=(T,)]."""
    line = loaded.values.astype(np.float64) @ weights
    step = np.diff(loaded.times[:2]).sum() or 1.0
    smooth: Float64 = gaussian_smooth(line, SMOOTHING_SECONDS / step, "mirror")
    return smooth
