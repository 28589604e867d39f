"""Intensity of voices that have not ended.

The causal form of `deitalk.postprocess.voice_intensity`: the variation is the same sum, about
running means that forget; smoothing looks back instead of to both sides, and after a pause the
intensity rises with the voice instead of before it. The strength of the voice is the network's
readout alone.

Streams are side by side, and their state is in the caller's hands; frames are taken one after the
other, of all streams at once. Letters: B streams, n frames of a call.
"""

from typing import NamedTuple

import numpy as np

from deitalk.audio.vocal_strength import LEVEL_DB, PITCH_SEMITONES, TILT_DB, VOICED, sonority_db
from deitalk.config.rules import VoiceIntensity
from deitalk.postprocess.voice_intensity import (
    AROUND_WEIGHT,
    BRIGHTEST_DB,
    FAINTEST,
    FALL_FRAMES,
    FURTHEST_SEMITONES,
    LEVEL_SHARE,
    MOST_TONE,
    MOST_VARIATION,
    NEAR_SHARE,
    NETWORK_WEIGHT,
    RISE_FRAMES,
    STEEPNESS,
    TONE_SHARE,
    base_z,
    deviation,
)
from rig.arrays import Bool, Float32, Float64

FORGET_FRAMES = 900.0
"""Frames of speech that a mean remembers (30 s)."""
USUAL_FRAMES = 30.0
"""Weight of the usual intensity at the start, frames."""
SMOOTHING = 1 / 8
"""Share of a new frame in the smoothed values: 0.27 s."""
AROUND_SMOOTHING = 1 / 30
"""The same in the strength and the intensity around a frame: a second."""
MOST_LEVEL = 4.0
"""Limit of the standard deviations of the level, whose mean is young at first."""
USUAL, LEVEL, TILT, PITCH, STRENGTH = range(5)
"""Columns of the running means."""
Z, KEPT, AROUND, NEAR = range(4)
"""Columns of the smoothed values: variation, decay, strength around a frame, variation around."""


class Measures(NamedTuple):
    """Prosody of consecutive frames [shape=(..., n)], from `measure_windows`."""

    level: Float64
    tilt: Float64
    pitch: Float64
    periodicity: Float64
    sonority: Float64

    @classmethod
    def of(cls, measured: Float64) -> "Measures":
        """Take measured rows (..., n, 31)."""
        level, bright, dark, pitch, periodicity = np.moveaxis(measured[..., :5], -1, 0)
        tilt = 10 * np.log10((bright + 1e-12) / (dark + 1e-12))
        sonority = sonority_db(np.moveaxis(measured[..., 5:], -1, 0))
        return cls(level, tilt, pitch, periodicity, sonority)


IntensityState = tuple[Float64, Float64, Float64]
"""Running means and their weights [shape=(B, 5)] each, smoothed values [shape=(B, 4)]."""


class RunningIntensity:
    """Intensity of streams, frame by frame.

    Parameters
    ----------
    rule : VoiceIntensity
        Weight of the prosody.
    """

    def __init__(self, rule: VoiceIntensity) -> None:
        self.rule = rule

    def first(self, batch: int) -> IntensityState:
        """State of streams before their first frame."""
        weights = np.zeros((batch, 5))
        weights[:, [USUAL, STRENGTH]] = USUAL_FRAMES
        return np.zeros((batch, 5)), weights, np.zeros((batch, 4))

    def __call__(
        self,
        network: Float32,
        measures: Measures,
        speaking: Bool,
        effort: Float32,
        state: IntensityState,
    ) -> tuple[Float32, IntensityState]:
        """Corrected intensity of the next frames [shape=(B, n), range 0 to 1].

        Parameters
        ----------
        network : array [shape=(B, n), range 0 to 1]
            Predicted by the network.
        measures : Measures
            Prosody of the same frames.
        speaking : array of bool [shape=(B, n)]
            Frames of speech; in others the intensity decays.
        effort : array [shape=(B, n)]
            Strength of the voice, dB above the usual; 0 where no network has read it.
        state : IntensityState
            From `first`, or from the call before.
        """
        means, weights, values = state
        toned = speaking & (measures.periodicity > VOICED) & (measures.tilt < BRIGHTEST_DB)
        counts = np.stack((speaking, speaking, toned, toned, speaking), axis=-1)
        rows = deviation(network), measures.level, measures.tilt, measures.pitch, effort
        new: Float64 = np.stack(rows, axis=-1).astype(np.float64)
        found = np.empty((*network.shape, 5))
        for k in range(network.shape[1]):
            count = counts[:, k]
            weights = np.where(count, np.minimum(weights + 1, FORGET_FRAMES), weights)
            means = np.where(count, means + (new[:, k] - means) / np.maximum(weights, 1), means)
            values = self._smoothed(
                values, new[:, k] - means, speaking[:, k], toned[:, k], effort[:, k]
            )
            found[:, k, :4], found[:, k, 4] = values, means[:, STRENGTH]
        z, kept, around, near, strength = np.moveaxis(found, -1, 0)
        strength = strength + AROUND_WEIGHT * (around - strength)
        z = bounded(z) - NEAR_SHARE * near + base_z(strength, self.rule)
        share = (1 - FAINTEST) / (1 + np.exp(-STEEPNESS * z))
        return (FAINTEST + share * kept).astype(np.float32), (means, weights, values)

    def _smoothed(
        self, values: Float64, distance: Float64, speaking: Bool, toned: Bool, effort: Float32
    ) -> Float64:
        """Smoothed values after a frame, of its distances from the means [shape=(B, 5)]."""
        z, kept, around, near = values.T
        index = LEVEL_SHARE * np.clip(distance[:, LEVEL] / LEVEL_DB, -MOST_LEVEL, MOST_LEVEL)
        tilt = np.clip(distance[:, TILT] / TILT_DB, -MOST_TONE, MOST_TONE)
        pitch = np.clip(distance[:, PITCH] / PITCH_SEMITONES, -MOST_TONE, MOST_TONE)
        is_near = np.abs(distance[:, PITCH]) <= FURTHEST_SEMITONES
        index = index + TONE_SHARE * toned * (tilt + is_near * pitch)
        target = NETWORK_WEIGHT * distance[:, USUAL] + self.rule.index_weight * index
        z = z + SMOOTHING * (target - z)
        risen = kept + (1 - kept) * (1 - np.exp(-1 / RISE_FRAMES))
        near = near + AROUND_SMOOTHING * (bounded(z) - near)
        around = around + AROUND_SMOOTHING * (effort - around)
        silent = values.copy()
        silent[:, KEPT] *= np.exp(-1 / FALL_FRAMES)
        spoken = np.stack((z, risen, around, near), axis=-1)
        return np.where(speaking[:, None], spoken, silent)


def bounded(z: Float64) -> Float64:
    """Variation within `MOST_VARIATION`, as that of a whole take is bounded."""
    found: Float64 = MOST_VARIATION * np.tanh(z / MOST_VARIATION)
    return found


def follow_means(rows: Float64, speaking: Bool, means: Float64) -> tuple[Float64, Float64]:
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
    found = np.empty(rows.shape)
    for k in range(rows.shape[1]):
        means = means + AROUND_SMOOTHING * speaking[:, k, None] * (rows[:, k] - means)
        found[:, k] = means
    return found, means
