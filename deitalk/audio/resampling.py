"""Samples of any rate to 16 kHz as they come, 4 ms behind them.

A windowed sinc at the exact place of every sample. soxr, which whole recordings are resampled
with, gives a stream's samples in bursts 5 to 37 ms late.

Letters: S samples, m samples of a call, R samples on either side that a sample depends on.
"""

from fractions import Fraction
from functools import lru_cache

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE
from rig.arrays import Float32, Float64, Int64

CROSSINGS = 64
"""Zero crossings of the sinc on either side: 4 ms, or more of a rate below 16 kHz."""
CUTOFF = 0.955
"""Half the sound's height is left at this share of the lower Nyquist frequency (7.6 kHz)."""
KAISER = 8.0
"""Shape of the window: 80 dB at and above the Nyquist frequency."""
MOST_PHASES = 1000
"""Kernels that are kept; rates that need more compute theirs anew."""
BLOCK = 4096
"""Samples that are computed at once."""


class RunningResampler:
    """Samples of one stream at 16 kHz; any pieces give what the whole gives.

    Parameters
    ----------
    sample_rate : int
        Of the samples that come, Hz.
    """

    def __init__(self, sample_rate: int) -> None:
        step = Fraction(sample_rate, SAMPLE_RATE)
        self.rise, self.run, self.sample_rate = step.numerator, step.denominator, sample_rate
        self.reach = _reach(sample_rate)
        self.samples = np.zeros(self.reach - 1, np.float32)
        self.begin, self.n_given = 1 - self.reach, 0

    def feed(self, samples: Float32, *, last: bool = False) -> Float32:
        """Take the next samples; return those that are known now.

        With `last` the sound has ended: S samples have then given S · 16000 / rate, rounded.
        """
        end = self.begin + len(self.samples) + len(samples)
        pieces = (self.samples, samples, np.zeros(self.reach if last else 0, np.float32))
        self.samples = np.concatenate(pieces)
        stop = (self.run * (end - self.reach) - 1) // self.rise + 1
        if last:
            stop = (2 * self.run * end + self.rise) // (2 * self.rise)
        blocks = [
            self._at(np.arange(start, min(start + BLOCK, stop)))
            for start in range(self.n_given, stop, BLOCK)
        ]
        self.n_given = max(stop, self.n_given)
        needed = self.n_given * self.rise // self.run - self.reach + 1
        self.samples, self.begin = self.samples[needed - self.begin :].copy(), needed
        return np.concatenate(blocks) if blocks else np.zeros(0, np.float32)

    def _at(self, numbers: Int64) -> Float32:
        """Samples by their numbers [shape=(m,)]."""
        places, phases = np.divmod(numbers * self.rise, self.run)
        rows = np.lib.stride_tricks.sliding_window_view(self.samples, 2 * self.reach)
        starts = places - self.reach + 1 - self.begin
        if self.run == 1:  # every sample lies on one that came: no copies
            kernel = _kernels(self.sample_rate, 1)[0]
            even = rows[starts[0] : starts[-1] + 1 : self.rise]
            return np.asarray(np.einsum("mr,r->m", even, kernel), np.float32)
        rows = rows[starts]
        if self.run <= MOST_PHASES:
            kernels = _kernels(self.sample_rate, self.run)[phases]
        else:
            kernels = _kernel(self.sample_rate, phases / self.run)
        return np.asarray(np.einsum("mr,mr->m", rows, kernels), np.float32)


def _reach(sample_rate: int) -> int:
    """R, in samples of the given rate."""
    return int(np.ceil(CROSSINGS / CUTOFF * max(sample_rate / SAMPLE_RATE, 1.0)))


@lru_cache(maxsize=4)
def _kernels(sample_rate: int, n_phases: int) -> Float32:
    """Kernels of all places between two samples [shape=(n_phases, 2 R)]."""
    return _kernel(sample_rate, np.arange(n_phases) / n_phases)


def _kernel(sample_rate: int, phases: Float64) -> Float32:
    """Weights of the samples around places [shape=(m, 2 R)]; `phases` (m,) from 0 up to 1."""
    reach, cutoff = _reach(sample_rate), CUTOFF * min(SAMPLE_RATE / sample_rate, 1.0)
    offsets = np.arange(1 - reach, reach + 1) - phases[:, None]
    window = np.i0(KAISER * np.sqrt(np.maximum(1 - (offsets / reach) ** 2, 0)))
    weights = np.sinc(cutoff * offsets) * window
    return np.asarray(weights / weights.sum(axis=1, keepdims=True), np.float32)
