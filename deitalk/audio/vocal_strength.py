"""Strength of a voice without its level, of a whole recording or around a frame.

At any gain, the decibels by which the speaker is louder than usual, as far as spectrum and pitch
tell. Three small networks, trained from different seeds, are averaged;
each is three convolutions on prosody and spectrum, whose mean and spread over the speech are mapped
to the number. They are evaluated on arrays or tensors.

Not in the paper: DEITalk's saliency compares frames of one clip, not clips. Letters: F features.
"""

from collections.abc import Mapping
from functools import lru_cache
from importlib import resources

import numpy as np

from deitalk.array_functions import (
    Array,
    as_index,
    convolved,
    filtered,
    gelu,
    is_tensor,
    join,
    library,
    like,
    mean_of,
    padded,
    precise,
    single,
)
from deitalk.audio.prosody import BANDS, Prosody
from rig.arrays import Float32

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


def strength_frames(prosody: Prosody, activity: Array) -> Array:
    """Input of the network: features of every frame, not yet level-normalised [shape=(T, F)].

    Log power of the bands (powers of ten), octaves of pitch over 100 Hz where voiced, voiced,
    periodicity of speech, speech.
    """
    xp, voiced, speech = library(prosody.level), prosody.voiced, activity > 0
    columns = prosody.pitch / 12 * voiced, voiced, prosody.periodicity * speech, speech
    single_columns = xp.stack([single(column) for column in columns], axis=1)
    return join((single(xp.log10(prosody.bands + 1e-9)), single_columns), 1)


def without_level(frames: Array) -> tuple[Array, Array]:
    """Features with the power of the speech taken off its bands, and that power in dB."""
    xp, speech = library(frames), frames[:, -1] > 0
    speech = speech | (as_index(speech).sum() < FEWEST_FRAMES)
    power = xp.log10(mean_of((10.0 ** precise(frames[:, :BANDS])).sum(1), speech))
    bands = xp.clip(frames[:, :BANDS] - single(power), LOWEST, HIGHEST)
    return join((bands, frames[:, BANDS:]), 1), 10 * power


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
        for name, value in sorted(weights.items()):  # a file gives them in no certain order
            _, number, part = name.split(".", 2)
            self._members.setdefault(number, {})[part] = value

    def measure(self, frames: Float32) -> float:
        """Strength of a recording in dB above the usual; 0 where nothing is voiced.

        Parameters
        ----------
        frames : array [shape=(T, F)]
            From `strength_frames`.
        """
        return float(self.follow(frames)[0])

    def follow(self, frames: Array) -> tuple[Array, Array]:
        """Strength of a recording as `measure`, and of some 2 s around each frame [shape=(T,)]."""
        xp, is_voiced = library(frames), (frames[:, IS_VOICED] > 0).any()
        if not is_tensor(frames) and not is_voiced:
            return np.float32(0), np.zeros(len(frames), np.float32)
        rows, _ = without_level(frames)
        weight = xp.clip(frames[:, -1:], REST_WEIGHT, None)
        read = [_member(weights, rows, weight) for weights in self._members.values()]
        whole, blocks = (xp.stack(part).mean(0) for part in zip(*read, strict=True))
        # Between the middles of blocks by straight lines.
        place = (xp.arange(frames.shape[0]) + 0.5) / BLOCK_FRAMES - 0.5
        place = xp.clip(place, 0, blocks.shape[0] - 1)
        below = as_index(xp.floor(place))
        above = xp.clip(below + 1, None, blocks.shape[0] - 1)
        around = blocks[below] + (place - below) * (blocks[above] - blocks[below])
        return whole * is_voiced, single(around * is_voiced)


def _member(weights: Mapping[str, Float32], rows: Array, weight: Array) -> tuple[Array, Array]:
    """Strength in dB by one network, of all frames [shape=()] and of blocks [shape=(N,)]."""
    part = {name: like(value, rows) for name, value in weights.items()}

    def linear(name: str, x: Array) -> Array:
        return x @ part[f"{name}.weight"].T + part[f"{name}.bias"]

    x = (rows - part["mean"]) / part["spread"]
    direct = [linear("direct", pooled) for pooled in _pooled(x, weight)]
    for k, dilation in enumerate(DILATIONS):
        layer = part[f"layers.{k}.weight"], part[f"layers.{k}.bias"]
        more = gelu(convolved(x, *layer, dilation))
        x = x + more if k else more
    hidden = [linear("output", gelu(linear("hidden", pooled))) for pooled in _pooled(x, weight)]
    whole, blocks = (UNIT_DB * (a + b)[:, 0] for a, b in zip(direct, hidden, strict=True))
    return whole[0], blocks


def _pooled(x: Array, weight: Array) -> tuple[Array, Array]:
    """Mean and spread of rows (T, C) by their weight (T, 1): of all, and around each block.

    Returns
    -------
    whole : array [shape=(1, 2 C)]
    blocks : array [shape=(N, 2 C)]
        Of blocks of `BLOCK_FRAMES`, and with a Gaussian weight of those beside each.
    """
    xp = library(x)
    reach = int(4 * AROUND_BLOCKS)
    kernel = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / AROUND_BLOCKS))
    more = -x.shape[0] % BLOCK_FRAMES
    centre = (weight * x).sum(0, keepdims=True) / weight.sum()  # near it squares lose no digits
    moved = x - centre

    def sums(values: Array) -> Array:
        blocks = padded(values, 0, more).reshape(-1, BLOCK_FRAMES, values.shape[1]).sum(1)
        return blocks if is_tensor(blocks) else precise(blocks)

    parts = [sums(weight), sums(weight * moved), sums(weight * moved * moved)]
    found = []
    all_frames = [part.sum(0, keepdims=True) for part in parts]
    for total, first, second in (all_frames, [filtered(part, kernel) for part in parts]):
        mean = first / total
        spread = xp.sqrt(xp.clip(second / total - mean * mean, 1e-4, None))
        found.append(single(join((mean + centre, spread), 1)))
    return found[0], found[1]


@lru_cache(maxsize=1)
def vocal_strength() -> VocalStrength:
    """The networks with the weights of the package."""
    from safetensors.numpy import load

    content = resources.files("deitalk.audio").joinpath(WEIGHTS).read_bytes()
    return VocalStrength({name: value.astype(np.float32) for name, value in load(content).items()})
