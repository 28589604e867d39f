"""Gaze: fixations on a listener with micro-saccades, and aversions in thought.

- Speakers look away at the start of an utterance and in hesitations, and look back at its end
  (Kendon 1967); they think with the eyes averted (Glenberg et al. 1998; Doherty-Sneddon and Phelps
  2005). Aversions while speaking last about 2 s and come every 5 s (Andrist et al. 2014), some of
  them within long phrases; they are 5 to 12 degrees here, what a listener at a metre and a half
  sees as a look away, not a turn.
- A saccade of a degree a takes 2.2 a + 21 ms (Carpenter 1988): one or two frames.
- Micro-saccades of up to a degree, one or two a second (Rolfs 2009; Martinez-Conde et al. 2004);
  fixations of the listener's face last a third of a second to two.
- The eyes turn against the head, so that the gaze holds its target (vestibulo-ocular reflex).

Angles are degrees: to the character's left, and up. Letters: T frames at 30 per second.
"""

import math
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.postprocess.life.tracks import STILL_SECONDS
from deitalk.postprocess.life.voice import Cue
from rig.arrays import Float32, Float64

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


def as_controls(degrees: Float32 | Float64) -> Float32:
    """Values of the controls ``eye.tx`` and ``eye.ty`` for degrees; both [shape=(T, 2)]."""
    side = degrees[:, 0] / SIDE_DEGREES
    up = degrees[:, 1] / np.where(degrees[:, 1] > 0, UP_DEGREES, DOWN_DEGREES)
    return np.stack([side, up], axis=1).astype(np.float32)
