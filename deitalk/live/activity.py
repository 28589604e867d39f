"""Voice activity and gates of a voice that has not ended.

The causal form of `deitalk.audio.voice_activity.speech_activity` and `deitalk.postprocess.gates`:
the noise floor is of the last 12 s, and a frame depends on `AHEAD` frames after it.

Letters: K frequency bands, n frames of a call.
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
from deitalk.config import Gates
from deitalk.postprocess.gates import expression_between, mouth_between
from rig.arrays import Bool, Float32

AHEAD = 5
"""Frames after a frame that its gates depend on (0.17 s)."""
FLOOR_EVERY = 10
"""Frames between two measurements of the noise floor."""
QUIET_ROWS = 5
"""Frames of a quiet room before the first one: until 1.5 s of sound they are the floor."""


class GateRows(NamedTuple):
    """Gates of consecutive frames [shape=(n,), range 0 to 1]."""

    mouth: Float32
    expression: Float32


class RunningActivity:
    """Activity of one stream, frame by frame.

    Parameters
    ----------
    gates : Gates or None
        Times of the gates; None: they stay open.
    """

    def __init__(self, gates: Gates | None) -> None:
        self.gates = gates
        keep = LONGEST_DROWNED + AHEAD + 2
        longest = gates or Gates()
        keep += max(longest.mouth_closes, longest.expression_holds + longest.expression_fades)
        self.keep = keep
        self.ring = np.full((QUIET_ROWS, len(BAND_EDGES_HZ) - 1), SHORT_FLOOR_DB - OPEN_DB)
        """Band levels of the last frames, dB."""
        self.loud = np.zeros(0)
        """How far the last frames were above the noise, dB."""
        self.on, self.is_on = np.zeros(keep - AHEAD, bool), False
        """Activity of the last frames, and of the very last."""
        self.gaps = np.zeros(0, int)
        """Longest gap that is no pause, at the frames whose gates are not known."""
        self.n_frames, self.gap = 0, LONGEST_CLOSURE
        self._measure_floor()

    def feed(self, levels: Float32) -> Bool:
        """Take the levels (n, K) of the next frames; return whether each is speech [shape=(n,)].

        Gaps are not bridged, and clicks not left out, in what is returned.
        """
        flags, at = [], 0
        while at < len(levels):
            take = FLOOR_EVERY - self.n_frames % FLOOR_EVERY
            block = levels[at : at + take]
            self.ring = np.concatenate((self.ring, block))[-round(FLOOR_SECONDS * FRAME_RATE) :]
            self.n_frames, at = self.n_frames + len(block), at + len(block)
            flags.append(self._speaking(block))
            self.gaps = np.append(self.gaps, np.full(len(block), self.gap))
            if self.n_frames % FLOOR_EVERY == 0:
                self._measure_floor()
        speaking = np.concatenate(flags) if flags else np.zeros(0, bool)
        self.on = np.append(self.on, speaking)
        return speaking

    def gate(self, count: int) -> GateRows:
        """Gates of the next `count` frames; levels of `AHEAD` frames after them must be known."""
        gaps, self.gaps = self.gaps[:count], self.gaps[count:]
        width = self.keep + 1
        rows = np.lib.stride_tricks.sliding_window_view(self.on, width)[:count]
        self.on = self.on[count:]
        if self.gates is None:
            return GateRows(np.ones(count, np.float32), np.ones(count, np.float32))
        since, until = _distances(rows)
        bridged = since + until - 1 <= gaps
        since, until = np.where(bridged, 0, since), np.where(bridged, 0, until)
        mouth = mouth_between(since, until, self.gates, AHEAD)
        return GateRows(mouth, expression_between(since, until, self.gates, AHEAD))

    def _speaking(self, levels: Float32) -> Bool:
        above = levels - self.floor
        excess = np.sort(above, axis=1)[:, -TOP_BANDS:].mean(axis=1)
        self.loud = np.append(self.loud, excess)[-round(FLOOR_SECONDS * FRAME_RATE) :]
        flags, on = np.zeros(len(levels), bool), self.is_on
        for k, value in enumerate(excess):
            on = bool(value >= (KEEP_DB if on else OPEN_DB))
            flags[k] = on
        self.is_on = on
        return flags

    def _measure_floor(self) -> None:
        floor = np.percentile(self.ring, FLOOR_PERCENTILE, axis=0)
        loudest = np.percentile(self.ring.max(axis=1), 98)
        self.floor = np.maximum(floor, loudest - SPEECH_RANGE_DB)
        if len(self.loud):
            loud = np.percentile(self.loud, 95)
            bridged = np.interp(loud, [NOISY_DB, CLEAN_DB], [LONGEST_DROWNED, LONGEST_CLOSURE])
            self.gap = round(float(bridged))


def _distances(rows: Bool) -> tuple[Float32, Float32]:
    """Frames since the last and until the next speaking one [shape=(n,)]; inf where none.

    Rows end `AHEAD` frames after their frame. A lone frame of speech is a click.
    """
    pair = rows[:, 1:] & rows[:, :-1]
    speaking = np.zeros_like(rows)
    speaking[:, 1:] |= pair
    speaking[:, :-1] |= pair
    before, after = speaking[:, :-AHEAD][:, ::-1], speaking[:, -AHEAD - 1 :]
    since = np.where(before.any(axis=1), before.argmax(axis=1), np.inf)
    until = np.where(after.any(axis=1), after.argmax(axis=1), np.inf)
    return since.astype(np.float32), until.astype(np.float32)
