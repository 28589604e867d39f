"""Expressions after the network: what an emotion adds to the neutral reading, by a table.

The network was taught poses of the five emotions; on renders they were too faint or ambiguous:
anger with drowsy lids, joy without cheeks and teeth. ``expressions.csv`` has, by emotion and
control, a gain on the network's difference of the readings and a pose in units of the control at
intensity 1, with the action unit (Ekman, Friesen and Hager 2002). Both grow in proportion to the
intensity. Sizes follow what acted faces do against the same actor's neutral face, and how raw
controls move together in a MetaHuman take ("the take": the slope of one control on another).

Moods are procedural: the network reads their mixture of the trained emotions (`rig.emotions.MOODS`)
and the table adds the prototype of their action units; contempt is of one side.

A smile yields to rounding: spread corners and a raised upper lip are muscles that act against those
of /u/ and /o/.

Letters: T frames, C controls, S styles, K controls of the table.
"""

import csv
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from deitalk.emotions import LABELS
from rig.arrays import Float32

SPREADING = ("cornerPull", "CornerPull", "stretch", "dimple", "corner.", "upperLipRaise")
"""Parts of the names of the controls whose expression yields to rounding."""
ROUNDING = ("mouth_funnel", "mouth_purse")
ROUNDED = (0.15, 0.6)
"""Mean of purse, or of funnel, at which an expression begins to yield, and yields fully."""
YIELDED = 0.8
"""Share that is taken away by full rounding."""
PARTING = ("jaw.ty", "lowerLipDepress")
"""Parts of the names of the other controls whose poses do not part closed lips."""


@dataclass(frozen=True)
class ExpressionTable:
    """Gains and poses of the emotions for the controls of one rig.

    Attributes
    ----------
    places : array [shape=(K,)]
        Columns of the controls.
    gains, poses : array [shape=(S, K)]
        Factor on the difference of the readings, and what is added to it at intensity 1.
    spreading, parting : array [shape=(K,), 0 or 1]
        Whether a control yields to rounding, and whether it may part closed lips.
    rounding : array [shape=(2, 4)]
        Columns of funnel, and of purse.
    """

    places: NDArray[np.intp]
    gains: Float32
    poses: Float32
    spreading: Float32
    parting: Float32
    rounding: NDArray[np.intp]

    def add_to(
        self,
        curves: Float32,
        neutral: Float32,
        weights: Float32,
        strength: Float32,
        free: Float32,
    ) -> None:
        """Change the expression, in place; nothing where there is none.

        Parameters
        ----------
        curves, neutral : array [shape=(T, C)]
            The blend of both readings, and the neutral one.
        weights : array [shape=(T, S)]
            Emotion of each frame.
        strength : array [shape=(T,), range 0 to 4]
            Intensity that the blend shows.
        free : array [shape=(T,), range 0 to 1]
            Share of the opening that closed lips leave to an expression.
        """
        if not len(self.places):
            return
        base = neutral[:, self.places]
        shown = (curves[:, self.places] - base) * (weights @ self.gains)
        pose = (weights @ self.poses) * strength[:, None]
        shown += pose * (1 - self.parting + self.parting * free[:, None])
        kept = 1 - YIELDED * self._rounded(neutral)
        shown *= 1 - self.spreading + self.spreading * kept[:, None]
        curves[:, self.places] = base + shown

    def _rounded(self, neutral: Float32) -> Float32:
        """How rounded the lips are [shape=(T,), range 0 to 1]."""
        rounding = neutral[:, self.rounding].mean(axis=2).max(axis=1)
        begin, full = ROUNDED
        share = np.clip((rounding - begin) / (full - begin), 0, 1)
        smooth: Float32 = share * share * (3 - 2 * share)
        return smooth


@lru_cache(maxsize=8)
def expression_table(names: tuple[str, ...]) -> ExpressionTable:
    """The table for the columns of a rig; controls that it lacks are left out."""
    text = resources.files("deitalk.postprocess").joinpath("expressions.csv").read_text("utf-8")
    rows = [
        (LABELS.index(row["emotion"]), name, float(row["gain"]), float(row["pose"]))
        for row in csv.DictReader(text.splitlines())
        for name in (row["control"].replace("*", side) for side in "LR")
        if name in names
    ]
    moved = sorted({name for _, name, _, _ in rows}, key=names.index)
    gains = np.ones((len(LABELS), len(moved)), np.float32)
    poses = np.zeros_like(gains)
    for emotion, name, gain, pose in rows:
        place = emotion, moved.index(name)
        gains[place], poses[place] = gain, pose
    return ExpressionTable(
        np.array([names.index(name) for name in moved], np.intp),
        gains,
        poses,
        _named(moved, SPREADING),
        _named(moved, SPREADING + PARTING),
        np.array([[i for i, name in enumerate(names) if part in name] for part in ROUNDING]),
    )


def _named(names: list[str], parts: tuple[str, ...]) -> Float32:
    """1 for each name that has one of the parts, else 0."""
    return np.array([any(part in name for part in parts) for name in names], np.float32)
