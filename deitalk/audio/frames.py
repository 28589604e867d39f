"""The two rates: samples at 16 kHz and rig frames at 30 Hz (DEITalk §3.2)."""

from math import ceil

import numpy as np

from rig.arrays import Bool, Float64, Int64

SAMPLE_RATE = 16_000  # Hz; input of wav2vec 2.0 and of the mel frontend
FRAME_RATE = 30  # rig frames per second


def frame_count(n_samples: int) -> int:
    """T = ceil(30 · S / 16000), in integers: 16000 samples -> 30 frames, 16001 -> 31."""
    return -(-FRAME_RATE * n_samples // SAMPLE_RATE)


def frame_centres(frames: Int64) -> Int64:
    """Sample at the time of each rig frame [shape=(T,)]: 0, 533, 1067, 1600 for frames 0 to 3."""
    return np.round(frames * SAMPLE_RATE / FRAME_RATE).astype(np.int64)


def frame_times(n_frames: int) -> Float64:
    """Time of every rig frame in seconds: (T,), frame i at i/30."""
    return np.arange(n_frames) / FRAME_RATE


def runs(mask: Bool) -> Int64:
    """[start, stop) of every run of True [shape=(n, 2)]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return edges.reshape(-1, 2)


def samples_within(seconds: float) -> int:
    """Samples of sound that last for at least so many seconds."""
    return ceil(seconds * SAMPLE_RATE)
