"""The eyes after the network: blinks, and where they look.

Streams are side by side. Letters: B streams, n frames of a call, N events.
"""

import math

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.postprocess.life.amounts import USUAL_CM
from deitalk.postprocess.life.draws import (
    Events,
    UInt64,
    between,
    by_rank,
    normals,
    smooth_noise,
    uniforms,
)
from deitalk.postprocess.life.voice import END, PAUSE, SPEECH, START, Cues
from rig.arrays import Float64, Int64

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
CLOSING, OPENING = (0.085, 0.15, 0.06, 0.12), (0.19, 0.2, 0.12, 0.3)
"""Seconds to the deepest point and back: median, sigma of the logarithm, limits."""
MOST_HELD = 0.06
"""Seconds at the deepest point; a frame at least, so that one shows it."""
BEGIN, CLOSES, HOLDS, OPENS, DEPTH, UNEVEN = range(6)
"""Fields of a blink: seconds at which the lids begin to close, of the three parts of the motion,
closure at the deepest point, 0 to 1, and the difference of the lids."""


def closure(blinks: Float64, times: Float64) -> Float64:
    """Closure of the lids (N, n) by blinks (N, 6) at times (N, n): fast down, slower up."""
    begin, closes, holds, opens, depth = (blinks[:, k, None] for k in range(UNEVEN))
    since = times - begin
    down = np.clip(since / closes, 0, 1)
    up = np.clip((since - closes - holds) / opens, 0, 1)
    shape: Float64 = depth * np.sin(0.5 * np.pi * down) ** 2 * (1 - up) ** 1.6
    return shape


def blink_ends(blinks: Float64) -> Float64:
    """Seconds at which the lids are open."""
    ends: Float64 = blinks[:, BEGIN:DEPTH].sum(axis=1)
    return ends


def draw_blinks(times: Float64, shares: Float64) -> Float64:
    """Blinks (N, 6) that begin at times (N,), of uniform numbers (N, 6)."""
    is_full = shares[:, 0] >= INCOMPLETE_SHARE
    parts = []
    for (median, sigma, low, high), share in zip((CLOSING, OPENING), shares.T[1:3], strict=True):
        parts.append(np.clip(median * np.exp(sigma * normals(share)), low, high))
    held = np.where(is_full, between(shares[:, 3], (1 / FRAME_RATE, MOST_HELD)), 0)
    depth = np.where(is_full, 1, between(shares[:, 4], INCOMPLETE_DEPTH))
    uneven = np.where(is_full, 0, SIDE_SPREAD * normals(shares[:, 5]))
    rows: Float64 = np.stack((times, parts[0], held, parts[1], depth, uneven), axis=1)
    return rows


class Blinks:
    """Blinks of streams, one after another.

    Parameters
    ----------
    keys : array of uint64 [shape=(B,)]
        Equal keys give equal blinks, whatever the emotion.
    seconds, spread : array [shape=(B,)]
        Median and sigma of the logarithm of the intervals.
    end : float or array [shape=(B,)]
        Seconds of the last frame, in which the lids are open; infinite if it is not known.
    """

    def __init__(
        self, keys: UInt64, seconds: Float64, spread: Float64, end: float | Float64 = math.inf
    ) -> None:
        self.keys, self.seconds, self.spread = keys, seconds, spread
        self.end = np.broadcast_to(end, keys.shape)
        self.blinks, self.places = Events(6), Events(2)
        """Those that are not over; times that draw blinks, and from when they are known."""
        self.number = np.zeros(len(keys), np.int64)
        """Blinks that were drawn."""
        self.earliest = np.full(len(keys), FIRST_SECONDS[0])
        self.next = between(uniforms(keys, self.number, 1)[:, 0], FIRST_SECONDS)

    def reset(self, stream: int) -> None:
        """Begin a stream again."""
        self.blinks.clear(stream)
        self.places.clear(stream)
        self.number[stream], self.earliest[stream] = 0, FIRST_SECONDS[0]
        share = uniforms(self.keys[stream : stream + 1], self.number[stream : stream + 1], 1)
        self.next[stream] = between(share[0, 0], FIRST_SECONDS)

    def cue(self, cues: Cues) -> None:
        """A blink is likely at ends of phrases, and within long pauses."""
        ends = cues.where(cues.kind == END)
        self.attract(ends, ends.time, PHRASE_END_SECONDS)
        pauses = cues.where((cues.kind == PAUSE) & (cues.size == LONG_PAUSE))
        unknown = ~np.isfinite(pauses.stop)
        stop = np.where(unknown, pauses.time + UNKNOWN_PAUSE, pauses.stop)
        self.attract(pauses, pauses.time, (0.0, 1.0), np.maximum(stop - pauses.time, 0))

    def attract(
        self,
        cues: Cues,
        times: Float64,
        span: tuple[float, float],
        scale: Float64 | float = 1.0,
        chance: float = 1.0,
    ) -> None:
        """Draw blinks that are near to some times, plus a span of seconds, so often."""
        frames = np.round(times * FRAME_RATE)
        shares = uniforms(self.keys[cues.stream], frames, 8)[:, 6:]
        place = np.maximum(times + scale * between(shares[:, 0], span), cues.known)
        rows = np.stack((place, cues.known), axis=1)
        taken = shares[:, 1] < chance
        self.places.append(cues.stream[taken], rows[taken])

    def play(self, streams: Int64, first: Int64, count: int) -> Float64:
        """Closure of the left and the right lids in the next frames [shape=(B, n, 2)]."""
        self._draw(streams, (first + count) / FRAME_RATE)
        order = np.full(len(self.keys), -1)
        order[streams] = np.arange(len(streams))
        place, rows = order[self.blinks.stream], self.blinks.rows
        times = (first[:, None] + np.arange(count)) / FRAME_RATE
        shapes = closure(rows, times[place])[..., None]
        sides = 1 + rows[:, None, UNEVEN:] * np.array([1, -1])
        track = np.zeros((len(streams), count, 2))
        moved = place >= 0
        np.maximum.at(track, place[moved], (shapes * sides)[moved])
        stops = first[place] + count
        self.blinks.keep(~moved | (blink_ends(rows) * FRAME_RATE + 2 > stops))
        return track.clip(0, 1)

    def _draw(self, streams: Int64, until: Float64) -> None:
        """Draw all blinks of some streams that begin before a time (B,)."""
        while True:
            # The earliest place near the planned time that was known by then and is not too early.
            planned, earliest = self.next[streams], self.earliest[streams]
            shares = uniforms(self.keys[streams], self.number[streams] + (1 << 40), 16)
            place, known = self.places.rows.T
            near = (self.places.stream == streams[:, None]) & (known <= planned[:, None])
            near &= (place > earliest[:, None]) & (shares[:, :1] < DRAWN_SHARE)
            near &= np.abs(place - planned[:, None]) < DRAWN_SECONDS
            times = np.where(near, place, np.inf).min(axis=1, initial=np.inf)
            times = np.where(np.isfinite(times), times, planned)
            due = times < until
            if not due.any():
                break
            who, times, shares = streams[due], times[due], shares[due]
            # One blink, or two; then an interval.
            blinks = draw_blinks(times, shares[:, 1:7])
            self._add(who, blinks)
            double = shares[:, 7] < DOUBLE_SHARE
            seconds = times + between(shares[:, 8], DOUBLE_SECONDS)
            after = np.maximum(blink_ends(blinks), seconds)
            second = draw_blinks(after, shares[:, 9:15])
            self._add(who[double], second[double])
            over = np.where(double, blink_ends(second), blink_ends(blinks))
            self.earliest[who] = over + LEAST_INTERVAL / 2
            spread = self.spread[who] * normals(shares[:, 15])
            interval = self.seconds[who] * np.exp(spread)
            self.next[who] = times + np.maximum(interval, LEAST_INTERVAL)
            self.number[who] += 1
        if self.places.stream.size:
            self.places.keep(self.places.rows[:, 0] > self.earliest[self.places.stream])

    def _add(self, streams: Int64, blinks: Float64) -> None:
        whole = blink_ends(blinks) < self.end[streams]
        self.blinks.append(streams[whole], blinks[whole])


# Where the eyes look: two numbers and the vergence, degrees.
#
# - Fixations go from one eye of the listener to the other, and to the mouth (Yarbus 1967), 2 to 3 a
#   second at most; five captured takes have 49 to 141 saccades a minute, of which a part is noise.
# - A saccade lasts 21 ms and 2.2 ms a degree (Carpenter 1988): the main sequence.
# - Speakers look away before and within long phrases and while they think, 1 s at a time (Argyle
#   and Cook 1976; Andrist et al. 2014), listeners hardly.


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
