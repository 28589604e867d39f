"""Intensity of a voice that has not ended: the causal form of `voice_intensity`.

The variation is the same sum, about running means that forget; smoothing looks back instead of to
both sides, and after a pause the intensity rises with the voice instead of before it. The strength
of the voice, which needs seconds of it, is left out.
"""

import math
from typing import NamedTuple

import numpy as np

from deitalk.audio.prosody import LEVEL_DB, PITCH_SEMITONES, TILT_DB, VOICED, sonority_db
from deitalk.config import VoiceIntensity
from deitalk.postprocess.voice_intensity import (
    BRIGHTEST_DB,
    FAINTEST,
    FALL_FRAMES,
    FURTHEST_SEMITONES,
    LEVEL_SHARE,
    MOST_TONE,
    MOST_VARIATION,
    NETWORK_WEIGHT,
    RISE_FRAMES,
    STEEPNESS,
    TONE_SHARE,
    deviation,
)
from rig.arrays import Bool, Float32, Float64

FORGET_FRAMES = 900.0
"""Frames of speech that a mean remembers (30 s)."""
USUAL_FRAMES = 30.0
"""Weight of the usual intensity at the start, frames."""
SMOOTHING = 1 / 8
"""Share of a new frame in the smoothed values: 0.27 s."""
MOST_LEVEL = 4.0
"""Limit of the standard deviations of the level, whose mean is young at first."""


class Mean:
    """Running mean whose older values count less and less.

    Parameters
    ----------
    value : float
        At the start.
    weight : float
        Frames that it counts for.
    """

    def __init__(self, value: float = 0.0, weight: float = 0.0) -> None:
        self.value, self.weight = value, weight

    def add(self, value: float) -> float:
        """Take a value; return its distance from the mean with it."""
        self.weight = min(self.weight + 1, FORGET_FRAMES)
        self.value += (value - self.value) / self.weight
        return value - self.value


class Measures(NamedTuple):
    """Prosody of consecutive frames [shape=(n,)], from `deitalk.audio.prosody.measure_windows`."""

    level: Float64
    tilt: Float64
    pitch: Float64
    periodicity: Float64
    sonority: Float64

    @classmethod
    def of(cls, measured: Float64) -> "Measures":
        """Take measured rows (31, n)."""
        level, bright, dark, pitch, periodicity = measured[:5]
        tilt = 10 * np.log10((bright + 1e-12) / (dark + 1e-12))
        return cls(level, tilt, pitch, periodicity, sonority_db(measured[5:]))


class RunningIntensity:
    """Intensity of one stream, frame by frame.

    Parameters
    ----------
    rule : VoiceIntensity or None
        Weight of the prosody; None: the network's intensity stays as it is.
    """

    def __init__(self, rule: VoiceIntensity | None) -> None:
        self.rule = rule
        self.usual = Mean(0.0, USUAL_FRAMES)
        self.level, self.tilt, self.pitch = Mean(), Mean(), Mean()
        self.z = self.kept = 0.0

    def feed(self, network: Float32, measures: Measures, speaking: Bool) -> Float32:
        """Corrected intensity of the next frames [shape=(n,), range 0 to 1].

        Parameters
        ----------
        network : array [shape=(n,), range 0 to 1]
            Predicted by the network.
        measures : Measures
            Prosody of the same frames.
        speaking : array of bool [shape=(n,)]
            Frames of speech; in others the intensity decays.
        """
        if self.rule is None:
            return network
        rows = zip(deviation(network), *measures[:4], speaking, strict=True)
        return np.array([self._next(*row) for row in rows], np.float32)

    def _next(
        self, z: float, level: float, tilt: float, pitch: float, periodicity: float, speaks: bool
    ) -> float:
        assert self.rule is not None
        if not speaks:
            self.kept *= math.exp(-1 / FALL_FRAMES)
        else:
            self.kept += (1 - self.kept) * (1 - math.exp(-1 / RISE_FRAMES))
            index = LEVEL_SHARE * _limited(self.level.add(level) / LEVEL_DB, MOST_LEVEL)
            if periodicity > VOICED and tilt < BRIGHTEST_DB:
                index += TONE_SHARE * _limited(self.tilt.add(tilt) / TILT_DB, MOST_TONE)
                semitones = self.pitch.add(pitch)
                if abs(semitones) <= FURTHEST_SEMITONES:
                    index += TONE_SHARE * _limited(semitones / PITCH_SEMITONES, MOST_TONE)
            new = NETWORK_WEIGHT * self.usual.add(z) + self.rule.index_weight * index
            self.z += SMOOTHING * (new - self.z)
        limited = MOST_VARIATION * math.tanh(self.z / MOST_VARIATION)
        share = (1 - FAINTEST) / (1 + math.exp(-STEEPNESS * limited))
        return FAINTEST + share * self.kept


def _limited(z: float, most: float) -> float:
    return max(-most, min(most, z))
