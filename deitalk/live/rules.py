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

from deitalk.emotions import LABELS
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
