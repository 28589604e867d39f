"""What phones whose times are known require of the frames.

A network leaves an uncertain /b/ half closed. Where the words are known the lips meet within it,
the lower lip meets the teeth within an f or a v, and the lips are rounded within a rounded sound;
elsewhere nothing is added. Letters: T frames at 30 per second.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.postprocess.phones import BILABIALS, LABIODENTALS
from rig.arrays import Bool, Float32

ROUNDED = {
    "UW": (0.35, 0.9), "W": (0.3, 1.0), "OW": (0.5, 0.6), "UH": (0.35, 0.4), "AO": (0.55, 0.15),
    "SH": (0.85, 0.1), "ZH": (0.8, 0.1), "CH": (0.8, 0.1), "JH": (0.75, 0.1),
}  # fmt: skip
"""Funnel and purse of rounded phones, from the tables of the training corpus."""
ROUNDED_SHARE = 0.6
"""Of that rounding, which is met at least: quick speech rounds less."""
FUNNEL, PURSE = 0.75, 0.79
"""Values of the controls for a full funnel and purse."""
LEAST_FRAMES = 2
"""Frames of the shortest contact."""
ROUNDING_STEP = 0.2
"""Largest step of the rounding in a frame, as share of its height."""


class KnownPhone(NamedTuple):
    """A phone and its time in the sound."""

    start: float
    """Seconds."""
    end: float
    name: str
    """A member of `deitalk.postprocess.phones.PHONES`."""
    is_known: bool = True
    """Whether the sound does not contradict it."""


def phone_tracks(phones: Sequence[KnownPhone], n_frames: int) -> Float32:
    """What phones require of each frame [shape=(T, 4)]; 0 where there are none.

    1 where they close the lips, 1 where the lower lip meets the teeth, the least funnel and the
    least purse; `deitalk.postprocess.curve_stages.MeetPhones` applies them.
    """
    tracks = np.zeros((n_frames, 4), np.float32)
    tracks[:, 0] = phone_frames(phones, BILABIALS, n_frames)
    tracks[:, 1] = phone_frames(phones, LABIODENTALS, n_frames) & (tracks[:, 0] == 0)
    tracks[:, 2:] = _least_rounding(phones, n_frames)
    return tracks


def phone_frames(phones: Sequence[KnownPhone], names: frozenset[str], n_frames: int) -> Bool:
    """Frames within phones of some names, at least `LEAST_FRAMES` of each [shape=(T,)]."""
    frames = np.zeros(n_frames, bool)
    for phone in phones:
        if phone.name in names:
            first, stop = _frames(phone)
            frames[max(first, 0) : stop] = True
    return frames


def _frames(phone: KnownPhone) -> tuple[int, int]:
    """First frame of a phone and the one after its last; the nearest ones of a short phone."""
    first, stop = (int(np.ceil(time * FRAME_RATE - 1e-6)) for time in phone[:2])
    if stop - first < LEAST_FRAMES:
        middle = (phone.start + phone.end) / 2 * FRAME_RATE
        first = round(middle - (LEAST_FRAMES - 1) / 2)
        stop = first + LEAST_FRAMES
    return first, stop


def _least_rounding(phones: Sequence[KnownPhone], n_frames: int) -> Float32:
    """Least funnel and purse within rounded phones, with slopes around them [shape=(T, 2)]."""
    floors = np.zeros((n_frames, 2), np.float32)
    for phone in phones:
        if phone.name in ROUNDED:
            first, stop = _frames(phone)
            least = ROUNDED_SHARE * np.array(ROUNDED[phone.name]) * (FUNNEL, PURSE)
            rows = floors[max(first, 0) : stop]
            np.maximum(rows, least, out=rows)
    out = floors.copy()
    for frames in range(1, round(1 / ROUNDING_STEP)):
        lower = floors * (1 - frames * ROUNDING_STEP)
        out[frames:] = np.maximum(out[frames:], lower[:-frames])
        out[:-frames] = np.maximum(out[:-frames], lower[frames:])
    return out
