"""Blinks: their times on the voice, and the closure of the lids.

- Rate: 26 a minute in conversation and 17 at rest, intervals log-normal (Bentivoglio et al. 1997);
  10.5 to 32.5 in conversation (95 % of adults, Doughty 2001). Six readers on video: 3 to 26.
- Duration: 0.1 to 0.4 s in all, the reopening longer than the closing (Caffier et al. 2003;
  Trutoiu et al. 2011). Six readers on video: 0.16 s at half the depth, 0.12 to 0.24.
- Place: speakers blink at the ends of phrases and in pauses (Nakano and Kitazawa 2010), and with
  large shifts of the gaze (Evinger et al. 1994).
- Incomplete blinks are from a sixth (Abelson and Holly 1977) to half of all (Ousler et al. 2014).
"""

import math
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.config.rules import Idle
from deitalk.postprocess.life.voice import Cue
from rig.arrays import Float64

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
LONG_PAUSE, UNKNOWN_PAUSE = 0.8, 1.6
"""Seconds of a pause in which a blink is likely, and of one whose end is not known."""
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


def draw_blink(time: float, rng: np.random.Generator) -> Blink:
    """Draw the shape of a blink that begins at a time, seconds."""
    is_full = rng.random() >= INCOMPLETE_SHARE
    depth = 1.0 if is_full else float(rng.uniform(*INCOMPLETE_DEPTH))
    closing = float(np.clip(0.085 * np.exp(0.15 * rng.standard_normal()), 0.06, 0.12))
    opening = float(np.clip(0.19 * np.exp(0.2 * rng.standard_normal()), 0.12, 0.3))
    held = float(rng.uniform(1 / FRAME_RATE, 0.06)) if is_full else 0.0
    return Blink(time, closing, held, opening, depth)


class Blinks:
    """Blinks of a take, one after another.

    Parameters
    ----------
    rng : numpy.random.Generator
        Equal generators give equal blinks, whatever the emotion.
    idle : Idle
        Median and spread of the intervals.
    factor : float
        On the intervals.
    end : float
        Seconds at which the lids are to be still; infinite if the take has not ended.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        idle: Idle = Idle(),
        factor: float = 1.0,
        end: float = math.inf,
    ) -> None:
        self.rng, self.idle, self.factor, self.end = rng, idle, factor, end
        self.cues = rng.spawn(1)[0]
        self.blinks: list[tuple[Blink, float]] = []
        """Those that are not over, and the difference of the lids in them."""
        self.over, self.earliest = 0.0, FIRST_SECONDS[0]
        self.places: list[float] = []
        self._plan(rng.uniform(*FIRST_SECONDS))

    def cue(self, cue: Cue) -> None:
        """A blink is likely at ends of phrases, and within long pauses."""
        if cue.kind == "end":
            self.draw_to(cue.time + self.cues.uniform(*PHRASE_END_SECONDS), cue.known)
        elif cue.kind == "pause" and cue.size == LONG_PAUSE:
            stop = self.end if cue.stop is None else min(cue.stop, self.end)
            latest = min(stop, cue.time + UNKNOWN_PAUSE) if math.isinf(stop) else stop
            self.draw_to(self.cues.uniform(cue.time, max(latest, cue.time)), cue.known)

    def draw_to(self, place: float, known: float = -math.inf) -> None:
        """Draw the blink that is near to a place, seconds, from when that is known."""
        self.draw_until(known)
        self.places.append(max(place, known))

    def at(self, first: int, count: int) -> Float64:
        """Closure of the left and the right lids in the next frames [shape=(n, 2)]."""
        stop = first + count
        self.draw_until(stop / FRAME_RATE)
        track = np.zeros((count, 2))
        for blink, uneven in self.blinks:
            begin = max(int(blink.time * FRAME_RATE), first)
            end = min(int(blink.end * FRAME_RATE) + 2, stop)
            if begin < end:
                shape = blink.closure(np.arange(begin, end) / FRAME_RATE)[:, None]
                rows = track[begin - first : end - first]
                np.maximum(rows, shape * (1 + uneven * np.array([1, -1])), out=rows)
        self.blinks = [row for row in self.blinks if row[0].end * FRAME_RATE + 2 > stop]
        return track.clip(0, 1)

    def _plan(self, time: float) -> None:
        self.time, self.is_drawn = time, self.rng.random() < DRAWN_SHARE

    def draw_until(self, until: float) -> None:
        """Draw all blinks that begin before a time."""
        while True:
            near = [p for p in self.places if p > self.earliest]
            near = [p for p in near if abs(p - self.time) < DRAWN_SECONDS]
            time = self.time
            if near and self.is_drawn:
                time = min(near, key=lambda place: abs(place - self.time))
            if time >= min(until, self.end):
                return
            starts = [time, time + self.rng.uniform(*DOUBLE_SECONDS)]
            for start in starts if self.rng.random() < DOUBLE_SHARE else starts[:1]:
                blink = draw_blink(max(start, self.over), self.rng)
                uneven = SIDE_SPREAD * self.rng.standard_normal() if blink.depth < 1 else 0.0
                if blink.end < self.end:
                    self.blinks.append((blink, uneven))
                    self.over = blink.end
            self.earliest = self.over + LEAST_INTERVAL / 2
            spread = self.idle.interval_spread * self.rng.standard_normal()
            interval = self.idle.interval_seconds * np.exp(spread) * self.factor
            self.places = [place for place in self.places if place > time]
            self._plan(time + max(float(interval), LEAST_INTERVAL))
