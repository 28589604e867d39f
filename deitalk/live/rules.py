"""The rules of `deitalk.postprocess.curve_rules` on rows that come one after another.

Rules that depend on neighbouring frames (contacts) are applied to the rows from `BEHIND` frames
before to `AHEAD` after each frame, of which the frame's own is kept. Every frame is a function of
those rows alone, however they came.

Letters: n frames of a call, C controls, K contacts.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deitalk.emotions import EMOTIONS
from deitalk.live.activity import GateRows
from deitalk.postprocess.curve_rules import Expression
from rig.arrays import Float32

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
    """Weights of the emotions [shape=(n, 5)]."""
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
    ones, emotion = np.ones(BEHIND, np.float32), np.zeros((BEHIND, len(EMOTIONS)), np.float32)
    return RawRows(rest, rest.copy(), ones, ones, ones, emotion, ones)


@dataclass(frozen=True)
class RunningRules:
    """The rules of one control set.

    Parameters
    ----------
    expression : Expression
        Controls and settings.
    """

    expression: Expression

    def apply(self, rows: RawRows, gates: GateRows) -> Float32:
        """Curves of n frames [shape=(n, C)].

        Parameters
        ----------
        rows : RawRows
            Of `BEHIND` frames before them, of theirs, and of `AHEAD` after them.
        gates : GateRows
            Of the n frames.
        """
        rules, count = self.expression, len(gates.mouth)
        inner = slice(BEHIND, BEHIND + count)
        readings, contacts = [], []
        for reading in (rows.neutral, rows.emotional):
            sharp = rules.sharpened(_around(reading[:, rules.seals], count))
            own = reading[inner].copy()
            own[:, rules.seals] = sharp[BEHIND]
            rules.scale_opening(own, rows.voice[inner], rows.network[inner])
            readings.append(own)
            contacts.append(sharp)
        curves = rules.blend(readings[0], readings[1], rows.scale[inner])
        applied = rows.applied[inner] * gates.expression
        rules.widen_speech(curves, readings[0], rows.emotion[inner], applied)
        scale = _around(rows.scale[:, None], count)
        blended = (contacts[1] - contacts[0]) * scale
        if rules.settings.keep_contacts is not None:
            blended = np.maximum(blended, 0)
        curves[:, rules.seals] = rules.limited(contacts[0] + blended)[BEHIND]
        rules.apply_dead_zone(curves)
        rules.rest_in_silence(curves, gates.mouth, gates.expression)
        return curves


def _around(rows: Float32, count: int) -> Float32:
    """Rows (m, K) around each of `count` frames [shape=(BEHIND + 1 + AHEAD, count, K)]."""
    windows = np.lib.stride_tricks.sliding_window_view(rows, BEHIND + 1 + AHEAD, axis=0)[:count]
    around: Float32 = np.moveaxis(windows, 2, 0)
    return around
