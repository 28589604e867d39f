"""Seal of the embedded heads' lips: gaps that are nearly closed are closed, after the network.

Deviation: not in the paper, whose lips are used as the solve gives them. A bilabial missed by a
millimetre looks missed; the embedded heads' own motion ends in the same operator
(`rig.face.motion.rigid`).
"""

from collections.abc import Iterable
from functools import cache
from typing import NamedTuple

import numpy as np

from deitalk.errors import ConfigError
from rig.arrays import Float32, Int64
from rig.mesh import TriMesh

RINGS = range(-2, 10)
"""Loops about the lips' rim, which is 0; negative inside the mouth."""
SHARES = (0.75, 1.0, 1.0, 0.95, 0.86, 0.73, 0.57, 0.41, 0.27, 0.16, 0.08, 0.03)
"""Share of the rim's movement that each loop makes, as in the heads' own seal."""
UPPER_PART = 0.38
"""The upper lip covers this share of the gap, the lower lip the rest."""


class _Loops(NamedTuple):
    """Facing vertices of every loop of `RINGS`, from corner to corner."""

    upper: Int64
    """[shape=(rings, P)]."""
    lower: Int64
    """[shape=(rings, P)]."""


def seal_lips(vertices: Float32, reach_mm: float, unit_mm: float) -> Float32:
    """Close the lips of an embedded head where they nearly meet.

    Parameters
    ----------
    vertices : array [shape=(T, V, 3)]
        Skin of any embedded head: vertices are numbered alike in every identity.
    reach_mm : float
        Lips further apart than this stay; half as far apart or less, they meet; between, smoothly.
        0 changes nothing.
    unit_mm : float
        Millimetres in a unit of the vertices.

    Returns
    -------
    array [shape=(T, V, 3)]
        A copy, unless `reach_mm` is 0.
    """
    if reach_mm == 0:
        return vertices
    upper, lower = _head_loops()
    rim = RINGS.index(0)
    gap = vertices[:, lower[rim]] - vertices[:, upper[rim]]  # (T, P, 3)
    # How far the lips of each frame are brought together [shape=(T,), range 0 to 1].
    gap_mm = gap * np.float32(unit_mm)
    quarter = gap_mm.shape[1] // 4
    middle = gap_mm[:, quarter : gap_mm.shape[1] - quarter]
    apart_mm = np.linalg.norm(middle, axis=-1).mean(axis=1)
    far = np.clip(2 * apart_mm / reach_mm - 1, 0, 1)
    move = gap * np.asarray(1 - far * far * (3 - 2 * far), dtype=np.float32)[:, None, None]
    share = np.array(SHARES, dtype=np.float32)[:, None, None]
    sealed = vertices.copy()
    sealed[:, upper] += UPPER_PART * move[:, None] * share
    sealed[:, lower] -= (1 - UPPER_PART) * move[:, None] * share
    return sealed


def check_faces(reach_mm: float, templates: Iterable[TriMesh]) -> None:
    """Refuse to seal templates that are no embedded head's skin.

    Raises
    ------
    ConfigError
        If `reach_mm` is not 0 and a template has other triangles.
    """
    if reach_mm == 0:
        return
    from rig.face import build_head

    faces = build_head(0).skin.faces
    if not all(np.array_equal(mesh.faces, faces) for mesh in templates):
        raise ConfigError(
            f"model.seal_mm={reach_mm:g}: only the embedded heads' lips are known; set it to 0"
        )


@cache
def _head_loops() -> _Loops:
    from rig.face import build_head
    from rig.face.geometry.topology import MOUTH

    skin = build_head(0).features
    rows = [skin.loop(MOUTH, ring) for ring in RINGS]
    upper = np.arange(1, len(rows[0]) // 2)
    return _Loops(
        np.stack([row[upper] for row in rows]),
        np.stack([row[len(row) - upper] for row in rows]),
    )
