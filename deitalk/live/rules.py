"""The rules of `deitalk.postprocess.curve_rules` on rows that come one after another.

Rules that depend on neighbouring frames (contacts) are applied to the rows from `BEHIND` frames
before to `AHEAD` after each frame, of which the frame's own is kept. Every frame is a function of
those rows alone, however they came.

Letters: n frames of a call, C controls, K contacts.
"""

from collections.abc import Sequence
from dataclasses import dataclass
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
from deitalk.emotions import LABELS
from deitalk.postprocess.curve_rules import Expression
from deitalk.postprocess.gates import expression_between, mouth_between
from rig.arrays import Bool, Float32

# Voice activity and gates of a voice that has not ended.
#
# The causal form of `deitalk.audio.voice_activity.speech_activity` and `deitalk.postprocess.gates`:
# the noise floor is of the last 12 s, and a frame depends on `GATE_AHEAD` frames after it.
#
# Letters: K frequency bands, n frames of a call.

GATE_AHEAD = 5
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
        keep = LONGEST_DROWNED + GATE_AHEAD + 2
        longest = gates or Gates()
        keep += max(longest.mouth_closes, longest.expression_holds + longest.expression_fades)
        self.keep = keep
        self.ring = np.full((QUIET_ROWS, len(BAND_EDGES_HZ) - 1), SHORT_FLOOR_DB - OPEN_DB)
        """Band levels of the last frames, dB."""
        self.loud = np.zeros(0)
        """How far the last frames were above the noise, dB."""
        self.on, self.is_on = np.zeros(keep - GATE_AHEAD, bool), False
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
        """Gates of the next `count` frames; levels of `GATE_AHEAD` more must be known."""
        gaps, self.gaps = self.gaps[:count], self.gaps[count:]
        width = self.keep + 1
        rows = np.lib.stride_tricks.sliding_window_view(self.on, width)[:count]
        self.on = self.on[count:]
        if self.gates is None:
            return GateRows(np.ones(count, np.float32), np.ones(count, np.float32))
        since, until = _distances(rows)
        bridged = since + until - 1 <= gaps
        since, until = np.where(bridged, 0, since), np.where(bridged, 0, until)
        mouth = mouth_between(since, until, self.gates, GATE_AHEAD)
        return GateRows(mouth, expression_between(since, until, self.gates, GATE_AHEAD))

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

    Rows end `GATE_AHEAD` frames after their frame. A lone frame of speech is a click.
    """
    pair = rows[:, 1:] & rows[:, :-1]
    speaking = np.zeros_like(rows)
    speaking[:, 1:] |= pair
    speaking[:, :-1] |= pair
    before, after = speaking[:, :-GATE_AHEAD][:, ::-1], speaking[:, -GATE_AHEAD - 1 :]
    since = np.where(before.any(axis=1), before.argmax(axis=1), np.inf)
    until = np.where(after.any(axis=1), after.argmax(axis=1), np.inf)
    return since.astype(np.float32), until.astype(np.float32)


BEHIND, AHEAD = 5, 2
"""Rows before and after a frame that its contacts depend on."""


class RawRows(NamedTuple):
    """What the network and the voice give for consecutive frames."""

    neutral: Float32
    """Neutral reading [shape=(n, C)]."""
    emotional: Float32
    """Emotional reading [shape=(n, C)]."""
    network: Float32
    """Intensity that the network predicts [shape=(n,), range 0 to 1]."""
    voice: Float32
    """The same, corrected by the prosody [shape=(n,), range 0 to 1]."""
    scale: Float32
    """Factor on the difference of the readings [shape=(n,)]."""
    emotion: Float32
    """Weights of the emotions [shape=(n, 9)]."""
    applied: Float32
    """Intensity to show in speech [shape=(n,), range 0 to 4]."""

    def joined(self, other: "RawRows") -> "RawRows":
        """These rows and the ones that follow them."""
        return RawRows(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))

    def since(self, first: int) -> "RawRows":
        """Rows from a place on."""
        return RawRows(*(part[first:] for part in self))


def rows_before(expression: Expression) -> RawRows:
    """Rows before the first frame: the face at rest."""
    rest = np.tile(expression.controls.rest, (BEHIND, 1)).astype(np.float32)
    ones, emotion = np.ones(BEHIND, np.float32), np.zeros((BEHIND, len(LABELS)), np.float32)
    return RawRows(rest, rest.copy(), ones, ones, ones, emotion, ones)


class DueRows(NamedTuple):
    """All that the curves of n frames depend on; of several streams side by side."""

    own: RawRows
    """Of the frames themselves."""
    neutral: Float32
    """Contacts of the neutral reading around each frame [shape=(8, n, K)]."""
    emotional: Float32
    """Contacts of the emotional reading around each frame [shape=(8, n, K)]."""
    scale: Float32
    """Factor around each frame [shape=(8, n, 1)]."""
    gates: GateRows


@dataclass(frozen=True)
class RunningRules:
    """The rules of one control set.

    Parameters
    ----------
    expression : Expression
        Controls and settings.
    """

    expression: Expression

    def due(self, rows: RawRows, gates: GateRows) -> DueRows:
        """Gather what the curves of n frames depend on.

        Parameters
        ----------
        rows : RawRows
            Of `BEHIND` frames before them, of theirs, and of `AHEAD` after them.
        gates : GateRows
            Of the n frames.
        """
        count, seals = len(gates.mouth), self.expression.seals
        own = RawRows(*(part[BEHIND : BEHIND + count] for part in rows))
        neutral = _around(rows.neutral[:, seals], count)
        emotional = _around(rows.emotional[:, seals], count)
        return DueRows(own, neutral, emotional, _around(rows.scale[:, None], count), gates)

    def apply(self, due: Sequence[DueRows]) -> list[Float32]:
        """Curves of the frames of several streams [shape=(n, C)] each, in one go."""
        rules, rows = self.expression, _side_by_side(due)
        own, readings, contacts = rows.own, [], []
        for reading, around in ((own.neutral, rows.neutral), (own.emotional, rows.emotional)):
            sharp, curves = rules.sharpened(around), reading.copy()
            curves[:, rules.seals] = sharp[BEHIND]
            rules.scale_opening(curves, own.voice, own.network)
            readings.append(curves)
            contacts.append(sharp)
        curves = rules.blend(readings[0], readings[1], own.scale)
        rules.express(curves, readings[0], own.emotion, own.scale, own.network)
        rules.rest_lips(curves, readings[0])
        blended = (contacts[1] - contacts[0]) * rows.scale
        if rules.settings.keep_contacts is not None:
            blended = np.maximum(blended, 0)
        curves[:, rules.seals] = rules.limited(contacts[0] + blended)[BEHIND]
        rules.apply_dead_zone(curves)
        rules.rest_in_silence(curves, rows.gates.mouth, rows.gates.expression)
        return np.split(curves, np.cumsum([len(one.gates.mouth) for one in due])[:-1])


def _side_by_side(due: Sequence[DueRows]) -> DueRows:
    own = RawRows(*(np.concatenate(parts) for parts in zip(*(d.own for d in due), strict=True)))
    gates = (np.concatenate(parts) for parts in zip(*(d.gates for d in due), strict=True))
    return DueRows(
        own,
        np.concatenate([d.neutral for d in due], axis=1),
        np.concatenate([d.emotional for d in due], axis=1),
        np.concatenate([d.scale for d in due], axis=1),
        GateRows(*gates),
    )


def _around(rows: Float32, count: int) -> Float32:
    """Rows (m, K) around each of `count` frames [shape=(BEHIND + 1 + AHEAD, count, K)]."""
    return np.stack([rows[k : k + count] for k in range(BEHIND + 1 + AHEAD)])
