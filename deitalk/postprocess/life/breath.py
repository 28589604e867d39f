"""Breath drawn through the mouth before a phrase.

Half a second before their first word people open their lips and shut them again: readers on video
by .03 to .23 of the mouth's width, .07 on the average, at the place of `LEAD`. It needs to be known
that a phrase comes, and how it begins: a voice that has not ended has none.

Letters: T frames at 30 per second.
"""

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.postprocess.control_groups import ControlGroups
from deitalk.postprocess.life.draws import uniforms
from deitalk.postprocess.life.voice import Voice
from rig import ControlSet
from rig.arrays import Float32, Float64

PER_WIDTH = 1.75
"""Jaw by which the lips of the embedded head part by the width of the mouth."""
HEIGHTS = (0.05, 0.12)
"""Least and most opening, shares of that width."""
LEAD, FALL = 0.37, 0.25
"""Seconds from the widest opening to the phrase, whose first sound is measured a little late, and
down from it."""
RISES = (0.1, 0.2)
"""Seconds up to it: the shortest, in a short pause, and the longest."""
SHUT, BEGINS = 0.3, 6
"""Contact of lips that shut, and the frames around the start of a phrase in which they do where it
begins with p, b or m: no breath precedes them."""
DRAWS = 1 << 41
"""Place of the first of its random numbers, beside those of the head."""


def draw_breaths(
    controls: ControlSet, neutral: Float32, shown: Float32, voice: Voice, key: int, gain: Float32
) -> None:
    """Open the mouth of finished curves [shape=(T, C)] before phrases, in place.

    Parameters
    ----------
    controls : ControlSet
        Nothing is drawn where it has no jaw and lips.
    neutral, shown : array [shape=(T, C)]
        Both readings; the neutral one tells how phrases begin.
    voice, key
        As for `breath_jaw`.
    gain : array [shape=(C,)]
        Factor of each control.
    """
    groups = ControlGroups(controls)
    if not (len(groups.lips) and len(groups.together)):
        return
    jaw = groups.lips[0]
    added = gain[jaw] * breath_jaw(voice, neutral[:, groups.together].mean(axis=1), key)
    for curves in (neutral, shown):
        curves[:, jaw] = np.minimum(curves[:, jaw] + added, controls.maximum[jaw])


def breath_jaw(voice: Voice, together: Float32, key: int) -> Float64:
    """Jaw that breaths add [shape=(T,), range 0 to .21].

    Parameters
    ----------
    voice : Voice
        T frames.
    together : array [shape=(T,), range 0 to 1]
        Contact of the lips.
    key : int
        Of the random numbers.
    """
    jaw = np.zeros(voice.n_frames)
    times = np.arange(voice.n_frames) / FRAME_RATE
    for start, stop in voice.pauses(LEAD + RISES[0]):
        first = together[max(stop - BEGINS, 0) : stop + BEGINS + 1]
        if stop < voice.n_frames and first.max() < SHUT:
            share = uniforms(np.array([key], np.uint64), np.array([DRAWS + stop]), 1)[0, 0]
            rise = min((stop - start) / FRAME_RATE - LEAD, RISES[1])
            late = times - stop / FRAME_RATE + LEAD
            part = np.clip(1 - np.abs(late) / np.where(late < 0, rise, FALL), 0, 1)
            height = HEIGHTS[0] + share * (HEIGHTS[1] - HEIGHTS[0])
            jaw += PER_WIDTH * height * part * part * (3 - 2 * part)
    return jaw
