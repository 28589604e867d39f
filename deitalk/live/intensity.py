"""Intensity of voices that have not ended.

The causal form of `deitalk.postprocess.feeling`: the state is the strength of the voice by the
network's readout, over the last second and a half of speech; the display is the same sum, about
running means that forget, and its smoothing looks back instead of to both sides.

Streams are side by side, and the caller keeps their state; frames are taken one after the other, of
all streams at once. All functions take arrays or tensors. Letters: B streams, n frames of a call.
"""

from typing import NamedTuple

import numpy as np

from deitalk.array_functions import Array, library, like
from deitalk.audio.prosody import LEVEL_DB, PITCH_SEMITONES, TILT_DB, VOICED
from deitalk.config.rules import VoiceIntensity
from deitalk.postprocess.feeling import (
    BRIGHTEST_DB,
    FURTHEST_SEMITONES,
    LEVEL_SHARE,
    MOST_TONE,
    NETWORK_SHARE,
    TONE_SHARE,
    deviation,
    intensity_of,
    limited,
    state_of,
)

FORGET_FRAMES = 900.0
"""Frames of speech that a mean remembers (30 s)."""
STATE_FRAMES = 45.0
"""Frames of speech whose strength is the state (1.5 s)."""
MEMORIES = np.array([*[FORGET_FRAMES] * 4, STATE_FRAMES])
USUAL_FRAMES = np.array([30.0, 0, 0, 0, 8.0])
"""Weight of the usual voice at the start, frames."""
SMOOTHING = 1 / 8
"""Share of a new frame in the display: 0.27 s."""
AROUND_SMOOTHING, NEAR_SHARE = 1 / 30, 0.5
"""The same in the mean display of the second before, and the share of it that is taken off."""
PRESENCE_SMOOTHING = 1 / 6
"""The same in the presence of the display, 1 in speech and 0 in silence: 0.2 s."""
MOST_LEVEL = 4.0
"""Limit of the standard deviations of the level, whose mean is young at first."""
NETWORK, LEVEL, TILT, PITCH, STRENGTH = range(5)
"""Columns of the running means."""


class Measures(NamedTuple):
    """Prosody of consecutive frames [shape=(..., n)], as in `deitalk.audio.prosody.Prosody`."""

    level: Array
    tilt: Array
    pitch: Array
    periodicity: Array
    sonority: Array


IntensityState = tuple[Array, ...]
"""Running means and their weights [shape=(B, 5)] each, and display, its presence and its mean
around [shape=(B, 3)]."""


class RunningIntensity:
    """Intensity of streams, frame by frame.

    Parameters
    ----------
    rule : VoiceIntensity
        Weights.
    """

    def __init__(self, rule: VoiceIntensity) -> None:
        self.rule = rule

    def first(self, batch: int) -> IntensityState:
        """State of streams before their first frame."""
        return np.zeros((batch, 5)), np.tile(USUAL_FRAMES, (batch, 1)), np.zeros((batch, 3))

    def __call__(
        self,
        network: Array,
        measures: Measures,
        speaking: Array,
        effort: Array,
        state: IntensityState,
    ) -> tuple[Array, IntensityState]:
        """Intensity of the next frames [shape=(B, n), range 0 to 1.2].

        Parameters
        ----------
        network : array [shape=(B, n), range 0 to 1]
            Predicted by the network.
        measures : Measures
            Prosody of the same frames.
        speaking : array of bool [shape=(B, n)]
            Frames of speech; in others the state stays and the display ends.
        effort : array [shape=(B, n)]
            Strength of the voice, dB above the usual; 0 where no network has read it.
        state : IntensityState
            From `first`, or from the call before.
        """
        xp, (means, weights, values) = library(network), state
        toned = speaking & (measures.periodicity > VOICED) & (measures.tilt < BRIGHTEST_DB)
        counts = xp.stack((speaking, speaking, toned, toned, speaking), axis=-1)
        rows = deviation(network), measures.level, measures.tilt, measures.pitch, effort
        new, found = xp.stack(rows, axis=-1), []
        for k in range(network.shape[1]):
            count = counts[:, k]
            weights = xp.where(count, xp.minimum(weights + 1, like(MEMORIES, weights)), weights)
            moved = means + (new[:, k] - means) / xp.clip(weights, 1, None)
            means = xp.where(count, moved, means)
            values = _displayed(values, new[:, k] - means, speaking[:, k], toned[:, k])
            display, presence, near = (values[:, part] for part in range(3))
            display = self.rule.display * presence * (limited(display) - NEAR_SHARE * near)
            found.append(state_of(means[:, STRENGTH], self.rule) + display)
        return intensity_of(xp.stack(found, axis=1)), (means, weights, values)


def _displayed(values: Array, distance: Array, speaking: Array, toned: Array) -> Array:
    """Display, presence and mean display after a frame, of its distances from the means."""
    xp, (display, presence, near) = library(values), (values[:, part] for part in range(3))
    tilt = xp.clip(distance[:, TILT] / TILT_DB, -MOST_TONE, MOST_TONE)
    pitch = xp.clip(distance[:, PITCH] / PITCH_SEMITONES, -MOST_TONE, MOST_TONE)
    is_near = xp.abs(distance[:, PITCH]) <= FURTHEST_SEMITONES
    target = NETWORK_SHARE * distance[:, NETWORK]
    target = target + LEVEL_SHARE * xp.clip(distance[:, LEVEL] / LEVEL_DB, -MOST_LEVEL, MOST_LEVEL)
    target = target + TONE_SHARE * toned * (tilt + is_near * pitch)
    display = xp.where(speaking, display + SMOOTHING * (target - display), display)
    moved = near + AROUND_SMOOTHING * (limited(display) - near)
    presence = presence + PRESENCE_SMOOTHING * (speaking * 1.0 - presence)
    return xp.stack((display, presence, xp.where(speaking, moved, near)), axis=-1)


def follow_means(rows: Array, speaking: Array, means: Array) -> tuple[Array, Array]:
    """Means of values over the last second of speech.

    Parameters
    ----------
    rows : array [shape=(B, n, K)]
        Values of the next frames.
    speaking : array of bool [shape=(B, n)]
        Frames that count.
    means : array [shape=(B, K)]
        Before them.

    Returns
    -------
    array [shape=(B, n, K)], array [shape=(B, K)]
        Means at each frame, and those after the last one.
    """
    found = []
    for k in range(rows.shape[1]):
        means = means + AROUND_SMOOTHING * speaking[:, k, None] * (rows[:, k] - means)
        found.append(means)
    return library(rows).stack(found, axis=1), means
