"""Blinks: their times on the voice, and the closure of the lids.

- Rate: 26 a minute in conversation and 17 at rest, intervals log-normal (Bentivoglio et al. 1997);
  10.5 to 32.5 in conversation (95 % of adults, Doughty 2001). Six readers on video: 3 to 26.
- Duration: 0.1 to 0.4 s in all, the reopening longer than the closing (Caffier et al. 2003;
  Trutoiu et al. 2011). Six readers on video: 0.16 s at half the depth, 0.12 to 0.24.
- Place: speakers blink at the ends of phrases and in pauses (Nakano and Kitazawa 2010), and with
  large shifts of the gaze (Evinger et al. 1994).
- Incomplete blinks are from a sixth (Abelson and Holly 1977) to half of all (Ousler et al. 2014).
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.config import Idle
from deitalk.postprocess.life.tracks import STILL_SECONDS
from deitalk.postprocess.life.voice import Voice
from rig.arrays import Float32, Float64

LEAST_INTERVAL = 0.6
"""Seconds from blink to blink, but for double ones."""
FIRST_SECONDS = (0.2, 3.0)
"""The first blink comes so long after the start of a take."""
DRAWN_SECONDS, DRAWN_SHARE = 1.2, 0.85
"""A blink moves to an end of a phrase, a pause or a gaze shift that is as near, so often."""
PHRASE_END_SECONDS = (-0.05, 0.25)
"""Place of a blink relative to the end of a phrase."""
INCOMPLETE_SHARE, INCOMPLETE_DEPTH = 0.17, (0.45, 0.85)
DOUBLE_SHARE, DOUBLE_SECONDS = 0.06, (0.32, 0.45)
SIDE_SPREAD = 0.02
"""Standard deviation of the difference of the lids in an incomplete blink."""


class Blink(NamedTuple):
    """One blink."""

    time: float
    """Seconds at which the lids begin to close."""
    closing: float
    """Seconds to the deepest point."""
    held: float
    """Seconds there; a frame at least, so that one shows it."""
    opening: float
    """Seconds until the lids are open."""
    depth: float
    """Closure at the deepest point, 0 to 1."""

    @property
    def end(self) -> float:
        """Seconds at which the lids are open."""
        return self.time + self.closing + self.held + self.opening

    def closure(self, times: Float64) -> Float64:
        """Closure of the lids at some times: fast down, slower and slowing up."""
        since = times - self.time
        down = np.clip(since / self.closing, 0, 1)
        up = np.clip((since - self.closing - self.held) / self.opening, 0, 1)
        shape: Float64 = self.depth * np.sin(0.5 * np.pi * down) ** 2 * (1 - up) ** 1.6
        return shape


def plan_blinks(
    voice: Voice,
    rng: np.random.Generator,
    idle: Idle = Idle(),
    shifts: Sequence[float] = (),
    factor: float = 1.0,
) -> list[Blink]:
    """Draw the blinks of a take.

    Parameters
    ----------
    voice : Voice
        Phrases of the recording.
    rng : numpy.random.Generator
        Equal generators give equal blinks, whatever the emotion.
    idle : Idle
        Median and spread of the intervals.
    shifts : sequence of float
        Times of large shifts of the gaze, seconds.
    factor : float
        On the intervals.
    """
    places = np.sort([*_openings(voice, rng), *shifts])
    end = voice.n_frames / FRAME_RATE - STILL_SECONDS
    blinks: list[Blink] = []
    time = rng.uniform(*FIRST_SECONDS)
    while time < end:
        earliest = blinks[-1].end + LEAST_INTERVAL / 2 if blinks else FIRST_SECONDS[0]
        near = places[(places > earliest) & (np.abs(places - time) < DRAWN_SECONDS)]
        if len(near) and rng.random() < DRAWN_SHARE:
            time = float(near[np.abs(near - time).argmin()])
        is_double = rng.random() < DOUBLE_SHARE
        for start in (time, time + rng.uniform(*DOUBLE_SECONDS)):
            blink = draw_blink(max(start, blinks[-1].end if blinks else 0.0), rng)
            if blink.end < end:
                blinks.append(blink)
            if not is_double:
                break
        interval = idle.interval_seconds * np.exp(idle.interval_spread * rng.standard_normal())
        time += max(interval * factor, LEAST_INTERVAL)
    return blinks


def _openings(voice: Voice, rng: np.random.Generator) -> Iterator[float]:
    """Times at which a blink is likely: ends of phrases, and within long pauses."""
    for phrase in voice.phrases:
        yield phrase.stop / FRAME_RATE + rng.uniform(*PHRASE_END_SECONDS)
    for start, stop in voice.pauses(0.8):
        yield rng.uniform(start, stop) / FRAME_RATE


def draw_blink(time: float, rng: np.random.Generator) -> Blink:
    """Draw the shape of a blink that begins at a time, seconds."""
    is_full = rng.random() >= INCOMPLETE_SHARE
    depth = 1.0 if is_full else float(rng.uniform(*INCOMPLETE_DEPTH))
    closing = float(np.clip(0.085 * np.exp(0.15 * rng.standard_normal()), 0.06, 0.12))
    opening = float(np.clip(0.19 * np.exp(0.2 * rng.standard_normal()), 0.12, 0.3))
    held = float(rng.uniform(1 / FRAME_RATE, 0.06)) if is_full else 0.0
    return Blink(time, closing, held, opening, depth)


def lid_closure(blinks: Sequence[Blink], n_frames: int, rng: np.random.Generator) -> Float32:
    """Closure of the left and the right lids [shape=(T, 2), range 0 to 1]."""
    track = np.zeros((n_frames, 2))
    for blink in blinks:
        first, last = int(blink.time * FRAME_RATE), int(blink.end * FRAME_RATE) + 2
        times = np.arange(first, min(last, n_frames)) / FRAME_RATE
        uneven = SIDE_SPREAD * rng.standard_normal() if blink.depth < 1 else 0.0
        for side, sign in enumerate((1, -1)):
            shape = blink.closure(times) * (1 + sign * uneven)
            track[first:last, side] = np.maximum(track[first:last, side], shape)
    return track.astype(np.float32)
