"""Faults of the channels of captured clips: clipped, jittering, frozen, swapped sides."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deitalk.audio.frames import runs
from rig import ControlSet
from rig.arrays import Bool, Float32, Float64

MOVES = 1e-3
CLIPPED_SHARE = 0.05
"""Least share of frames at an end of the range, in stretches of `CLIPPED_SECONDS` and more."""
CLIPPED_SECONDS = 0.1
EDGE = 0.995
JITTER = 0.8
"""Distance of a frame from the mean of its neighbours, root mean square, by the standard deviation:
1.22 for white noise, at most .58 for captures and speech curves at 30 frames per second."""
FROZEN_SECONDS = 0.5
"""Time of speech in which no channel changes: the tracker lost the face."""
SWAPPED = -0.5
"""Correlation of two movements to one side, of real faces clearly positive, from which on one of
them has its sides swapped."""
LEAST_MOVEMENT = 0.02
"""Least standard deviation of a sideways movement whose side can be judged."""


@dataclass(frozen=True)
class ChannelFaults:
    """Faults of the channels of a clip."""

    clipped: tuple[str, ...]
    jittering: tuple[str, ...]
    frozen_seconds: float
    moving: Bool
    """Channels that move at all [shape=(C,)]."""
    gaze: float
    """Correlation of the sideways gaze of both eyes; NaN where one is still."""
    sideways: float
    """Correlation of jaw and mouth to the side; NaN where one is still."""
    asymmetry: Float64
    """Mean of left minus right of the pairs [shape=(P,)], 0 where unknown."""


def channel_faults(
    values: Float32, fps: float, known: Bool, controls: ControlSet, speaking: Bool
) -> ChannelFaults:
    """Measure the known channels of one clip.

    Parameters
    ----------
    values : ndarray [shape=(T, C)]
        In the order of `controls`.
    fps : float
        Frames per second.
    known : ndarray of bool [shape=(C,)]
        Channels that the source can know.
    controls : ControlSet
        Board.
    speaking : ndarray of bool [shape=(T,)]
        Frames with speech: only there a face that stands still is a fault.
    """
    moving = known & (np.ptp(values, axis=0) > MOVES)
    places, x = np.flatnonzero(moving), values.astype(np.float64)
    # Channels that stay at an end of their range, away from rest, again and again.
    low, high, rest = controls.minimum, controls.maximum, controls.rest
    at_end = (high > rest) & (values >= rest + EDGE * (high - rest))
    at_end |= (low < rest) & (values <= rest - EDGE * (rest - low))
    held = [_longer(at_end[:, i], max(CLIPPED_SECONDS * fps, 2)) for i in places]
    noise = x[1:-1] - (x[:-2] + x[2:]) / 2
    jitter = np.sqrt((noise**2).mean(axis=0)) / np.maximum(x.std(axis=0), 1e-9)
    is_long = len(values) >= 10
    # Speech in which no moving channel changes.
    still = (np.abs(np.diff(values[:, moving], axis=0)) < 1e-6).all(axis=1) & speaking[1:]
    frozen = _longer(still, FROZEN_SECONDS * fps) / fps if len(places) >= 3 and len(x) >= 3 else 0.0
    clipped = [i for i, n in zip(places, held, strict=True) if n >= CLIPPED_SHARE * len(values)]
    return ChannelFaults(
        tuple(controls.names[i] for i in clipped),
        tuple(controls.names[i] for i in places if is_long and jitter[i] > JITTER),
        frozen,
        moving,
        _together(values, "CTRL_L_eye.tx", "CTRL_R_eye.tx", controls),
        _together(values, "CTRL_C_jaw.tx", "CTRL_C_mouth.tx", controls),
        asymmetry(values, known, controls),
    )


def _longer(flags: Bool, least: float) -> int:
    """Frames in runs of at least so many."""
    lengths = np.diff(runs(flags), axis=1)
    return int(lengths[lengths >= least].sum())


def _together(values: Float32, one: str, other: str, controls: ControlSet) -> float:
    if one not in controls or other not in controls:
        return float("nan")
    a, b = (values[:, controls.index(name)].astype(np.float64) for name in (one, other))
    if min(a.std(), b.std()) < LEAST_MOVEMENT:
        return float("nan")
    return float(np.corrcoef(a, b)[0, 1])


def asymmetry(values: Float32, known: Bool, controls: ControlSet) -> Float64:
    """Mean of left minus right of every pair of known channels [shape=(P,)]."""
    mirror = controls.mirror_index
    pairs = [(i, int(mirror[i])) for i in range(len(mirror)) if i < mirror[i]]
    mean = values.mean(axis=0, dtype=np.float64)
    return np.array([mean[i] - mean[j] if known[i] and known[j] else 0.0 for i, j in pairs])


def swapped_takes(takes: Sequence[Float64]) -> list[int]:
    """Places of an actor's takes whose asymmetry is the mirrored one of most others.

    Parameters
    ----------
    takes : sequence of array [shape=(P,)]
        `asymmetry` of at least three takes; of fewer nothing can be told.
    """
    if len(takes) < 3:
        return []
    swapped, total = [], np.sum(takes, axis=0)
    for place, own in enumerate(takes):
        others = (total - own) / (len(takes) - 1)
        size = float(np.linalg.norm(own) * np.linalg.norm(others))
        strong = min(np.linalg.norm(own), np.linalg.norm(others)) > LEAST_MOVEMENT
        if strong and float(own @ others) / size < SWAPPED:
            swapped.append(place)
    return swapped if len(swapped) <= len(takes) // 2 else []
