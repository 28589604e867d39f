"""Prosody of every frame of a voice, and its strength without its level, of all or around a frame.

At any gain, the decibels by which the speaker is louder than usual, as far as spectrum and pitch
tell. Three small networks, trained from different seeds, are averaged;
each is three convolutions on prosody and spectrum, whose mean and spread over the speech are mapped
to the number. They are evaluated here in numpy, and trained in torch.

Not in the paper: DEITalk's saliency compares frames of one clip, not clips. Letters: F features.
"""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib import resources
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE, frame_centres
from rig.arrays import Bool, Float32, Float64, Int64

# Prosody of a voice: level, spectral tilt and pitch of every frame.
#
# The index is their mean, each relative to the clip's average; of the untrained measures that were
# compared it correlates best with human ratings of arousal.


LEVEL_DB, PITCH_SEMITONES, TILT_DB = 5.0, 3.5, 5.0
"""One standard deviation of each measure within a lively reading."""
SMOOTHING_SECONDS = 0.2
"""Sigma of the Gaussian that smooths the index: about 0.5 s wide at half its height."""
LEVEL_WINDOW = 800  # samples, 50 ms
WINDOW = 1024  # samples, 64 ms, centred on the frame's time
ACTIVE_DB = 25.0  # below the loudest speech; quieter frames are not active
VOICED = 0.35  # least autocorrelation
SHORTEST, LONGEST = 36, 230  # samples of a period: 444 to 70 Hz
PIECE = 512  # frames at once, so that an hour fits
BANDS = 26
BAND_EDGES_HZ = 700 * (
    (1 + 80 / 700) ** (1 - np.linspace(0, 1, BANDS + 1))
    * (1 + 7600 / 700) ** np.linspace(0, 1, BANDS + 1)
    - 1
)
"""Of equal width on the mel scale, 80 to 7600 Hz."""
SONORANT = slice(3, 18)
"""Bands of the first three formants, 330 to 3300 Hz, in which syllables stand out most."""


class Prosody(NamedTuple):
    """Measures of every frame."""

    level: Float64
    """dB [shape=(T,)]."""
    bright: Float64
    """Power from 1 to 4 kHz [shape=(T,)]."""
    dark: Float64
    """Power from 80 Hz to 1 kHz [shape=(T,)]."""
    pitch: Float64
    """Semitones over 100 Hz [shape=(T,)]."""
    active: Bool
    """Loud enough to be speech [shape=(T,)]."""
    voiced: Bool
    """Active and periodic [shape=(T,)]."""
    periodicity: Float64
    """Largest autocorrelation at the lags of a pitch, -1 to 1 [shape=(T,)]."""
    bands: Float64
    """Power in bands of equal mel width [shape=(T, 26)]."""

    @property
    def tilt(self) -> Float64:
        """Bright over dark, dB [shape=(T,)]."""
        tilt: Float64 = 10 * np.log10((self.bright + 1e-12) / (self.dark + 1e-12))
        return tilt

    @property
    def sonority(self) -> Float64:
        """Power of the bands of the formants, dB [shape=(T,)]."""
        return sonority_db(self.bands.T)


def sonority_db(bands: Float64) -> Float64:
    """Power of the bands of the formants, dB [shape=(T,)], of all bands (26, T)."""
    sonority: Float64 = 10 * np.log10(bands[SONORANT].sum(axis=0) + 1e-12)
    return sonority


def level_db(waveform: Float32, centres: Int64, width: int = LEVEL_WINDOW) -> Float64:
    """Mean power around some samples.

    Parameters
    ----------
    waveform : ndarray [shape=(S,)]
        Full scale is 1; silence before and after it.
    centres : ndarray of int [shape=(T,)]
        Samples, 0 to S.
    width : int
        Samples that are averaged, the first of them at ``centre - width // 2``.

    Returns
    -------
    ndarray [shape=(T,)]
        dB re full scale, -100 or more.
    """
    total = np.concatenate(([0.0], np.cumsum(np.square(waveform, dtype=np.float64))))
    first = np.clip(centres - width // 2, 0, len(waveform))
    last = np.clip(centres - width // 2 + width, 0, len(waveform))
    level: Float64 = 10 * np.log10((total[last] - total[first]) / width + 1e-10)
    return level


def rms_db(waveform: Float32) -> float:
    """RMS of a whole recording, dB re full scale; ``-inf`` for digital silence."""
    power = float(np.square(waveform, dtype=np.float64).mean())
    return 10 * math.log10(power) if power > 0 else -math.inf


def measure_prosody(waveform: Float32, n_frames: int) -> Prosody:
    """Measure level, tilt and pitch of a recording.

    Parameters
    ----------
    waveform : ndarray [shape=(S,)]
        16 kHz, any level.
    n_frames : int
        Frames T; frame i is at i / 30 seconds.
    """
    columns = [
        _measure(waveform, np.arange(first, min(first + PIECE, n_frames)))
        for first in range(0, n_frames, PIECE)
    ]
    measured = np.concatenate(columns, axis=1) if columns else np.zeros((5 + BANDS, 0))
    level, bright, dark, pitch, periodicity = measured[:5]
    active = level > np.percentile(level, 95) - ACTIVE_DB if n_frames else np.zeros(0, bool)
    voiced = active & (periodicity > VOICED)
    return Prosody(level, bright, dark, pitch, active, voiced, periodicity, measured[5:].T)


def _measure(waveform: Float32, frames: Int64) -> Float64:
    """Level, bright and dark power, pitch, periodicity and power of the bands [shape=(31, T)]."""
    centres = frame_centres(frames)
    low, high = int(centres[0]) - WINDOW // 2, int(centres[-1]) + WINDOW // 2
    piece = waveform[max(low, 0) : high].astype(np.float64)
    piece = np.pad(piece, (max(-low, 0), high - low - max(-low, 0) - len(piece)))
    windows = np.lib.stride_tricks.sliding_window_view(piece, WINDOW)
    return measure_windows(windows[centres - centres[0]])


def tonality(pitch: Float64, periodicity: Float64) -> Float64:
    """Periodicity of `Prosody` where it has a pitch, else 0.

    That of a rumble, which has none, is largest at the shortest lag.
    """
    highest = 12 * math.log2(SAMPLE_RATE / SHORTEST / 100)
    return np.where(pitch < highest - 1e-6, periodicity, 0.0)


def measure_windows(windows: Float64) -> Float64:
    """Measures of `WINDOW` samples each (T, WINDOW).

    Returns
    -------
    ndarray [shape=(31, T)]
        Level, bright and dark power, pitch, periodicity and power of the bands, as in `Prosody`.
    """
    rows = windows * np.hanning(WINDOW)
    spectra = np.fft.rfft(rows, 2 * WINDOW)
    power = np.square(spectra.real) + np.square(spectra.imag)
    frequency = np.fft.rfftfreq(2 * WINDOW, 1 / SAMPLE_RATE)
    above = power[:, (frequency > 1000) & (frequency < 4000)].sum(axis=1)
    below = power[:, (frequency > 80) & (frequency < 1000)].sum(axis=1)
    edges = np.searchsorted(frequency, BAND_EDGES_HZ)
    bands = np.add.reduceat(power, edges, axis=1)[:, :-1]
    correlation = np.fft.irfft(power, axis=1)[:, :LONGEST]
    correlation = correlation / (correlation[:, :1] + 1e-12)
    lag = correlation[:, SHORTEST:].argmax(axis=1) + SHORTEST
    return np.stack(
        [
            10 * np.log10(power.mean(axis=1) + 1e-12),
            above,
            below,
            12 * np.log2(SAMPLE_RATE / lag / 100),
            correlation[np.arange(len(lag)), lag],
            *bands.T,
        ]
    )


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
