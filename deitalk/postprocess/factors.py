"""Factors that an intensity makes of a reading: on its expression and on its opening.

Letters: T frames, C controls.
"""

import numpy as np

from deitalk.config.rules import Expressions, ScaleOpening
from deitalk.postprocess.expressions import expression_table
from rig import ControlSet
from rig.arrays import AnyFloat, Bool, Float32
from rig.curves.filters import gaussian_smooth

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


def expression_scale(applied: Float32, predicted: Float32) -> Float32:
    """Factor on the difference of the emotional and the neutral reading [shape=(T,)].

    Parameters
    ----------
    applied : array [shape=(T,), range 0 to 4]
        Intensity to show.
    predicted : array [shape=(T,), range 0 to 1]
        Intensity that the emotional reading holds.
    """
    return np.asarray(applied / np.maximum(predicted, LEAST_PREDICTED), np.float32)


def mean_around(values: AnyFloat, speaking: Bool) -> Float32:
    """Mean of the frames of speech around each frame, over about 2 s [shape=(T,)]."""
    if not speaking.any():
        return np.asarray(values, np.float32)
    used = speaking.astype(np.float64)
    weight = gaussian_smooth(used, AROUND_FRAMES) + 1e-6
    total = gaussian_smooth(np.asarray(values * used), AROUND_FRAMES)
    return np.asarray((total + 1e-6 * values[speaking].mean()) / weight, np.float32)


def opening_factor(rule: ScaleOpening | None, voice: AnyFloat, network: AnyFloat) -> Float32:
    """Factor on the opening of the mouth for the corrected intensity of the voice [shape=(T,)].

    The network opens it for the intensity that it predicts, by the law of its training data:
    45 % more per unit of intensity. The factor is the law
    of people (`ScaleOpening`) at the intensity of the voice over that of the network.

    Parameters
    ----------
    rule : ScaleOpening or None
        Its numbers; None: 1 everywhere.
    voice, network : array [shape=(T,), range 0 to 1.2]
        Intensity of the voice, and the one that the network predicts, each as its mean over the
        speech around a frame; the reading itself has the faster variation.
    """
    if rule is None:
        return np.ones(voice.shape, np.float32)
    opened = 1 + rule.gain * (voice - rule.usual)
    return np.asarray(opened / (1 + LEARNT_GAIN * (network - LEARNT_USUAL)), np.float32)


def held_intensity(
    rule: Expressions | None,
    controls: ControlSet,
    neutral: Float32,
    emotional: Float32,
    weights: Float32,
    network: Float32,
) -> Float32:
    """Intensity that the emotional reading holds [shape=(..., T), range 0 to 2].

    The size of its pose of the upper face over that which networks are taught: the expression then
    changes as the intensity that is applied, and not with the reading's own errors. Where a pose
    is faint, or captures show the emotion, the predicted intensity.

    Parameters
    ----------
    rule : Expressions or None
        Which emotions captures show; None: the predicted intensity.
    controls : ControlSet
        Columns of the readings.
    neutral, emotional : array [shape=(..., T, C)]
        Two readings of the same speech.
    weights : array [shape=(..., T, 9)]
        Emotion of each frame.
    network : array [shape=(..., T)]
        Predicted intensity.
    """
    if rule is None:
        return network
    table = expression_table(controls.names, rule.captured)
    names = [controls.names[place] for place in table.places]
    upper = [k for k, name in enumerate(names) if any(part in name for part in UPPER)]
    if not upper:
        return network
    columns = table.places[upper]
    usual = np.abs(weights @ (rule.size * table.taught[:, upper])).sum(axis=-1)
    size = np.abs(emotional[..., columns] - neutral[..., columns]).sum(axis=-1)
    found = np.clip(size / np.maximum(usual, 1e-6), 0, MOST_HELD)
    taught = np.clip(usual / FAINT_SIZE, 0, 1) * (weights @ table.changed)
    return np.asarray(network + taught * (found - network), np.float32)
