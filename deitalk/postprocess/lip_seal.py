"""Seal of the lips of known skins: gaps that are nearly closed are closed, after the network.

Deviation: not in the paper, whose lips are used as the solve gives them. A bilabial missed by a
millimetre looks missed; the embedded heads' own motion ends in the same operator
(`rig.face.head.seal_lips`). Letters: T frames, V vertices, N triangles, P pairs of lip points.
"""

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deitalk.errors import ConfigError
from rig.arrays import Float32, Int64
from rig.face import build_head
from rig.face.head import UPPER_PART, Lip
from rig.mesh import TriMesh


class KnownSkin(NamedTuple):
    """A skin whose lips are known."""

    faces: Int64
    """[shape=(N, 3)]."""
    n_vertices: int
    lips: tuple[Lip, Lip]
    """Upper and lower."""
    landmarks: dict[str, int]


@cache
def known_skins() -> tuple[KnownSkin, KnownSkin]:
    """The embedded heads' cage, and the skin of the heads that the shipped mesh models learned."""
    head = build_head(0)
    count = head.slices["cage"].stop
    upper, lower = (lip.within(count) for lip in head.motion.lips)
    with np.load(Path(__file__).with_name("former_skin.npz")) as stored:
        former = {name: stored[name] for name in stored.files}
    n_loops, n_pairs = former["upper"].shape
    column = np.tile(np.arange(n_pairs, dtype=np.float32), n_loops)
    share = np.repeat(former["shares"], n_pairs)
    lips = [
        Lip(former[k][former["rim"]].astype(np.int64), np.eye(n_pairs, dtype=np.float32),
            former[k].ravel().astype(np.int64), column, share)
        for k in ("upper", "lower")
    ]  # fmt: skip
    faces = former["faces"].astype(np.int64)
    points = dict(
        zip(map(str, former["landmarks"]), map(int, former["landmark_points"]), strict=True)
    )
    return (
        KnownSkin(head.cage.faces, count, (upper, lower), head.landmarks),
        KnownSkin(faces, int(faces.max()) + 1, (lips[0], lips[1]), points),
    )


def known_skin(mesh: TriMesh) -> KnownSkin | None:
    """The known skin with the triangles of a mesh."""
    return next((s for s in known_skins() if np.array_equal(s.faces, mesh.faces)), None)


def seal_lips(vertices: Float32, reach_mm: float, unit_mm: float) -> Float32:
    """Close the lips of a known skin where they nearly meet.

    Parameters
    ----------
    vertices : array [shape=(T, V, 3)]
        Of one of `known_skins`.
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
    skin = next(skin for skin in known_skins() if skin.n_vertices == vertices.shape[1])
    upper, lower = (vertices[:, lip.rim, 1] @ lip.weight.T for lip in skin.lips)
    gap = upper - lower  # (T, P), height
    quarter = gap.shape[1] // 4
    apart_mm = np.abs(gap[:, quarter:-quarter]).mean(axis=1) * unit_mm
    far = np.clip(2 * apart_mm / reach_mm - 1, 0, 1)
    move = np.zeros((*gap.shape, 3), np.float32)
    move[..., 1] = gap * (1 - far * far * (3 - 2 * far))[:, None]
    sealed = vertices.copy()
    for lip, part in zip(skin.lips, (-UPPER_PART, 1 - UPPER_PART), strict=True):
        sealed[:, lip.reach] += lip.along((part * move).astype(np.float32))
    return sealed


def check_faces(reach_mm: float, templates: Iterable[TriMesh]) -> None:
    """Refuse to seal templates whose lips are not known.

    Raises
    ------
    ConfigError
        If `reach_mm` is not 0 and a template has other triangles.
    """
    if reach_mm and not all(known_skin(mesh) for mesh in templates):
        raise ConfigError(
            f"model.seal_mm={reach_mm:g}: only the embedded heads' lips are known; set it to 0"
        )
