"""Factors that an intensity makes of a reading: on its expression and on its opening.

Letters: T frames, C controls.
"""

from functools import lru_cache
from typing import Any

from deitalk.array_functions import Array, as_number, library, like, mean_of, single, smoothed
from deitalk.config.rules import Expressions, ScaleOpening
from deitalk.postprocess.expressions import expression_table
from rig import ControlSet

LEAST_PREDICTED = 0.2
"""Lower bound of the predicted intensity that an applied one is divided by; below it the pose that
networks are taught is added."""
LEARNT_GAIN, LEARNT_USUAL = 0.45, 0.575
"""Increase of the opening per unit of intensity that networks are taught, and the intensity at
which it is 0."""
AROUND_FRAMES = 30.0
"""Sigma of the speech around a frame in which it and the intensity are measured, 1 s."""
UPPER = ("brow", "eye", "nose")
"""Parts of the names of the controls whose change is the size of a pose."""
FAINT_SIZE, MOST_HELD = 1.0, 2.0
"""Size of a pose at intensity 1 below which it tells less, and the most that one tells."""


def expression_scale(applied: Array, predicted: Array) -> Array:
    """Factor on the difference of the emotional and the neutral reading [shape=(T,)].

    Parameters
    ----------
    applied : array or Tensor [shape=(T,), range 0 to 4]
        Intensity to show.
    predicted : array or Tensor [shape=(T,), range 0 to 1]
        Intensity already in the emotional reading.
    """
    return single(applied / library(predicted).clip(predicted, LEAST_PREDICTED, None))


def mean_around(values: Array, speaking: Array) -> Array:
    """Mean of the frames of speech around each frame, over about 2 s [shape=(T,)]."""
    used = as_number(speaking)
    weight = smoothed(used, AROUND_FRAMES) + 1e-6
    total = smoothed(used * values, AROUND_FRAMES) + 1e-6 * mean_of(values, speaking)
    return single(library(values).where(speaking.any(), total / weight, values))


def opening_factor(rule: ScaleOpening | None, voice: Array, network: Array) -> Array:
    """Factor on the opening of the mouth for the corrected intensity of the voice [shape=(T,)].

    The network opens it for the intensity that it predicts, by the law of its training data:
    45 % more per unit of intensity. The factor is the law
    of people (`ScaleOpening`) at the intensity of the voice over that of the network.

    Parameters
    ----------
    rule : ScaleOpening or None
        Its numbers; None: 1 everywhere.
    voice, network : array or Tensor [shape=(T,), range 0 to 1.2]
        Intensity of the voice, and the one that the network predicts, each as its mean over the
        speech around a frame; the reading itself has the faster variation.
    """
    if rule is None:
        return 0 * voice + 1
    opened = 1 + rule.gain * library(voice).clip(voice - rule.usual, 0, None)
    return single(opened / (1 + LEARNT_GAIN * (network - LEARNT_USUAL)))


def held_intensity(
    rule: Expressions | None,
    controls: ControlSet,
    neutral: Array,
    emotional: Array,
    weights: Array,
    network: Array,
) -> Array:
    """Intensity already in the emotional reading [shape=(..., T), range 0 to 2].

    The size of its pose of the upper face over that which networks are taught: the expression then
    changes as the intensity that is applied, and not with the reading's own errors. Where a pose
    is faint, or captures show the emotion, the predicted intensity.

    Parameters
    ----------
    rule : Expressions or None
        Which emotions captures show; None: the predicted intensity.
    controls : ControlSet
        Columns of the readings.
    neutral, emotional : array or Tensor [shape=(..., T, C)]
        Two readings of the same speech.
    weights : array or Tensor [shape=(..., T, 9)]
        Emotion of each frame.
    network : array or Tensor [shape=(..., T)]
        Predicted intensity.
    """
    if rule is None:
        return network
    places, poses, changed = _upper_face(controls.names, rule.captured)
    if not len(places):
        return network
    columns, xp = like(places, network), library(network)
    usual = xp.abs(weights @ like(rule.size * poses, network)).sum(-1)
    size = xp.abs(emotional[..., columns] - neutral[..., columns]).sum(-1)
    found = xp.clip(size / xp.clip(usual, 1e-6, None), 0, MOST_HELD)
    taught = xp.clip(usual / FAINT_SIZE, 0, 1) * (weights @ like(changed, network))
    return single(network + taught * (found - network))


@lru_cache(maxsize=8)
def _upper_face(names: tuple[str, ...], captured: tuple[str, ...]) -> tuple[Any, Any, Any]:
    """Places of the controls of the upper face, poses that are taught of them, and `changed`."""
    table = expression_table(names, captured)
    moved = [names[place] for place in table.places]
    upper = [k for k, name in enumerate(moved) if any(part in name for part in UPPER)]
    return table.places[upper], table.taught[:, upper], table.changed
