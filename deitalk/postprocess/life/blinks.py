"""Blinks: their times on the voice, and the closure of the lids.

- Rate: 26 a minute in conversation and 17 at rest, intervals log-normal (Bentivoglio et al.
  1997); 10.5 to 32.5 in conversation (95 % of adults, Doughty 2001). Six readers on video: 3 to
  26.
- Duration: 0.1 to 0.4 s in all, the reopening longer than the closing (Caffier et al. 2003;
  Trutoiu et al. 2011). Six readers on video: 0.16 s at half the depth, 0.12 to 0.24.
- Place: speakers blink at the ends of phrases and in pauses (Nakano and Kitazawa 2010), and with
  large shifts of the gaze (Evinger et al. 1994).
- Incomplete blinks are from a sixth (Abelson and Holly 1977) to half of all (Ousler et al. 2014).

Streams are side by side. Letters: B streams, n frames of a call, N events.
"""

import math

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.postprocess.life.draws import Events, UInt64, between, normals, uniforms
from deitalk.postprocess.life.voice import END, PAUSE, Cues
from rig.arrays import Float64, Int64

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
