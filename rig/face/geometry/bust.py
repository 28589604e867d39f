"""Shoulders in a shirt with a ribbed collar, which the neck stands in."""

import numpy as np

from rig.face.geometry.mesh import CLOTH, Mesh, grid_faces, smoothstep
from rig.face.identity import Identity

_COLUMNS = 144
_AXIS_Z = -3.1
"""Depth of the neck's middle where the collar is, cm."""
NECK_RADIUS = 5.25


def bust(identity: Identity) -> Mesh:
    """Collar and shoulders, from inside the collar down to the chest."""
    turn = np.arange(_COLUMNS) / _COLUMNS * 2 * np.pi  # 0 front, pi/2 the character's left
    c, s = np.cos(turn), np.sin(turn)
    neck = NECK_RADIUS * identity.neck_width
    high = -13.3 - 0.8 * c  # the collar lies lower in front
    rib = 0.045 * np.cos(turn * _COLUMNS / 3)
    rows = []
    for out, down in (
        (-0.25, 1.6),
        (0.10, 0.25),
        (0.30, 0.0),
        (0.62, 0.10),
        (0.85, 0.55),
        (0.95, 1.25),
    ):
        radius = neck + out + rib * (out > 0.2) + 0.55 * np.maximum(c, 0) ** 2
        rows.append(np.stack([radius * s, high - down, _AXIS_Z + radius * c], -1))
    half = 19.0 * (0.35 + 0.65 * identity.neck_width)
    for t in np.linspace(0.02, 1, 18):
        wide = neck + 1.0 + (half - neck - 1.0) * t
        deep = neck + 1.0 + (0.46 * half - neck - 1.0) * np.minimum(1.6 * t, 1)
        side = np.abs(s) ** 2.0
        slope = 3.6 * t**0.75 + 3.0 * smoothstep((t - 0.62) / 0.38) ** 2  # trapezius, then deltoid
        chest = 11.0 * t**1.15
        y = high * (1 - t) - 15.0 * t - 1.25 - (slope * side + chest * (1 - side))
        swell = 1 + 0.10 * np.maximum(c, 0) * np.sin(np.pi * np.minimum(t * 1.2, 1))
        rows.append(np.stack([wide * s, y, _AXIS_Z + 0.6 * t + deep * c * swell], -1))
    rows.append(rows[-1] * [1.02, 1, 1.04] - [0, 14, 0])
    vertices = np.concatenate(rows)
    color = np.array(identity.shirt)
    shade = np.repeat(
        np.interp(np.arange(len(rows)), [0, 2, 4, 5, 6, 8], [0.5, 0.9, 1.04, 0.94, 0.72, 1]),
        _COLUMNS,
    )
    return Mesh(
        vertices, grid_faces(len(rows), _COLUMNS)[:, ::-1], color * shade[:, None],
        np.full(len(vertices), 0.06), kind=np.array(CLOTH),
    )  # fmt: skip
