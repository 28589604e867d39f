"""Voice activity and gates of voices that have not ended.

The causal form of `deitalk.audio.voice_activity.speech_activity` and of the gates in
`deitalk.postprocess.feeling`: the noise floor is of the last 12 s, and a frame depends on
`GATE_AHEAD` frames after it, in which the expression begins to rise before speech.

Streams are side by side, and their state is in the caller's hands. Letters: B streams, n frames of
a call, K frequency bands.
"""

from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.voice_activity import (
    BAND_EDGES_HZ,
    CLEAN_DB,
    FLOOR_PERCENTILE,
    FLOOR_SECONDS,
    KEEP_DB,
    LONGEST_CLOSURE,
    LONGEST_DROWNED,
    NOISY_DB,
    OPEN_DB,
    SHORT_FLOOR_DB,
    SPEECH_RANGE_DB,
    TOP_BANDS,
)
from deitalk.config.rules import Gates
from deitalk.postprocess.feeling import expression_after, mouth_between
from rig.arrays import Bool, Float32, Float64, Int64

GATE_AHEAD = 5
"""Frames after a frame that its gates depend on (0.17 s)."""
MOST_STEP = 1 / 6
"""Most by which the share of the expression changes in a frame: 0.2 s from none to all."""
FLOOR_EVERY = 10
"""Frames between two measurements of the noise floor."""
QUIET_ROWS = 5
"""Frames of a quiet room before the first one: until 1.5 s of sound they are the floor."""
FLOOR_FRAMES = round(FLOOR_SECONDS * FRAME_RATE)
LOUDEST_PERCENTILE, LOUD_PERCENTILE = 98.0, 95.0
"""Of the loudest band of each frame, and of how far frames are above the noise."""


class ActivityState(NamedTuple):
    """What is kept of streams between two calls."""

    levels: Float64
    """Band levels of the last frames, dB, in a ring; infinite where there are none yet
    [shape=(B, `FLOOR_FRAMES`, K)]."""
    excess: Float64
    """How far they were above the noise, dB [shape=(B, `FLOOR_FRAMES`)]."""
    floor: Float64
    """Of each band [shape=(B, K)]."""
    gap: Int64
    """Longest gap that is no pause, now and at the last `GATE_AHEAD` frames [shape=(B, 6)]."""
    frames: Int64
    """Frames that have come [shape=(B,)]."""
    on: Bool
    """Which of the last frames are speech [shape=(B, P)]."""
    silent: Float64
    """Frames since the last speech, at the frame whose gates came last [shape=(B,)]."""
    share: Float64
    """Share of the expression of that frame; infinite before the first one [shape=(B,)]."""


class RunningActivity:
    """Activity and gates of streams.

    Parameters
    ----------
    gates : Gates or None
        Times of the gates; None: they stay open.
    """

    def __init__(self, gates: Gates | None) -> None:
        self.gates = gates
        self.past = LONGEST_DROWNED + GATE_AHEAD + 2 + (gates or Gates()).mouth_closes
        """P, frames before the last known one on which gates depend."""

    def first(self, batch: int) -> ActivityState:
        """State of streams before their first frame."""
        bands = len(BAND_EDGES_HZ) - 1
        gates = self.gates or Gates()
        settled = min(5 * gates.feeling_decays, gates.feeling_leaves)  # as after speech
        levels = np.full((batch, FLOOR_FRAMES, bands), np.inf)
        levels[:, :QUIET_ROWS] = SHORT_FLOOR_DB - OPEN_DB
        return ActivityState(
            levels,
            np.full((batch, FLOOR_FRAMES), np.inf),
            np.full((batch, bands), SHORT_FLOOR_DB - OPEN_DB),
            np.full((batch, GATE_AHEAD + 1), LONGEST_CLOSURE),
            np.zeros(batch, np.int64),
            np.zeros((batch, self.past), bool),
            np.full(batch, float(settled)),
            np.full(batch, np.inf),
        )

    def __call__(
        self, levels: Float32, held: Bool, rest: Float32, state: ActivityState
    ) -> tuple[Bool, Float32, Float32, ActivityState]:
        """Take the next frames.

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
            Gate of the mouth and share of the expression, of the frames `GATE_AHEAD` before the
            new ones.
        state : ActivityState
        """
        streams, count = np.arange(len(levels)), levels.shape[1]
        ring, above, floor = state.levels.copy(), state.excess.copy(), state.floor.copy()
        frames = state.frames.copy()
        gaps, flags = [state.gap[:, :-1]], [state.on]
        gap, on = state.gap[:, -1], state.on[:, -1]
        for k in range(count):
            excess = np.sort(levels[:, k] - floor, axis=1)[:, -TOP_BANDS:].mean(axis=1)
            on = held[:, k] | (excess >= np.where(on, KEEP_DB, OPEN_DB))
            row = np.where(held[:, k, None], np.inf, levels[:, k])
            ring[streams, (QUIET_ROWS + frames) % FLOOR_FRAMES] = row
            above[streams, frames % FLOOR_FRAMES] = excess
            frames += 1
            gaps.append(gap[:, None])
            flags.append(on[:, None])
            due = np.flatnonzero(frames % FLOOR_EVERY == 0)
            if len(due):
                floor[due], gap = _floor(ring[due]), gap.copy()
                loud = _percentile(above[due], LOUD_PERCENTILE)
                bridged = np.interp(loud, [NOISY_DB, CLEAN_DB], [LONGEST_DROWNED, LONGEST_CLOSURE])
                gap[due] = np.round(bridged)
        speaking, known = np.concatenate(flags, axis=1), np.concatenate(gaps, axis=1)
        kept = np.concatenate((known[:, count:], gap[:, None]), axis=1)
        after = ActivityState(
            ring, above, floor, kept, frames, speaking[:, count:], state.silent, state.share
        )
        mouth, expression, after = self._gates(speaking, known[:, :count], rest, after)
        return speaking, mouth, expression, after

    def _gates(
        self, speaking: Bool, gaps: Int64, rest: Float32, state: ActivityState
    ) -> tuple[Float32, Float32, ActivityState]:
        """Gates of the frames of n gaps [shape=(B, n)]."""
        if self.gates is None:
            return np.ones(gaps.shape, np.float32), np.ones(gaps.shape, np.float32), state
        rows = np.lib.stride_tricks.sliding_window_view(speaking, self.past + 1, axis=1)
        since, until = _distances(rows)
        bridged = since + until - 1 <= gaps
        since, until = np.where(bridged, 0, since), np.where(bridged, 0, until)
        mouth = mouth_between(since, until, self.gates, GATE_AHEAD)
        # Speech may have ended before what is kept of it; speech that comes raises the share.
        count = np.arange(since.shape[1], dtype=np.float32)
        spoken = np.maximum.accumulate(count - since, axis=1)
        since = count - np.maximum(spoken, -1 - state.silent[:, None])
        wanted = expression_after(since, until, rest[:, None], self.gates)
        wanted = np.where(np.isfinite(until), 1, wanted)
        share = np.where(np.isinf(state.share), wanted[:, 0], state.share)
        expression = wanted.copy()
        for k in range(since.shape[1]):
            share = np.clip(wanted[:, k], share - MOST_STEP, share + MOST_STEP)
            expression[:, k] = share
        after = state._replace(silent=since[:, -1].astype(np.float64), share=share)
        return mouth, expression.astype(np.float32), after


def _floor(levels: Float64) -> Float64:
    """Noise floor of each band [shape=(B, K)]."""
    loudest = _percentile(levels.max(axis=2), LOUDEST_PERCENTILE) - SPEECH_RANGE_DB
    floor: Float64 = np.maximum(_percentile(levels, FLOOR_PERCENTILE), loudest[:, None])
    return floor


def _percentile(values: Float64, percent: float) -> Float64:
    """Percentile along the second axis of the values that are finite, linear between two."""
    ordered = np.sort(values, axis=1)
    last = np.isfinite(values).sum(axis=1, keepdims=True) - 1
    place = percent / 100 * last
    below = place.astype(np.int64)
    low, high = (np.take_along_axis(ordered, k, 1) for k in (below, np.minimum(below + 1, last)))
    found: Float64 = (low + (place - below) * (high - low))[:, 0]
    return found


def _distances(rows: Bool) -> tuple[Float32, Float32]:
    """Frames since the last and until the next speaking one [shape=(...,)]; inf where none.

    Rows (..., P + 1) end `GATE_AHEAD` frames after their frame. A lone frame of speech is a click.
    """
    pair = rows[..., 1:] & rows[..., :-1]
    speaking = np.zeros_like(rows)
    speaking[..., 1:] |= pair
    speaking[..., :-1] |= pair
    before, after = speaking[..., -GATE_AHEAD - 1 :: -1], speaking[..., -GATE_AHEAD - 1 :]
    since = np.where(before.any(axis=-1), before.argmax(axis=-1), np.inf)
    until = np.where(after.any(axis=-1), after.argmax(axis=-1), np.inf)
    return since.astype(np.float32), until.astype(np.float32)
