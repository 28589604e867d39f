"""Shapes over time whose end is not known: noise and swells, frame by frame."""

import math

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.postprocess.life.tracks import RISE_SECONDS
from rig.arrays import Float64

POLES = 3
"""Recursive filters of first order through which noise goes, one after the other."""
PACE = math.sqrt(2 / 3)
"""Time constant of such a filter for the mean speed of noise through a Gaussian of sigma 1."""


class RunningNoise:
    """Noise as slow as that of `deitalk.postprocess.life.tracks.slow_noise`, of several channels.

    Parameters
    ----------
    spread : sequence of float [shape=(K,)]
        Standard deviation.
    seconds : float or sequence [shape=(K,)]
        Sigma of the Gaussian whose noise is as fast.
    rng : numpy.random.Generator
        Equal generators give equal noise.
    """

    def __init__(
        self,
        spread: "Float64 | tuple[float, ...]",
        seconds: "float | Float64",
        rng: np.random.Generator,
    ) -> None:
        scale = np.asarray(spread, np.float64)
        self.kept = np.exp(-1 / (np.broadcast_to(seconds, scale.shape) * PACE * FRAME_RATE))
        square = self.kept**2  # the pulse's response k^n (n + 1) (n + 2) / 2, squared, in sum:
        self.scale = scale * np.sqrt((1 - square) ** 5 / (1 + 4 * square + square**2))
        self.rng, self.state = rng, np.zeros((POLES, len(scale)))

    def next(self) -> Float64:
        """Values of the next frame [shape=(K,)]."""
        values: Float64 = self.scale * self.rng.standard_normal(len(self.scale))
        for pole in self.state:
            pole *= self.kept
            pole += values
            values = pole
        return values.copy()


class RunningSwells:
    """Swells of several events that have begun; each adds to some channels.

    Parameters
    ----------
    channels : int
        K.
    """

    def __init__(self, channels: int) -> None:
        self.channels = channels
        self.swells: list[tuple[float, tuple[float, float, float], Float64]] = []

    def begin(self, time: float, times: tuple[float, float, float], height: Float64) -> None:
        """Begin one at a time: attack, hold and decay in seconds, and its height [shape=(K,)]."""
        self.swells.append((time, times, height))

    def at(self, time: float) -> Float64:
        """Their sum at a time [shape=(K,)]; times never fall."""
        self.swells = [s for s in self.swells if time < s[0] + sum(s[1])]
        total = np.zeros(self.channels)
        for begin, times, height in self.swells:
            total += _swelling(time - begin, *times) * height
        return total


def begun(time: float) -> float:
    """Share of the motion shown at the start of a stream, 0 to 1; it begins at rest."""
    share = min(max(time / RISE_SECONDS, 0.0), 1.0)
    return share * share * (3 - 2 * share)


def _swelling(time: float, attack: float, hold: float, decay: float) -> float:
    """Rise to 1, hold and fall, in raised cosines."""
    rise = min(max(time / attack, 0.0), 1.0)
    fall = min(max(1 - (time - attack - hold) / decay, 0.0), 1.0)
    return 0.25 * (1 - math.cos(math.pi * rise)) * (1 - math.cos(math.pi * fall))
