"""Pores of the skin: pits, on the face as it lies in the picture."""

import numpy as np

from rig.face import build_head
from rig.face.mesh import SKIN


def test_dark_pores_are_pits():
    """Normals (-dh/dx, -dh/dy) of the forehead run together where the surface is low and dark."""
    mesh = build_head("Bruno").mesh
    x, y, z = mesh.vertices.T
    forehead = (mesh.kind == SKIN) & (z > 4) & (np.abs(x) < 3) & (np.abs(y - 5) < 2)
    assert forehead.sum() > 20
    place = np.column_stack([x, y, np.ones(len(x))])[forehead]
    per_cm = np.linalg.lstsq(place, mesh.uv[forehead], rcond=None)[0][:2]
    per_cm /= np.abs(per_cm).max()
    tone, *tilt = np.moveaxis(mesh.maps.pores.astype(float), -1, 0)
    apart = np.zeros_like(tone)
    for part, (per_u, per_v) in zip(tilt, per_cm, strict=True):
        down, right = ((np.roll(part, -1, k) - np.roll(part, 1, k)) for k in (0, 1))
        apart += right * per_u + down * per_v
    assert np.corrcoef(apart.ravel(), tone.ravel())[0, 1] > 0.2
