"""Voice activity and gates of voices that have not ended.

The causal form of `deitalk.audio.voice_activity.speech_activity` and of the gates in
`deitalk.postprocess.gates`: the noise floor is of the last 12 s, and a frame depends on
a few frames after it, in which the expression begins to rise before speech.

Streams are side by side, and the caller keeps their state. All functions take arrays or tensors.
Letters: B streams, n frames of a call, K frequency bands.
"""

from typing import NamedTuple

import numpy as np

from deitalk.array_functions import (
    Array,
    as_number,
    in_order,
    join,
    library,
    like,
    padded,
    percentile,
    replaced,
)
from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.held_sound import NEVER, NONE_DB
from deitalk.audio.voice_activity import (
    BAND_EDGES_HZ,
    FLOOR_PERCENTILE,
    FLOOR_SECONDS,
    KEEP_DB,
    LONGEST_CLOSURE,
    LONGEST_DROWNED,
    OPEN_DB,
    SHORT_FLOOR_DB,
    SPEECH_RANGE_DB,
    TOP_BANDS,
    audible,
    longest_gap,
    not_digital,
)
from deitalk.config.rules import Gates
from deitalk.postprocess.gates import expression_after, mouth_between

MOST_STEP = 1 / 6
"""Most by which the share of the expression changes in a frame: 0.2 s from none to all."""
FLOOR_EVERY = 10
"""Frames between two measurements of the noise floor."""
QUIET_ROWS = 5
"""Frames of a quiet room before the first one: until 1.5 s of sound they are the floor."""
FLOOR_FRAMES = round(FLOOR_SECONDS * FRAME_RATE)
LOUDEST_PERCENTILE, LOUD_PERCENTILE = 98.0, 95.0
"""Percentiles of the loudest band of each frame, and of the distance to the noise."""


class ActivityState(NamedTuple):
    """State of streams between two calls."""

    levels: Array
    """Band levels of the last frames, dB, the oldest first; `NONE_DB` where there are none yet
    [shape=(B, `FLOOR_FRAMES`, K)]."""
    excess: Array
    """How far they were above the noise, dB [shape=(B, `FLOOR_FRAMES`)]."""
    floor: Array
    """Noise in each band, dB [shape=(B, K)]."""
    gap: Array
    """Longest gap that is no pause, of the last frames and now [shape=(B, `ahead` + 1)]."""
    frames: Array
    """Frames since the floor was measured [shape=(B,)]."""
    on: Array
    """1 where one of the last frames is speech, else 0 [shape=(B, P)]."""
    silent: Array
    """Frames since the last speech, at the frame whose gates came last [shape=(B,)]."""
    share: Array
    """Share of the expression of that frame; below 0 before the first one [shape=(B,)]."""


class RunningActivity:
    """Activity and gates of streams.

    Parameters
    ----------
    gates : Gates or None
        Times of the gates; None: they stay open.
    ahead : int
        Frames after a frame that its gates depend on.
    """

    def __init__(self, gates: Gates | None, ahead: int) -> None:
        self.gates, self.ahead = gates, ahead
        self.past = LONGEST_DROWNED + ahead + 2 + (gates or Gates()).mouth_closes
        """P, frames before the last known one on which gates depend."""

    def first(self, batch: int) -> ActivityState:
        """State of streams before their first frame."""
        bands, quiet = len(BAND_EDGES_HZ) - 1, SHORT_FLOOR_DB - OPEN_DB
        gates = self.gates or Gates()
        settled = min(5 * gates.feeling_decays, gates.feeling_leaves)  # as after speech
        levels = np.full((batch, FLOOR_FRAMES, bands), NONE_DB)
        levels[:, -QUIET_ROWS:] = quiet
        return ActivityState(
            levels,
            np.full((batch, FLOOR_FRAMES), NONE_DB),
            np.full((batch, bands), quiet),
            np.full((batch, self.ahead + 1), float(LONGEST_CLOSURE)),
            np.zeros(batch),
            np.zeros((batch, self.past)),
            np.full(batch, float(settled)),
            np.full(batch, -1.0),
        )

    def __call__(
        self, levels: Array, held: Array, rest: Array, state: ActivityState
    ) -> tuple[Array, Array, Array, ActivityState]:
        """Find activity and gates of the next frames.

        Parameters
        ----------
        levels : array [shape=(B, n, K)]
            Level of each band, dB.
        held : array of bool [shape=(B, n)]
            Frames of a sound that a voice holds: speech, and no noise.
        rest : array [shape=(B,), range 0 to 1]
            Share of the expression that stays in silence.
        state : ActivityState
            From `first`, or from the call before.

        Returns
        -------
        speaking : array of bool [shape=(B, P + n)]
            Frames of speech; gaps are not bridged and clicks not left out. The last n are new.
        mouth, expression : array [shape=(B, n), range 0 to 1]
            Gate of the mouth and share of the expression, of the frames `ahead` before the new
            ones.
        state : ActivityState
        """
        xp, count = library(levels), levels.shape[1]
        rows = join((state.levels, xp.where(held[:, :, None], NONE_DB, levels)), 1)
        floor, above, frames, gap = state.floor, state.excess, state.frames, state.gap[:, -1]
        gaps, flags = [state.gap[:, :-1]], [state.on > 0]
        on = flags[0][:, -1]
        for k in range(count):
            excess = in_order(audible(levels[:, k]) - floor, axis=1)[:, -TOP_BANDS:].mean(1)
            on = held[:, k] | (excess >= KEEP_DB) & (on | (excess >= OPEN_DB))
            above = join((above[:, 1:], excess[:, None]), 1)
            gaps.append(gap[:, None])
            flags.append(on[:, None])
            is_due = frames + 1 >= FLOOR_EVERY
            frames = xp.where(is_due, 0.0, frames + 1)
            last = rows[:, k + 1 : k + 1 + FLOOR_FRAMES]
            floor, gap = replaced(is_due, (floor, gap), _measured_noise, last, above)
        speaking, known = join(flags, 1), join((*gaps, gap[:, None]), 1)
        after = ActivityState(
            rows[:, count:],
            above,
            floor,
            known[:, count:],
            frames,
            as_number(speaking[:, count:]),
            state.silent,
            state.share,
        )
        mouth, expression, after = self._gates(speaking, known[:, :count], rest, after)
        return speaking, mouth, expression, after

    def _gates(
        self, speaking: Array, gaps: Array, rest: Array, state: ActivityState
    ) -> tuple[Array, Array, ActivityState]:
        """Gates of the frames to which gaps (B, n) belong [shape=(B, n)]."""
        if self.gates is None:
            return 0 * gaps + 1, 0 * gaps + 1, state
        xp, silent, share = library(gaps), state.silent, state.share
        lags = like(np.arange(self.past + 1) - float(self.past - self.ahead), gaps)
        mouths, shares = [], []
        for k in range(gaps.shape[1]):
            # Frames since the last and until the next speech. A lone frame of it is a click.
            row = speaking[:, k : k + self.past + 1]
            pair = row[:, 1:] & row[:, :-1]
            paired = padded(pair.T, 1, 1).T
            paired = paired[:, 1:] | paired[:, :-1]
            since = xp.amin(xp.where(paired & (lags <= 0), -lags, NEVER), axis=1)
            until = xp.amin(xp.where(paired & (lags >= 0), lags, NEVER), axis=1)
            is_apart = since + until - 1 > gaps[:, k]
            since, until = since * is_apart, until * is_apart
            mouths.append(mouth_between(since, until, self.gates, self.ahead))
            # Speech may have ended before what is kept of it; speech that comes raises the share.
            silent = xp.clip(xp.minimum(since, 1 + silent), None, NEVER)
            wanted = expression_after(silent, until, rest, self.gates)
            wanted = xp.where(until < NEVER, 1.0, wanted)
            before = xp.where(share < 0, wanted, share)
            share = xp.clip(wanted, before - MOST_STEP, before + MOST_STEP)
            shares.append(share)
        mouth, expression = xp.stack(mouths, axis=1), xp.stack(shares, axis=1)
        return mouth, expression, state._replace(silent=silent, share=share)


def _measured_noise(levels: Array, excess: Array) -> tuple[Array, Array]:
    """Noise floor of each band (B, K), and the longest gap that is no pause (B,)."""
    xp, highest = library(levels), library(levels).amax(levels, axis=2)
    known = not_digital(levels, highest < NONE_DB, 1)
    loudest = percentile(xp.amax(audible(levels), axis=2), LOUDEST_PERCENTILE, known, 1)
    used = xp.broadcast_to(known[:, :, None], levels.shape)
    lowest = percentile(audible(levels), FLOOR_PERCENTILE, used, 1)
    floor = xp.maximum(lowest, loudest[:, None] - SPEECH_RANGE_DB)
    heard = not_digital(levels, excess < NONE_DB, 1)
    return floor, longest_gap(percentile(excess, LOUD_PERCENTILE, heard, 1))
