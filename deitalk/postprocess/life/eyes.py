"""The eyes after the network: blinks, and where they look."""

import math
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.config.rules import Idle
from deitalk.postprocess.life.voice import STILL_SECONDS, Cue
from rig.arrays import Float64

# Blinks: their times on the voice, and the closure of the lids.
#
# - Rate: 26 a minute in conversation and 17 at rest, intervals log-normal (Bentivoglio et al.
#   1997); 10.5 to 32.5 in conversation (95 % of adults, Doughty 2001). Six readers on video: 3 to
#   26.
# - Duration: 0.1 to 0.4 s in all, the reopening longer than the closing (Caffier et al. 2003;
#   Trutoiu et al. 2011). Six readers on video: 0.16 s at half the depth, 0.12 to 0.24.
# - Place: speakers blink at the ends of phrases and in pauses (Nakano and Kitazawa 2010), and with
#   large shifts of the gaze (Evinger et al. 1994).
# - Incomplete blinks are from a sixth (Abelson and Holly 1977) to half of all (Ousler et al. 2014).


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


SIDE_DEGREES, UP_DEGREES, DOWN_DEGREES = 40.0, 30.0, 40.0
"""Turn of an eye for a control at 1 (`rig.conversion.arkit`)."""
AVERSION_DEGREES = (5.0, 12.0)
AVERSION_SECONDS = (1.4, 0.4)
"""Median, and sigma of the logarithm."""
START_SHARE, PAUSE_SHARE = 0.45, 0.6
"""How often the gaze is averted before a phrase that follows a pause, and in a pause."""
WITHIN_SECONDS, WITHIN_SHARE = (4.75, 1.4), 0.6
"""Seconds of speech from one place for an aversion within a phrase to the next (mean and standard
deviation, Andrist et al. 2014; 3 at least), and how often the gaze is averted there."""
START_LEAD, AVERTED_PAUSE = 0.35, 0.45
"""Seconds before a phrase, and of a pause, from which the gaze may be averted."""
LEAST_BETWEEN = 3.0
"""Seconds from the end of an aversion to the next one."""
FACE_DEGREES = (0.9, 0.7)
"""Standard deviation of the fixations on the listener's face, to the side and up."""
FIXATION_SECONDS = (0.75, 0.45)
MICRO_DEGREES, MICRO_PER_SECOND = 0.25, 1.3
BLINK_DEGREES, BLINK_SHARE = 4.5, 0.4
"""A shift from so many degrees brings a blink, so often."""
LID_SHARE = 0.12
"""Closure of the lids for a look straight down at the end of the range, besides the lids' own
following of the eyes in the rig (Becker and Fuchs 1988)."""


def draw_wait(rng: np.random.Generator) -> float:
    """Seconds of speech to the next place for an aversion within a phrase."""
    mean, spread = WITHIN_SECONDS
    return float(max(mean + spread * rng.standard_normal(), 3.0))


def draw_direction(rng: np.random.Generator, avoids: float) -> tuple[float, float]:
    """Degrees to the left and up of a look up and to a side in thought, or down and to a side."""
    size = rng.uniform(*AVERSION_DEGREES)
    elevation = np.radians(rng.choice((-1.0, 1.0), p=(0.55, 0.45)) * rng.uniform(5, 50))
    sign = 1.0 if rng.random() < 0.5 * (1 + avoids) else -1.0
    return float(sign * size * np.cos(elevation)), float(size * np.sin(elevation))


class Gaze:
    """Fixations, aversions and micro-saccades of a take.

    Parameters
    ----------
    rng : numpy.random.Generator
        Equal generators give equal looks.
    avoids : float, range -1 to 1
        Preference for the character's left.
    end : float
        Seconds of the last frame; the last half second is still. Infinite if it is not known.
    """

    def __init__(
        self, rng: np.random.Generator, avoids: float = 0.0, end: float = math.inf
    ) -> None:
        self.cues, self.rng, self.small = rng.spawn(3)
        self.avoids, self.still = avoids, end - STILL_SECONDS
        self.looks = [Look(-1.0, np.zeros(2), np.zeros(2))]
        """Fixations from the last one before the next frame on."""
        self.micros = [(-1.0, np.zeros(2))]
        self.next_look = float(0.3 + self.rng.uniform(0, 0.4))
        self.next_micro = 10 / FRAME_RATE
        self.averted: tuple[float, Float64] | None = None
        """End of an aversion, and its direction."""
        self.free = self.within = 0.0
        self.shifts: list[float] = []
        """Times of large shifts that bring a blink."""

    def cue(self, cue: Cue) -> None:
        """Avert the gaze before a phrase, in a pause and within a long phrase."""
        if cue.kind == "start":
            self.within = cue.time + draw_wait(self.cues)
            self._avert(cue.time - START_LEAD, START_SHARE, cue.known)
        elif cue.kind == "pause" and cue.size == AVERTED_PAUSE and cue.time:
            self._avert(cue.time, PAUSE_SHARE, cue.known)
        elif cue.kind == "speech" and cue.time >= self.within:
            self.within = cue.time + draw_wait(self.cues)
            if cue.stop is None or cue.time < cue.stop - 0.5:
                self._avert(cue.time, WITHIN_SHARE, cue.known)

    def at(self, first: int, count: int) -> Float64:
        """Degrees to the character's left and up in the next frames [shape=(n, 2)]."""
        frames = np.arange(first, first + count) / FRAME_RATE
        if not count:
            return np.zeros((0, 2))
        last = float(frames[-1])
        self._look(last)
        while self.next_micro <= min(last, self.still - 0.1):
            place = 0.4 * self.micros[-1][1] + self.small.normal(0, MICRO_DEGREES, 2)
            self.micros.append((self.next_micro, place))
            self.next_micro += max(self.small.exponential(1 / MICRO_PER_SECOND), 0.15)
        if last > self.still - 0.1:
            zero, (_, before, _) = np.zeros(2), self.looks[-1]
            self.looks.append(Look(max(self.still - 0.1, self.looks[-1].time), zero, -before))
            self.micros.append((max(self.still - 0.1, self.micros[-1][0]), zero))
        times, targets, steps = (np.array(part) for part in zip(*self.looks, strict=True))
        now = np.searchsorted(times, frames, side="right") - 1
        lengths = 0.021 + 0.0022 * np.hypot(*steps[now].T)
        left = np.maximum(1 - (frames - times[now]) / lengths, 0)
        track: Float64 = targets[now] - (left * left * (3 - 2 * left))[:, None] * steps[now]
        moved, places = (np.array(part) for part in zip(*self.micros, strict=True))
        track = track + places[np.searchsorted(moved, frames, side="right") - 1]
        track[frames > self.still] = 0
        self.looks, self.micros = self.looks[now[-1] :], self.micros[-1:]
        return track

    def _avert(self, time: float, share: float, known: float) -> None:
        """Begin an aversion, so often."""
        start = max(time + self.cues.uniform(0, 0.3), 0.3, known)
        length = AVERSION_SECONDS[0] * np.exp(AVERSION_SECONDS[1] * self.cues.standard_normal())
        is_drawn, direction = self.cues.random() < share, draw_direction(self.cues, self.avoids)
        if is_drawn and start >= self.free and start + length < self.still:
            self._look(start)
            self.averted = float(start + length), np.array(direction)
            self.next_look = start
            self.free = start + length + LEAST_BETWEEN

    def _look(self, until: float) -> None:
        """Append the fixations that begin before a time."""
        while self.next_look <= min(until, self.still - 0.1):
            time, last = self.next_look, self.looks[-1]
            if self.averted is not None and time >= self.averted[0]:
                self.averted = None
            if self.averted is not None:
                target = self.averted[1] + self.rng.normal(0, 0.5, 2)
                self.next_look = min(time + self.rng.uniform(0.4, 1.1), self.averted[0])
            else:
                target = self.rng.normal(0, FACE_DEGREES)
                spread = FIXATION_SECONDS[1] * self.rng.standard_normal()
                self.next_look = time + max(FIXATION_SECONDS[0] * np.exp(spread), 0.3)
            step = target - last.target
            self.looks.append(Look(time, target, step))
            if np.hypot(*step) >= BLINK_DEGREES and self.rng.random() < BLINK_SHARE:
                self.shifts.append(time)


class Look(NamedTuple):
    """A fixation."""

    time: float
    """Seconds at which the eyes leave the one before."""
    target: Float64
    """Degrees to the left and up [shape=(2,)]."""
    step: Float64
    """From the one before."""
