"""Sounds that a voice holds: vowels of half a second and more, singing, hums.

A speech encoder attends to what changes: its features of a steady sound drift, and a mouth that
follows them shuts while the sound goes on. A sound is held where it is periodic and its spectrum
is that of a quarter of a second before; its pose is then that of `POSE` frames after its onset.

Streams are side by side, and their state is in the caller's hands. Letters: B streams, n frames of
a call, K frequency bands.
"""

from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import runs
from deitalk.config.rules import HoldPose
from rig.arrays import AnyFloat, Bool, Float32, Float64, Int64

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
NEVER = 1_000_000
"""Frames since a sound was held, where none was."""
EARLY = 3
"""Frames by which the sound is known before a frame whose pose is held."""
GOES_ON = 20
"""Longest gap of a sound that goes on, frames from its last held frame to the next."""
POSE = 4
"""Frames after the onset of a sound at which its pose is read."""


class Held(NamedTuple):
    """Where a pose is held [shape=(B, n)] each."""

    back: Int64
    """Frames since the pose that is held."""
    share: Float32
    """How much of it is shown, 0 to 1."""
    sounding: Bool
    """Whether a sound is held."""


class HeldState(NamedTuple):
    """What is kept of streams between two calls."""

    levels: Float64
    """Last levels, dB [shape=(B, BEFORE, K)]; infinite before the first frame."""
    age: Int64
    """Frames of steadiness [shape=(B,)]."""
    since: Int64
    """Frames since a sound was held, many before the first [shape=(B,)]."""
    back: Int64
    """Frames since the pose that was held last [shape=(B,)]."""
    share: Float64
    """How much of it was shown when the sound was held last [shape=(B,)]."""


def first_held(batch: int, n_bands: int) -> HeldState:
    """State of streams before their first frame."""
    age, since, back = np.zeros((3, batch), np.int64)  # no two of a stream share their memory
    levels = np.full((batch, BEFORE, n_bands), -np.inf)
    return HeldState(levels, age, since + NEVER, back, np.zeros(batch))


def follow_held(
    levels: AnyFloat, tones: AnyFloat, rule: HoldPose, state: HeldState
) -> tuple[Held, HeldState]:
    """Take the next frames.

    Parameters
    ----------
    levels : array [shape=(B, n, K)]
        Of frequency bands, dB: `deitalk.audio.voice_activity.window_levels`.
    tones : array [shape=(B, n)]
        From `deitalk.audio.prosody.tonality`; it matters where the levels are steady.
    rule : HoldPose
        Of the model.
    state : HeldState
        From `first_held`, or of the call before.

    Returns
    -------
    held : Held
        Of the frames `EARLY` before.
    state : HeldState
    """
    count = tones.shape[1]
    rows: Float64 = np.concatenate((state.levels, levels), axis=1)
    steady = (_change(rows, count) <= rule.steady_db) & (tones > PERIODIC)
    place = np.arange(count)
    age = place - _last(~steady, place, -1 - state.age)
    sounding = age >= rule.frames
    last = _last(sounding, place, -1 - state.since)
    since = place - last

    # Frame of the pose: of its own onset, or where a sound goes on, that of the one before.
    poses = np.repeat(-1 - state.back[:, None], count, axis=1)
    for stream, start in np.argwhere(sounding & (age == rule.frames)):
        ended = last[stream, start - 1] if start else -1 - state.since[stream]
        if start - ended > GOES_ON:
            poses[stream, start:] = start - rule.frames - (BEFORE - POSE - EARLY)
    back = place - poses
    risen = np.minimum((age - rule.frames + 1) / rule.leaves, 1)
    risen = np.take_along_axis(risen, np.maximum(last, 0), axis=1)
    risen = np.where(last >= 0, risen, state.share[:, None])
    share = risen * np.clip(1 - since / rule.leaves, 0, 1)
    found = Held(np.where(since <= GOES_ON, back, 0), share.astype(np.float32), sounding)
    return found, HeldState(rows[:, count:], age[:, -1], since[:, -1], back[:, -1], risen[:, -1])


def held_sound(levels: AnyFloat, tones: AnyFloat, rule: HoldPose) -> Held:
    """The same of a whole recording [each shape=(T,)], whose poses are held from their frames on.

    `sounding` is of the frames themselves.
    """
    rows = np.pad(levels, ((0, EARLY), (0, 0)), mode="edge")[None]
    found, _ = follow_held(
        rows, np.pad(tones, (0, EARLY))[None], rule, first_held(1, levels.shape[1])
    )
    back, share = found.back[0, EARLY:].copy(), found.share[0, EARLY:].copy()
    for start, stop in runs(back > 0):
        pose, top = max(start - int(back[start]), 0), start + int(share[start:stop].argmax())
        back[pose:start] = np.arange(start - pose)
        share[pose:top] = share[top]
    return Held(back, share, found.sounding[0, : len(levels)])


def steady_frames(levels: AnyFloat, rule: HoldPose) -> Bool:
    """Frames of a whole recording (T, K) that may be held, whatever their periodicity."""
    before = np.full((BEFORE, levels.shape[1]), -np.inf)
    found: Bool = _change(np.concatenate((before, levels))[None], len(levels))[0] <= rule.steady_db
    return found


def _change(rows: Float64, count: int) -> Float64:
    """Mean difference of smoothed bands from those `LAG` frames before, dB [shape=(B, n)]."""
    loudest = rows.max(axis=2, keepdims=True)
    with np.errstate(invalid="ignore"):
        shapes = np.where(np.isfinite(loudest), np.maximum(rows - loudest, -DEPTH_DB), np.inf)
        smooth = np.mean([shapes[:, k : k + count + LAG] for k in range(SMOOTHED)], axis=0)
        change = np.abs(smooth[:, LAG:] - smooth[:, :-LAG]).mean(axis=2)
    return np.where(np.isfinite(change), change, np.inf)


def _last(flags: Bool, place: Int64, before: Int64) -> Int64:
    """Place of the last flag until each frame [shape=(B, n)]; `before` (B,) where there is none."""
    found = np.where(flags, place, before[:, None])
    return np.maximum.accumulate(found, axis=1)
