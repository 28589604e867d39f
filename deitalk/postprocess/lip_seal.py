"""Lips that nearly meet are made to meet: the embedded heads' seal as the last operator.

Deviation: not in the paper, whose lips come out of the solve as they are. A bilabial missed by a
millimetre reads as missed; the heads' own motion ends in the same operator
(`rig.face.motion.contact`).
"""

from dataclasses import dataclass

import numpy as np

from rig.arrays import Float32, Int64
from rig.face import build_head
from rig.face.geometry.topology import MOUTH

RINGS = range(-2, 10)
"""Loops about the lips' rim, which is 0; negative inside the mouth."""
SHARES = (0.75, 1.0, 1.0, 0.95, 0.86, 0.73, 0.57, 0.41, 0.27, 0.16, 0.08, 0.03)
"""How much of the rim's movement each loop makes, as in the heads' own seal."""
UPPER_PART = 0.38
"""The upper lip covers this share of the gap, the lower lip the rest."""


@dataclass(frozen=True, eq=False)
class LipSeal:
    """Facing loops of the lips and the gap that is closed.

    Parameters
    ----------
    upper, lower : array [shape=(rings, P)]
        Vertices of every loop of `RINGS`, from corner to corner; upper over lower.
    reach_mm : float
        Lips further apart than this stay; half as far apart, they meet. Between, smoothly.
    unit_mm : float
        Millimetres in a unit of the vertices.
    """

    upper: Int64
    lower: Int64
    reach_mm: float
    unit_mm: float

    @classmethod
    def of_heads(cls, reach_mm: float, unit_mm: float) -> "LipSeal":
        """That of the embedded heads, whose vertices are the same in every identity."""
        skin = build_head(0).features
        rows = [skin.loop(MOUTH, ring) for ring in RINGS]
        upper = np.arange(1, len(rows[0]) // 2)
        return cls(
            np.stack([row[upper] for row in rows]),
            np.stack([row[len(row) - upper] for row in rows]),
            reach_mm,
            unit_mm,
        )

    def amounts(self, vertices: Float32) -> Float32:
        """How far the lips of each frame are brought together [shape=(T,), range 0 to 1]."""
        gap = self._gap(vertices)
        quarter = gap.shape[1] // 4
        middle = gap[:, quarter : gap.shape[1] - quarter]
        apart = self.unit_mm * np.linalg.norm(middle, axis=-1).mean(axis=1)
        far = np.clip(2 * apart / self.reach_mm - 1, 0, 1)
        return np.asarray(1 - far * far * (3 - 2 * far), dtype=np.float32)

    def __call__(self, vertices: Float32) -> Float32:
        """Vertices (T, V, 3) with their lips sealed where they nearly meet."""
        sealed = vertices.copy()
        move = self._gap(vertices) * self.amounts(vertices)[:, None, None]
        share = np.array(SHARES, dtype=np.float32)[:, None, None]
        sealed[:, self.upper] += UPPER_PART * move[:, None] * share
        sealed[:, self.lower] -= (1 - UPPER_PART) * move[:, None] * share
        return sealed

    def _gap(self, vertices: Float32) -> Float32:
        rim = RINGS.index(0)
        gap: Float32 = vertices[:, self.lower[rim]] - vertices[:, self.upper[rim]]
        return gap
