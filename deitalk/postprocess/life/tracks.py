"""Shapes over time that the parts share: swells of events, slow noise, fades at the ends.

All are given for consecutive frames, and do not depend on how a stream is divided.

Letters: T frames at 30 per second, n frames of a call, K channels.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from rig.arrays import Float64

RISE_SECONDS, FADE_SECONDS = 0.5, 0.9
"""Motion begins at rest with a take, and comes to rest before its end."""
STILL_SECONDS = 0.5
"""Rest at the end, but for a silence that is too short for it."""
CUT_SECONDS = 0.2
"""Silence at the end below which a take counts as cut."""
BLOCK_FRAMES = 64
"""Frames of noise that are drawn at once."""


class Swell(NamedTuple):
    """One event."""

    begin: float
    attack: float
    hold: float
    decay: float
    """Seconds."""
    heights: Float64
    """[shape=(K,)]."""

    @property
    def end(self) -> float:
        """Seconds."""
        return self.begin + self.attack + self.hold + self.decay


class Swells:
    """Events that rise, hold and fall in raised cosines; each adds to some channels.

    Parameters
    ----------
    channels : int
        K.
    """

    def __init__(self, channels: int) -> None:
        self.channels = channels
        self.swells: list[Swell] = []

    def add(
        self,
        peak: float,
        seconds: tuple[float, float, float],
        heights: dict[int, float],
        known: float,
        shortest: float | None = None,
    ) -> None:
        """Add an event.

        Parameters
        ----------
        peak : float
            Seconds at which it is wanted to be highest.
        seconds : tuple of float
            Attack, hold and decay.
        heights : dict
            Height by channel.
        known : float
            Seconds before which it cannot begin; its peak is late then.
        shortest : float, optional
            To how many seconds the attack may be shortened for that; not at all by default.
        """
        attack, hold, decay = seconds
        least = attack if shortest is None else min(shortest, attack)
        attack = min(attack, max(peak - known, least))
        rows = np.zeros(self.channels)
        rows[list(heights)] = list(heights.values())
        self.swells.append(Swell(max(known, peak - attack), attack, hold, decay, rows))

    def at(self, first: int, count: int) -> Float64:
        """Their sum in the next frames [shape=(n, K)]."""
        rows, stop = np.zeros((count, self.channels)), first + count
        for swell in self.swells:
            begin = max(int(swell.begin * FRAME_RATE), first)
            end = min(int(swell.end * FRAME_RATE) + 2, stop)
            if begin < end:
                time = np.arange(begin, end) / FRAME_RATE - swell.begin
                share = time / swell.attack, (swell.end - swell.begin - time) / swell.decay
                rise, fall = np.minimum(np.maximum(share, 0), 1)
                shape = 0.25 * (1 - np.cos(np.pi * rise)) * (1 - np.cos(np.pi * fall))
                rows[begin - first : end - first] += shape[:, None] * swell.heights
        self.swells = [swell for swell in self.swells if swell.end * FRAME_RATE >= stop]
        return rows


class Noise:
    """Noise with Gaussian spectra.

    Parameters
    ----------
    spread : sequence of float [shape=(K,)]
        Standard deviations.
    seconds : sequence of float [shape=(K,)]
        Sigmas of the Gaussians that white noise is smoothed with.
    rng : numpy.random.Generator
        Equal generators give equal noise.
    """

    def __init__(
        self, spread: Sequence[float], seconds: Sequence[float], rng: np.random.Generator
    ) -> None:
        sigmas = np.asarray(seconds) * FRAME_RATE
        self.kernels = []
        for height, sigma in zip(spread, sigmas.tolist(), strict=True):
            radius = int(4 * sigma) + 1
            kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
            kernel *= height * np.sqrt(2 * sigma * np.sqrt(np.pi)) / kernel.sum()
            self.kernels.append(kernel)
        self.margin = max(len(kernel) // 2 for kernel in self.kernels)
        self.rng, self.begin = rng, 0
        self.white = rng.standard_normal((2 * self.margin, len(sigmas)))
        self.rows: Float64 = np.zeros((0, len(sigmas)))

    def peek(self, frame: int) -> Float64:
        """Values of one frame [shape=(K,)], which may be to come."""
        self._draw(frame + 1)
        row: Float64 = self.rows[max(frame - self.begin, 0)]
        return row

    def at(self, first: int, count: int) -> Float64:
        """Values of the next frames [shape=(n, K)]."""
        self._draw(first + count)
        rows = self.rows[first - self.begin : first + count - self.begin]
        self.begin, self.rows = first + count, self.rows[first + count - self.begin :]
        return rows

    def _draw(self, stop: int) -> None:
        lacking = stop - self.begin - len(self.rows)
        if lacking <= 0:
            return
        count = -(-lacking // BLOCK_FRAMES) * BLOCK_FRAMES
        white = np.concatenate((self.white, self.rng.standard_normal((count, len(self.kernels)))))
        self.white = white[count:]
        columns = []
        for column, kernel in zip(white.T, self.kernels, strict=True):
            free = self.margin - len(kernel) // 2
            inner = column[free : len(column) - free]
            columns.append(np.convolve(inner, kernel, mode="valid"))
        self.rows = np.concatenate((self.rows, np.stack(columns, axis=1)))


def presence(first: int, count: int, end: float, silence: float) -> Float64:
    """Share of the motion shown: 0 at the start of a take and in silence at its end [shape=(n,)].

    Parameters
    ----------
    first, count : int
        The frames.
    end : float
        Seconds of the take's last frame; infinite if it is not known.
    silence : float
        Seconds without speech at the end; a take that is cut in its speech keeps its motion.
    """
    is_cut = math.isinf(end) or silence <= CUT_SECONDS
    if is_cut and first > RISE_SECONDS * FRAME_RATE:
        return np.ones(count)
    time = (first + np.arange(count)) / FRAME_RATE
    rise = np.clip(time / RISE_SECONDS, 0, 1)
    shape: Float64 = rise * rise * (3 - 2 * rise)
    if not is_cut:
        still = min(STILL_SECONDS, silence / 3)
        fade = np.clip((end - time - still) / min(FADE_SECONDS, silence - still), 0, 1)
        shape *= fade * fade * (3 - 2 * fade)
    return shape
