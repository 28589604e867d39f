"""Sounds that a voice holds: vowels of half a second and more, singing, hums.

A speech encoder attends to what changes: its features of a steady sound drift, and a mouth that
follows them shuts while the sound goes on. A sound is held where it is periodic and its spectrum
is that of a quarter of a second before; its pose is then that of `POSE` frames after its onset.

Streams are side by side, and the caller keeps their state. All functions take arrays or tensors.
Letters: B streams, n frames of
a call, K frequency bands.
"""

from typing import NamedTuple

import numpy as np

from deitalk.array_functions import (
    FAR,
    Array,
    as_index,
    as_number,
    join,
    last_value,
    library,
    like,
    neighbours,
    padded,
    running_maximum,
    take_along,
)
from deitalk.config.rules import HoldPose

LAG = 8
"""Frames between the spectra that are compared (0.27 s)."""
SMOOTHED = 3
"""Frames whose levels are averaged, against vibrato and the phase of the pitch."""
BEFORE = LAG + SMOOTHED - 1
"""Frames of a sound before the first that can be steady."""
DEPTH_DB = 25.0
"""Bands weaker than the strongest by more are as if by this."""
PERIODIC = 0.5
"""Least tonality."""
NEVER = 1_000_000.0
"""Frames since a sound was held, where none was; the most that is counted."""
NONE_DB = 1e9
"""Level of frames that have not come."""
EARLY = 3
"""Frames of a whole recording by which a sound counts before those whose pose is held."""
POSE_FRAMES = 16
"""Most frames between a pose and the first in which a held sound keeps it."""
GOES_ON = 20
"""Longest gap of a sound that goes on, frames from its last held frame to the next."""
POSE = 4
"""Frames after the onset of a sound at which its pose is read."""


class Held(NamedTuple):
    """Frames in which a pose is held [shape=(B, n)] each."""

    back: Array
    """Frames since the pose that is held."""
    share: Array
    """How much of it is shown, 0 to 1."""
    sounding: Array
    """Whether a sound is held."""


class HeldState(NamedTuple):
    """State of streams between two calls."""

    levels: Array
    """Last levels, dB [shape=(B, BEFORE, K)]; `NONE_DB` before the first frame."""
    age: Array
    """Frames of steadiness [shape=(B,)]."""
    since: Array
    """Frames since a sound was held [shape=(B,)]."""
    back: Array
    """Frames since the pose that was held last [shape=(B,)]."""
    share: Array
    """How much of it was shown when the sound was held last [shape=(B,)]."""


def first_held(batch: int, n_bands: int) -> HeldState:
    """State of streams before their first frame."""
    levels, never = np.full((batch, BEFORE, n_bands), NONE_DB), np.full(batch, NEVER)
    return HeldState(levels, np.zeros(batch), never, never.copy(), np.zeros(batch))


def follow_held(
    levels: Array, tones: Array, rule: HoldPose, state: HeldState, early: int = EARLY
) -> tuple[Held, HeldState]:
    """Find held sounds in the next frames.

    Parameters
    ----------
    levels : array [shape=(B, n, K)]
        Of frequency bands, dB: `deitalk.audio.voice_activity.window_levels`.
    tones : array [shape=(B, n)]
        `deitalk.audio.prosody.Prosody.tone`; it matters where the levels are steady.
    rule : HoldPose
        Of the model.
    state : HeldState
        From `first_held`, or of the call before.
    early : int
        Frames of sound that are known after a frame whose pose is held.

    Returns
    -------
    held : Held
        Of the frames `early` before.
    state : HeldState
    """
    xp, count = library(levels), tones.shape[1]
    rows = join((state.levels, levels), 1)
    known, tonal = rows[:, :count, 0] < NONE_DB, tones > PERIODIC
    steady = known & (_change(rows) <= rule.steady_db) & tonal
    place = xp.arange(count) * 1.0
    age = place - last_value(~steady, place, -1 - state.age)
    sounding = age >= rule.frames
    last = last_value(sounding, place, -1 - state.since)
    since = place - last
    # Frame of the pose: of its own onset, or where a sound goes on, that of the one before.
    ended = join((-1 - state.since[:, None], last[:, :-1]), 1)
    is_onset = sounding & (age == rule.frames) & (place - ended > GOES_ON)
    onset = min(rule.frames + BEFORE - POSE - early, POSE_FRAMES)
    back = place - last_value(is_onset, place - onset, -1 - state.back)
    grown = xp.clip((age - rule.frames + 1) / rule.leaves, None, 1)
    grown = take_along(grown, as_index(xp.clip(last, 0, None)), 1)
    risen = xp.where(last >= 0, grown, state.share[:, None])
    share = risen * xp.clip(1 - since / rule.leaves, 0, 1)
    found = Held(xp.where(since <= GOES_ON, back, xp.zeros_like(back)), share, sounding)
    age, since, back = (xp.clip(part[:, -1], None, NEVER) for part in (age, since, back))
    return found, HeldState(rows[:, count:], age, since, back, risen[:, -1])


def held_sound(levels: Array, tones: Array, rule: HoldPose) -> Held:
    """Find held sounds of a whole recording [each shape=(T,)]; poses are held from their frames on.

    `sounding` is of the frames themselves.
    """
    xp, total, n_bands = library(levels), levels.shape[0], int(levels.shape[1])
    rows = join((levels, xp.broadcast_to(levels[-1:], (EARLY, n_bands))))[None]
    first = HeldState(*(like(part, levels) for part in first_held(1, n_bands)))
    found, _ = follow_held(rows, padded(tones, 0, EARLY)[None], rule, first)
    back, share = found.back[0, EARLY:], found.share[0, EARLY:]
    # From its own frame on a pose has the most that its sound shows, until that is reached. Shares
    # are whole multiples of 1 / leaves^2, and the sounds get ranges of their own, one after the
    # other, so that a running maximum is one of each sound.
    is_on, frames = back > 0, xp.arange(total)
    starts = is_on & ~padded(is_on, 1, 0)[:-1]
    whole = as_index(xp.round(share * rule.leaves**2))
    number = as_index(starts).cumsum(0) * (rule.leaves**2 + 1)
    rising = running_maximum(xp.where(is_on, whole + number, 0)[None])[0] - number
    falling = xp.where(is_on, whole - number, -number - 1)
    falling = xp.flip(running_maximum(xp.flip(falling, (0,))[None])[0], (0,)) + number
    most = xp.maximum(rising, falling)
    top = as_number(is_on) * most / rule.leaves**2
    share = xp.where(is_on & (rising < most), top, share)
    start = neighbours(starts)[1]
    place = xp.clip(start, None, total - 1)
    pose = xp.clip(place - as_index(back)[place], 0, None)
    is_before = (start < FAR) & (frames >= pose) & (frames < start)
    back = xp.where(is_before, frames - pose, back)
    return Held(back, xp.where(is_before, top[place], share), found.sounding[0, :total])


def steady_frames(levels: Array, rule: HoldPose) -> Array:
    """Frames of a whole recording (T, K) that may be held, whatever their periodicity."""
    change = _change(padded(levels, BEFORE, 0)[None])[0]
    return (change <= rule.steady_db) & (library(levels).arange(levels.shape[0]) >= BEFORE)


def _change(rows: Array) -> Array:
    """Mean difference of smoothed bands from those `LAG` frames before, dB.

    Rows (B, BEFORE + n, K); the result is (B, n).
    """
    xp = library(rows)
    shapes = xp.clip(rows - xp.amax(rows, axis=2, keepdims=True), -DEPTH_DB, None)
    length = rows.shape[1] - SMOOTHED + 1
    smooth = sum(shapes[:, k : k + length] for k in range(SMOOTHED)) / SMOOTHED
    return xp.abs(smooth[:, LAG:] - smooth[:, :-LAG]).mean(2)
