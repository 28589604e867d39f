"""Factors that an intensity makes of a reading: on its expression and on its opening.

Letters: T frames, C controls.
"""

import numpy as np

from deitalk.config.rules import PoseSize, ScaleOpening
from deitalk.emotions import EMOTIONS
from deitalk.postprocess.control_groups import ControlGroups
from rig import ControlSet
from rig.arrays import AnyFloat, Bool, Float32
from rig.curves.edit import gaussian_smooth

LEAST_PREDICTED = 0.15
"""Lower bound of the predicted intensity that an applied one is divided by."""
AROUND_FRAMES = 30.0
"""Sigma of the speech around a frame in which it and the intensity are measured, 1 s."""
MOST_RESIZED = 2.0
"""Most by which the intensity that a pose holds and the predicted one differ, a factor."""


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


def opening_factor(
    rule: ScaleOpening | None, voice: AnyFloat, network: AnyFloat, take: float = 0.0
) -> Float32:
    """Factor on the opening of the mouth for the corrected intensity of the voice [shape=(T,)].

    The network opens it for the intensity that it predicts, by the law of its training data:
    45 % more per unit of intensity. The factor is that
    law at the corrected intensity over that at the predicted one. Loud talkers lower the jaw
    further, which a network with all takes at one level cannot predict: hence `take`.

    Parameters
    ----------
    rule : ScaleOpening or None
        Its numbers; None: 1 everywhere.
    voice, network : array [shape=(T,), range 0 to 1]
        Corrected intensity, and the one that the network predicts, each as its mean over the
        speech around a frame; the reading itself has the faster variation.
    take : float
        Strength of the whole take, standard deviations above the usual
        (`deitalk.postprocess.voice_intensity.take_z`).
    """
    if rule is None:
        return np.ones(voice.shape, np.float32)
    ratio = (1 + rule.gain * (voice - rule.usual)) / (1 + rule.gain * (network - rule.usual))
    return np.asarray(ratio * max(0.0, 1 + rule.take * take), np.float32)


def held_intensity(
    rule: PoseSize | None,
    controls: ControlSet,
    neutral: Float32,
    emotional: Float32,
    weights: Float32,
    speaking: Bool,
    network: Float32,
) -> Float32:
    """Intensity that the emotional reading holds [shape=(T,), range 0 to 2].

    The predicted one; with the `rule` the measured size of the pose, over about 2 s
    of speech and as far as one trained emotion is shown. The pose of anger grows less than
    the prediction: divided by it, a strong take would show less.

    Parameters
    ----------
    rule : PoseSize or None
        Size of the poses of a model; None: the predicted intensity.
    controls : ControlSet
        Columns of the readings.
    neutral, emotional : array [shape=(T, C)]
        Two readings of the same speech.
    weights : array [shape=(T, 5)]
        Trained emotions of each frame.
    speaking : array of bool [shape=(T,)]
        Frames of speech.
    network : array [shape=(T,), range 0 to 1]
        Predicted intensity.
    """
    if rule is None or not speaking.any():
        return network
    posing = ControlGroups(controls).posing
    usual = np.array([getattr(rule, name, 0.0) for name in EMOTIONS])
    size = np.abs(emotional[:, posing] - neutral[:, posing]).sum(axis=1)
    change = mean_around(size, speaking) / np.maximum((weights @ usual) * network, 1e-6)
    pure = np.clip(2 * (weights * (usual > 0)).max(axis=1) - 1, 0, 1)
    return np.asarray(network * np.clip(change, 1 / MOST_RESIZED, MOST_RESIZED) ** pure, np.float32)
