"""Time codes ``HH:MM:SS:FF``: the rate that their frame field counts, drop frame, midnight.

The frame field of a time code counts frames of a whole rate: 24, 25, 30, 48, 50, 60, 100 or 120 a
second. Drop frame (SMPTE ST 12-1, written with ``;``) counts 30 or 60 and leaves out the first two
or four numbers of every minute but each tenth, so that it shows the clock at 29.97 or 59.94 Hz.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.arrays import Int64
from rig.errors import FormatError

TICKS_PER_SECOND = 60_000
"""A tick is a thousandth of a sixtieth of a second: the last digit of a Live Link time code."""
TICKS_PER_DAY = 24 * 3600 * TICKS_PER_SECOND
COUNTS = (24, 25, 30, 48, 50, 60, 100, 120)
"""Frames that a second of a time code has."""
DROPPED = {30: 2, 60: 4}
"""Numbers that drop frame leaves out of a minute, by the count of a second."""
TIMECODE = re.compile(r"(\d{1,2})([:;])(\d{1,2})([:;])(\d{1,2})([:;])(\d{1,3})(?:[.,](\d{1,3}))?")
FITS = 0.5
"""Share of the seconds whose last and first frame must be one step apart."""
OFF_STEP = 0.3
"""Distance from a step, in steps, that still is one."""
ONE_COUNT = 0.002
"""Distance from one count by which frames are one count apart."""


@dataclass(frozen=True, eq=False)
class Clock:
    """Time codes as times of day.

    Parameters
    ----------
    ticks : array of int64 [shape=(T,)]
        1/60000 s since the midnight before the first one.
    count : int
        Frames that the frame field counts in a second.
    is_drop : bool
        Whether numbers are left out.
    is_certain : bool
        Whether the codes show the count: they go over the end of a second.
    """

    ticks: Int64
    count: int
    is_drop: bool
    is_certain: bool


def read_timecodes(texts: Sequence[str], where: object) -> Clock:
    """Read the time codes of a take.

    Parameters
    ----------
    texts : sequence of str
        ``HH:MM:SS:FF`` or ``HH:MM:SS:FF.mmm``; ``;`` before FF is drop frame.
    where : object
        Beginning of a message: a path.

    Raises
    ------
    FormatError
        If one is malformed or has no such frame, or drop frame does not count 30 or 60; the row
        is named.
    """
    fields = np.array([_fields(text, row, where) for row, text in enumerate(texts, 1)], np.int64)
    seconds, parts = fields[:, 0], fields[:, 1]
    found = counted(seconds, parts)
    largest = int(parts.max(initial=0))  # as Unreal infers it: at most 30.0 is thirtieths
    count = found or (30 if largest <= 30_000 else 60 if largest < 60_000 else 120)
    is_drop = bool(fields[:, 2].any()) or _leaves_out(seconds, parts, count)
    if is_drop and count not in DROPPED:
        raise FormatError(
            f"{where}: time codes with ';' count {count} frames a second; drop frame counts 30 or "
            "60: write ':'"
        )
    if is_drop:
        numbers = 1000 * (seconds * count - left_out(seconds // 60, count)) + parts
        ticks = np.rint(numbers * (60.06 / count)).astype(np.int64)
    else:
        ticks = seconds * TICKS_PER_SECOND + np.rint(_whole(seconds, parts, count) * (60 / count))
    past = np.concatenate([[0], np.cumsum(np.diff(ticks) < -TICKS_PER_DAY // 2)])
    return Clock((ticks + TICKS_PER_DAY * past).astype(np.int64), count, is_drop, found is not None)


def left_out(minutes: int | Int64, count: int) -> int | Int64:
    """Numbers that drop frame has left out after some minutes."""
    return DROPPED[count] * (minutes - minutes // 10)


def counted(seconds: Int64, parts: Int64) -> int | None:
    """Frames that the frame field counts in a second; None if no second ends.

    Parameters
    ----------
    seconds : array of int64 [shape=(T,)]
        Whole seconds of the codes.
    parts : array of int64 [shape=(T,)]
        Thousandths of frames of the codes.
    """
    step = _step(seconds, parts)
    ends = np.flatnonzero(np.isin(np.diff(seconds), (1, 1 - 24 * 3600)))
    if not step or not len(ends):
        return None
    best: tuple[float, float, int] | None = None
    for count in COUNTS:
        if parts.max() >= 1000 * count:
            continue
        off = np.abs(parts[ends + 1] + 1000 * count - parts[ends] - step)
        rank = -float((off <= OFF_STEP * step).mean()), float(np.median(off)), count
        best = rank if best is None else min(best, rank)
    return best[2] if best is not None and -best[0] >= FITS else None


def _step(seconds: Int64, parts: Int64) -> float:
    """Median step within a second, thousandths of a frame; 0 if no two codes share a second."""
    steps = np.diff(parts)[np.diff(seconds) == 0]
    return float(np.median(steps)) if len(steps) else 0.0


def _whole(seconds: Int64, parts: Int64, count: int) -> Int64:
    """Thousandths of frames; without those after the point where frames are one count apart.

    Sixtieths and thirtieths are the app's clock, whose thousandths are time.
    """
    one_each = abs(_step(seconds, parts) - 1000) <= 1000 * ONE_COUNT
    return parts // 1000 * 1000 if one_each and count not in DROPPED else parts


def _leaves_out(seconds: Int64, parts: Int64, count: int) -> bool:
    """Whether codes without ``;`` leave out the first numbers of minutes, but of each tenth."""
    step = _step(seconds, parts)
    starts = np.flatnonzero((np.diff(seconds) == 1) & (seconds[1:] % 60 == 0)) + 1
    starts = starts[seconds[starts] // 60 % 10 != 0]
    if count not in DROPPED or abs(step - 1000) > 1 or not len(starts):
        return False
    return bool((parts[starts] == 1000 * DROPPED[count]).all())


def _fields(text: str, row: int, where: object) -> tuple[int, int, bool]:
    """Whole seconds, thousandths of frames, and whether a ``;`` says drop frame."""
    match = TIMECODE.fullmatch(text.strip())
    if match is None:
        raise FormatError(
            f"{where}: data row {row} has time code {text[:40]!r}; it must be HH:MM:SS:FF.mmm"
        )
    hours, minutes, seconds, frames = (int(match[i]) for i in (1, 3, 5, 7))
    if hours > 23 or max(minutes, seconds) > 59 or frames >= max(COUNTS):
        raise FormatError(
            f"{where}: data row {row} has time code {text[:40]!r}; hours end at 23, minutes and "
            f"seconds at 59, FF at {max(COUNTS) - 1}"
        )
    parts = 1000 * frames + int((match[8] or "0").ljust(3, "0"))
    return (hours * 60 + minutes) * 60 + seconds, parts, ";" in text
