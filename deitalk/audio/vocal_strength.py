"""Strength of a voice without its level, of a whole recording or around a frame.

At any gain, the decibels by which the speaker is louder than usual, as far as spectrum and pitch
tell. Three small networks, trained from different seeds, are averaged;
each is three convolutions on prosody and spectrum, whose mean and spread over the speech are mapped
to the number. They are evaluated here in numpy, and trained in torch.

Not in the paper: DEITalk's saliency compares frames of one clip, not clips. Letters: F features.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib import resources

import numpy as np

from deitalk.audio.prosody import BANDS, Prosody
from rig.arrays import Float32, Float64

WEIGHTS = "vocal_strength.safetensors"
FEATURES = BANDS + 4
PITCH, IS_VOICED = BANDS, BANDS + 1
"""Columns of the frames."""
MEMBERS, CHANNELS, KERNEL, DILATIONS = 3, 48, 5, (1, 2, 4)
LOWEST, HIGHEST = -4.5, 1.0
"""Limits of a band below and above the power of all speech, in powers of ten."""
FEWEST_FRAMES = 3
UNIT_DB = 3.0
"""Decibels per unit of the network's output."""
REST_WEIGHT = 1e-3
"""Weight of frames without speech."""
BLOCK_FRAMES = 10
"""Frames whose sums are taken together around each frame."""
AROUND_BLOCKS = 2.5
"""Sigma of what counts around a frame: 0.83 s."""
VALUES_AT_ONCE = 65_536
ROWS_AT_ONCE = 4096
"""Frames that a layer computes at once: an hour of temporary arrays would be 150 MB."""


def strength_frames(prosody: Prosody, activity: Float32) -> Float32:
    """Input of the network: features of every frame, not yet level-normalised [shape=(T, F)].

    Log power of the bands (powers of ten), octaves of pitch over 100 Hz where voiced, voiced,
    periodicity of speech, speech.
    """
    voiced, speech = prosody.voiced, activity > 0
    return np.concatenate(
        [
            np.log10(prosody.bands + 1e-9),
            np.where(voiced, prosody.pitch / 12, 0)[:, None],
            voiced[:, None],
            np.where(speech, prosody.periodicity, 0)[:, None],
            speech[:, None],
        ],
        axis=1,
    ).astype(np.float32)


def without_level(frames: Float32) -> tuple[Float32, float]:
    """Features with the power of the speech taken off its bands, and that power in dB."""
    speech = frames[:, -1] > 0
    if speech.sum() < FEWEST_FRAMES:
        speech = np.ones(len(frames), bool)
    power = np.log10((10.0 ** frames[speech, :BANDS].astype(np.float64)).sum(axis=1).mean())
    out = frames.copy()
    out[:, :BANDS] = np.clip(frames[:, :BANDS] - power, LOWEST, HIGHEST)
    return out, 10 * float(power)


class VocalStrength:
    """Frames of speech to its strength: the mean of several networks.

    Parameters
    ----------
    weights : mapping of str to array
        State of the trained network.
    """

    def __init__(self, weights: Mapping[str, Float32]) -> None:
        self.weights = weights
        self._members: dict[str, dict[str, Float32]] = {}
        for name, value in weights.items():
            _, number, part = name.split(".", 2)
            self._members.setdefault(number, {})[part] = value

    def measure(self, frames: Float32) -> float:
        """Strength of a recording in dB above the usual; 0 where nothing is voiced.

        Parameters
        ----------
        frames : array [shape=(T, F)]
            From `strength_frames`.
        """
        return self.follow(frames)[0]

    def follow(self, frames: Float32) -> tuple[float, Float32]:
        """Strength of a recording as `measure`, and of some 2 s around each frame [shape=(T,)]."""
        if not frames[:, IS_VOICED].any():
            return 0.0, np.zeros(len(frames), np.float32)
        frames, _ = without_level(frames)
        weight = np.maximum(frames[:, -1], REST_WEIGHT)
        pools = _Pool(weight, len(frames), 0.0), _Pool(weight, BLOCK_FRAMES, AROUND_BLOCKS)
        read = [_member(weights, frames, pools) for weights in self._members.values()]
        whole, blocks = (np.mean(part, axis=0) for part in zip(*read, strict=True))
        middles = (np.arange(len(blocks)) + 0.5) * BLOCK_FRAMES - 0.5
        around = np.interp(np.arange(len(frames)), middles, blocks)
        return float(whole[0]), around.astype(np.float32)


class _Pool:
    """Means and spreads over blocks of frames and, with a Gaussian weight, over those around.

    Parameters
    ----------
    weight : array [shape=(T,)]
        Of each frame.
    size : int
        Frames of a block.
    sigma : float
        Blocks; 0: each alone.
    """

    def __init__(self, weight: Float32, size: int, sigma: float) -> None:
        self.weight, self.starts = weight.astype(np.float64)[:, None], range(0, len(weight), size)
        self.reach = int(4 * sigma)
        steps = np.arange(-self.reach, self.reach + 1)
        self.kernel = np.exp(-0.5 * np.square(steps / sigma)) if sigma else np.ones(1)
        self.total = self._sums(self.weight)

    def _sums(self, rows: Float64) -> Float64:
        sums = np.add.reduceat(rows, self.starts, axis=0)
        padded = np.pad(sums, ((self.reach, self.reach), (0, 0)))
        return sum(
            (share * padded[k : k + len(sums)] for k, share in enumerate(self.kernel)),
            np.zeros_like(sums),
        )

    def mean_and_spread(self, x: Float32) -> Float32:
        """Weighted mean and standard deviation: (T, C) to (K, 2 C)."""
        parts = []
        at_once = max(VALUES_AT_ONCE // len(x), 8)  # columns: an hour's squares are large
        for first in range(0, x.shape[1], at_once):
            columns = x[:, first : first + at_once].astype(np.float64)
            mean = self._sums(self.weight * columns) / self.total
            square = self._sums(self.weight * np.square(columns)) / self.total - np.square(mean)
            parts.append((mean, np.sqrt(np.maximum(square, 1e-4))))
        return np.concatenate(
            [np.concatenate(part, axis=1) for part in zip(*parts, strict=True)], axis=1
        ).astype(np.float32)


def _member(
    weights: Mapping[str, Float32], frames: Float32, pools: Sequence[_Pool]
) -> list[Float32]:
    """Strength in dB by one network, of the blocks of each pool [shape=(K,)]."""
    x = (frames - weights["mean"]) / weights["spread"]
    direct = [_linear(weights, "direct", pool.mean_and_spread(x)) for pool in pools]
    x = _layer(weights, 0, x)
    for i in range(1, len(DILATIONS)):
        x += _layer(weights, i, x)
    hidden = [_gelu(_linear(weights, "hidden", pool.mean_and_spread(x))) for pool in pools]
    both = zip(direct, hidden, strict=True)
    return [UNIT_DB * (first + _linear(weights, "output", then))[:, 0] for first, then in both]


def _linear(weights: Mapping[str, Float32], name: str, x: Float32) -> Float32:
    return x @ weights[f"{name}.weight"].T + weights[f"{name}.bias"]


def _layer(weights: Mapping[str, Float32], layer: int, x: Float32) -> Float32:
    """Dilated convolution along time that keeps the length, activated: (T, C) to (T, CHANNELS)."""
    kernel, reach = weights[f"layers.{layer}.weight"], KERNEL // 2 * DILATIONS[layer]
    out = np.tile(weights[f"layers.{layer}.bias"], (len(x), 1))
    for start in range(0, len(x), ROWS_AT_ONCE):
        stop = min(start + ROWS_AT_ONCE, len(x))
        first, last = max(start - reach, 0), min(stop + reach, len(x))
        around = ((reach - (start - first), reach - (last - stop)), (0, 0))
        padded, rows = np.pad(x[first:last], around), out[start:stop]
        for tap in range(KERNEL):
            at = tap * DILATIONS[layer]
            rows += padded[at : at + len(rows)] @ kernel[:, :, tap].T
        rows[:] = _gelu(rows)
    return out


def _gelu(x: Float32) -> Float32:
    """Gaussian error linear unit, exact to 1e-7.

    The error function is Abramowitz and Stegun's 7.1.26.
    """
    z = np.abs(x) * np.float32(0.5**0.5)
    t = 1 / (1 + np.float32(0.3275911) * z)
    series = np.zeros_like(t)
    for coefficient in (1.061405429, -1.453152027, 1.421413741, -0.284496736, 0.254829592):
        series = (series + np.float32(coefficient)) * t
    error = np.copysign(1 - series * np.exp(-z * z), x)
    return np.asarray(x * (1 + error) / 2, np.float32)


@lru_cache(maxsize=1)
def vocal_strength() -> VocalStrength:
    """The networks with the weights of the package."""
    from safetensors.numpy import load

    content = resources.files("deitalk.audio").joinpath(WEIGHTS).read_bytes()
    return VocalStrength({name: value.astype(np.float32) for name, value in load(content).items()})
