"""Where the eyes look: two numbers and the vergence, degrees.

- Fixations go from one eye of the listener to the other, and to the mouth (Yarbus 1967), 2 to 3 a
  second at most; five captured takes have 49 to 141 saccades a minute, of which a part is noise.
- A saccade lasts 21 ms and 2.2 ms a degree (Carpenter 1988): the main sequence.
- Speakers look away before and within long phrases and while they think, 1 s at a time (Argyle
  and Cook 1976; Andrist et al. 2014), listeners hardly.

Streams are side by side. Letters: B streams, n frames of a call, N events.
"""

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.postprocess.life.amounts import USUAL_CM
from deitalk.postprocess.life.blinks import Blinks
from deitalk.postprocess.life.draws import (
    Events,
    UInt64,
    between,
    by_rank,
    normals,
    smooth_noise,
    uniforms,
)
from deitalk.postprocess.life.voice import PAUSE, SPEECH, START, Cues
from rig.arrays import Float64, Int64

SIDE_DEGREES, UP_DEGREES, DOWN_DEGREES = 40.0, 30.0, 40.0
"""Turn of an eye for a control at 1 (`rig.conversion.arkit`)."""
SACCADE_SECONDS, SACCADE_SECONDS_PER_DEGREE = 0.021, 0.0022
HALF_EYES_CM = 3.15
"""Half of the distance of the eyes (Dodgson 2004: 63 mm)."""
EYE_DEGREES, MOUTH_DEGREES, MOUTH_SHARE = (1.5, 0.4), (0.0, -3.2), 0.22
"""Where fixations on the listener's eyes and mouth are, to a side and up, at the usual distance;
share of those on the mouth."""
FIXATION_SECONDS, FIXATION_JITTER = 0.8, 0.75
"""Mean time of a fixation, and the share of it by which a saccade is early or late."""
FIXATION_SPREAD = 0.45
"""Standard deviation of the place of a fixation, degrees."""
DRIFT_DEGREES, DRIFT_SECONDS = 0.12, 0.15
"""Of the slow motion within a fixation."""
AVERSION_DEGREES = (5.0, 12.0)
AVERSION_SECONDS = (0.9, 0.35, 0.4, 1.8)
"""Median, sigma of the logarithm, limits."""
AVERTED_CM = 200.0
"""Distance at which the eyes meet in an aversion."""
START_SHARE, PAUSE_SHARE, WITHIN_SHARE = 0.45, 0.6, 0.5
"""How often the gaze is averted before a phrase that follows a pause, in a pause, and within a
phrase at its every `WITHIN_EVERY` seconds."""
WITHIN_EVERY = 4
"""Seconds of speech from one place for an aversion within a phrase to the next (4.75 on the
average, Andrist et al. 2014)."""
START_LEAD, AVERTED_PAUSE = 0.35, 0.45
"""Seconds before a phrase, and of a pause, from which the gaze may be averted."""
LEAST_BETWEEN = 2.5
"""Seconds from the end of an aversion to the next one."""
BLINK_SHARE = 0.4
"""How often an aversion brings a blink."""
LID_SHARE = 0.55
"""Closure of the lids for a look straight down at the end of the range, besides the lids' own
following of the eyes in the rig (Becker and Fuchs 1988): where shapes of ARKit are exported nothing
else lowers them. Slopes of five Live Link takes are .50, .64, .76, 1.19 and, with squinted lids,
4.2."""
BEFORE = 1e-6
"""Seconds before a saccade at which the eyes are where they were."""


def vergence(distance: Float64 | float) -> Float64:
    """Degrees by which each eye turns inwards for a place at a distance, cm."""
    degrees: Float64 = np.degrees(np.arctan(HALF_EYES_CM / np.asarray(distance)))
    return degrees


def draw_directions(shares: Float64, avoids: Float64) -> Float64:
    """Degrees to the left and up (N, 2) of looks in thought, up or down and to a side.

    Of uniform numbers (N, 4) and the preference (N,) for the character's left, -1 to 1.
    """
    size, slope = between(shares[:, 0], AVERSION_DEGREES), between(shares[:, 1], (5, 50))
    elevation = np.radians(np.where(shares[:, 2] < 0.55, -slope, slope))
    sign = np.where(shares[:, 3] < 0.5 * (1 + avoids), 1, -1)
    return np.stack((sign * size * np.cos(elevation), size * np.sin(elevation)), axis=1)


class Gaze:
    """Fixations and aversions of streams.

    Parameters
    ----------
    keys : array of uint64 [shape=(B,)]
        Equal keys give equal looks.
    avoids : array [shape=(B,), range -1 to 1]
        Preference of the aversions for the character's left.
    """

    def __init__(self, keys: UInt64, avoids: Float64) -> None:
        self.keys, self.avoids = keys, avoids
        self.aversions = Events(4)
        """Begin and end, seconds; degrees to the left and up."""
        self.free = np.zeros(len(keys))
        """Seconds from which the next aversion may begin."""

    def reset(self, stream: int) -> None:
        """Begin a stream again."""
        self.aversions.clear(stream)
        self.free[stream] = 0

    def cue(self, cues: Cues, blinks: Blinks) -> None:
        """Avert the gaze before a phrase, in a pause and within a long phrase."""
        within = (cues.kind == SPEECH) & (cues.size % WITHIN_EVERY == 0)
        within &= np.isnan(cues.stop) | (cues.time < cues.stop - 0.5)
        pause = (cues.kind == PAUSE) & (cues.size == AVERTED_PAUSE) & (cues.time > 0)
        starts = cues.kind == START
        chance = np.select((starts, pause, within), (START_SHARE, PAUSE_SHARE, WITHIN_SHARE))
        shares = uniforms(self.keys[cues.stream], np.round(cues.time * FRAME_RATE), 7)
        begin = cues.time - START_LEAD * starts + 0.3 * shares[:, 0]
        begin = np.maximum(np.maximum(begin, 0.3), cues.known)
        median, sigma, low, high = AVERSION_SECONDS
        length = np.clip(median * np.exp(sigma * normals(shares[:, 1])), low, high)
        places = draw_directions(shares[:, 2:6], self.avoids[cues.stream])
        rows = np.concatenate((np.stack((begin, begin + length), axis=1), places), axis=1)
        drawn = np.flatnonzero(shares[:, 6] < chance)
        for rank in by_rank(cues.stream[drawn]):
            chosen = drawn[rank]
            chosen = chosen[begin[chosen] >= self.free[cues.stream[chosen]]]
            who = cues.stream[chosen]
            self.free[who] = rows[chosen, 1] + LEAST_BETWEEN
            self.aversions.append(who, rows[chosen])
            blinks.attract(cues.where(chosen), begin[chosen], (0.0, 0.0), chance=BLINK_SHARE)

    def play(self, streams: Int64, first: Int64, count: int, distance: Float64) -> Float64:
        """Degrees to the left and up, and vergence, in the next frames [shape=(B, n, 3)].

        Parameters
        ----------
        streams, first : array of int [shape=(B,)]
            Which streams, and their next frames.
        count : int
            n.
        distance : array [shape=(B, n)]
            Of the listener, cm.
        """
        times = (first[:, None] + np.arange(count)) / FRAME_RATE
        keys = self.keys[streams]
        begins = self._changes(keys, times)
        order = np.full(len(self.keys), -1)
        order[streams] = np.arange(len(streams))
        place = order[self.aversions.stream]
        rows = self.aversions.rows[place >= 0]
        place = place[place >= 0]
        # The last saccade at or before each frame, and where the eyes were before it.
        for edge in (0, 1):
            edges = np.broadcast_to(rows[:, edge, None], (len(rows), count))
            np.maximum.at(begins, place, np.where(edges <= times[place], edges, -np.inf))
        now, was = (
            self._targets(keys, when, rows, place, distance) for when in (times, begins - BEFORE)
        )
        steps = now - was
        size = np.hypot(steps[..., 0], steps[..., 1])
        lengths = SACCADE_SECONDS + SACCADE_SECONDS_PER_DEGREE * size
        left = np.clip(1 - (times - begins) / lengths, 0, 1)
        track: Float64 = now - (left * left * (3 - 2 * left))[..., None] * steps
        spread, seconds = np.full(2, DRIFT_DEGREES), np.full(2, DRIFT_SECONDS)
        track[..., :2] += smooth_noise(keys, times, spread, seconds)
        ends = self.aversions.rows[:, 1] * FRAME_RATE
        starts = first[order[self.aversions.stream]]
        gone = (order[self.aversions.stream] >= 0) & (ends < starts + count - FRAME_RATE)
        self.aversions.keep(~gone)
        return track

    def _fixations(self, keys: UInt64, times: Float64) -> Float64:
        """Number of the fixation at some times [shape=(B, n)]."""
        near = np.floor(times / FIXATION_SECONDS)
        late = [times >= self._begin(keys, near + k) for k in (0, 1)]
        found: Float64 = near - 1 + late[0] + late[1]
        return found

    def _begin(self, keys: UInt64, number: Float64) -> Float64:
        """Seconds at which fixations begin."""
        jitter = FIXATION_JITTER * uniforms(keys[:, None], number, 1)[..., 0]
        begin: Float64 = (number + jitter) * FIXATION_SECONDS
        return begin

    def _changes(self, keys: UInt64, times: Float64) -> Float64:
        """Seconds at which the fixations at some times began [shape=(B, n)]."""
        return self._begin(keys, self._fixations(keys, times))

    def _targets(
        self, keys: UInt64, times: Float64, rows: Float64, place: Int64, distance: Float64
    ) -> Float64:
        """Where the eyes are to be at some times [shape=(B, n, 3)]."""
        number = self._fixations(keys, times)
        shares = uniforms(keys[:, None], number, 4)
        near = USUAL_CM / distance
        # Even fixations are on one eye, odd ones on the other, some of both on the mouth.
        is_mouth = shares[..., 1] < MOUTH_SHARE
        side = np.where(number % 2 == 0, EYE_DEGREES[0], -EYE_DEGREES[0])
        found = np.stack(
            (
                np.where(is_mouth, MOUTH_DEGREES[0], side) * near,
                np.where(is_mouth, MOUTH_DEGREES[1], EYE_DEGREES[1]) * near,
                vergence(distance),
            ),
            axis=-1,
        )
        found[..., :2] += FIXATION_SPREAD * normals(shares[..., 2:])
        averted = (rows[:, 0, None] <= times[place]) & (times[place] < rows[:, 1, None])
        event, frame = np.nonzero(averted)
        found[place[event], frame, :2] = rows[event, 2:] + FIXATION_SPREAD * normals(
            shares[place[event], frame, 2:]
        )
        found[place[event], frame, 2] = vergence(AVERTED_CM)
        return found
