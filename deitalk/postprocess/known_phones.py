"""Contacts and rounding of phones whose times are known, met on the curves.

A network leaves an uncertain /b/ half closed. Where the words are known the lips meet within it,
the lower lip meets the teeth within an f or a v, and the lips are rounded within a rounded sound;
elsewhere nothing is added. Letters: T frames at 30 per second, C controls.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.phones import BILABIALS, LABIODENTALS
from deitalk.postprocess.curve_rules import Expression
from rig import ControlSet
from rig.arrays import Bool, Float32

ROUNDED = {
    "UW": (0.35, 0.9), "W": (0.3, 1.0), "OW": (0.5, 0.6), "UH": (0.35, 0.4), "AO": (0.55, 0.15),
    "SH": (0.85, 0.1), "ZH": (0.8, 0.1), "CH": (0.8, 0.1), "JH": (0.75, 0.1),
}  # fmt: skip
"""Funnel and purse of rounded phones, from the tables of `deitalk.research.corpus.articulation`."""
ROUNDED_SHARE = 0.6
"""Of that rounding, which is met at least: quick speech rounds less."""
FUNNEL, PURSE = 0.75, 0.79
"""Values of the controls for a full funnel and purse (`deitalk.research.corpus.tables`)."""
LEAST_FRAMES = 2
"""Frames of the shortest contact."""
ROUNDING_STEP = 0.2
"""Largest step of the rounding in a frame, as share of its height."""
PARTED = 0.8
"""Share by which a contact that is added lowers what parts the lips."""


class KnownPhone(NamedTuple):
    """A phone and its time in the sound."""

    start: float
    """Seconds."""
    end: float
    name: str
    """A member of `deitalk.phones.PHONES`."""
    is_known: bool = True
    """Whether the sound does not contradict it."""


def meet_phones(curves: Float32, rules: Expression, phones: Sequence[KnownPhone]) -> None:
    """Close, bite and round the lips where the phones require it, in place.

    What a network shows stays where it is more; nothing is lowered but what parts closed lips.

    Parameters
    ----------
    curves : array [shape=(T, C)]
        A reading after `Expression.sharpen_contacts`.
    rules : Expression
        Places of the controls.
    phones : sequence of KnownPhone
        Phones with their times.
    """
    if not phones:
        return
    n_frames = len(curves)
    closed = phone_frames(phones, BILABIALS, n_frames)
    bitten = phone_frames(phones, LABIODENTALS, n_frames) & ~closed
    before = rules.contact(curves)
    for places, frames in ((rules.together, closed), (rules.bite, bitten)):
        curves[np.ix_(frames, places)] = np.maximum(curves[np.ix_(frames, places)], 1)
    added = np.maximum(rules.contact(curves) - before, 0)
    curves[:, rules.lively] *= 1 - PARTED * added[:, None]
    _round(curves, rules.controls, phones)


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


def _round(curves: Float32, controls: ControlSet, phones: Sequence[KnownPhone]) -> None:
    """Raise funnel and purse to their least values within rounded phones, in place."""
    floors = np.zeros((len(curves), 2), np.float32)
    for phone in phones:
        if phone.name in ROUNDED:
            first, stop = _frames(phone)
            least = ROUNDED_SHARE * np.array(ROUNDED[phone.name]) * (FUNNEL, PURSE)
            rows = floors[max(first, 0) : stop]
            np.maximum(rows, least, out=rows)
    # Floors that rise and fall by `ROUNDING_STEP` a frame around each plateau.
    out = floors.copy()
    for frames in range(1, round(1 / ROUNDING_STEP)):
        lower = floors * (1 - frames * ROUNDING_STEP)
        out[frames:] = np.maximum(out[frames:], lower[:-frames])
        out[:-frames] = np.maximum(out[:-frames], lower[frames:])
    floors = out
    for column, part in enumerate(("mouth_funnel", "mouth_purse")):
        places = [i for i, name in enumerate(controls.names) if part in name]
        block, floor = curves[:, places], floors[:, column, None]
        curves[:, places] = np.where(floor > 0, np.maximum(block, floor), block)
