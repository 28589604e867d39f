"""Turn and shift of a whole head on its neck.

A head track has six columns: yaw to the character's right, pitch up and roll to the right
shoulder in degrees; shift to the character's left, up and forward in cm (`rig.curves.HEAD`). The
head's axes are x to its left, y up, z forward, so that rotations follow the right hand about -y,
-x and z.

Letters: T frames, V vertices.
"""

import numpy as np
from numpy.typing import ArrayLike

from rig.arrays import AnyFloat, Float64
from rig.face.mesh import smoothstep

JOINT = np.array([0.0, -4.0, -1.5])
"""The joint of skull and spine, cm: between the ears and below them."""
NECK_LOW, NECK_HIGH, FORWARD = -13.9, -8.0, 0.45
"""The neck bends between these heights, cm, the rear ones higher by this share of their depth."""


def quaternions(track: ArrayLike) -> Float64:
    """Rotation of each frame as x, y, z, w [shape=(T, 4)]: roll first, then pitch, then yaw."""
    turns = np.asarray(track, np.float64)[:, :3]
    half = np.radians(turns * [-1, -1, 1]) / 2  # about y, x and z
    (sy, sx, sz), (cy, cx, cz) = np.sin(half).T, np.cos(half).T
    rotation: Float64 = np.stack(
        [
            cy * sx * cz + sy * cx * sz,
            sy * cx * cz - cy * sx * sz,
            cy * cx * sz - sy * sx * cz,
            cy * cx * cz + sy * sx * sz,
        ],
        axis=1,
    )
    return rotation


def matrices(track: ArrayLike) -> tuple[Float64, Float64]:
    """Rotation [shape=(T, 3, 3)] and translation [shape=(T, 3)], cm: v becomes R v + t."""
    x, y, z, w = quaternions(track).T
    rotation = np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=1),
            np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=1),
            np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=1),
        ],
        axis=1,
    )
    return rotation, JOINT - rotation @ JOINT + np.asarray(track, np.float64)[:, 3:6]


def neck_share(vertices: Float64) -> Float64:
    """Share of the head's motion that each vertex [shape=(V, 3)] of a neutral head takes."""
    height = vertices[:, 1] + FORWARD * vertices[:, 2]
    return smoothstep((height - NECK_LOW) / (NECK_HIGH - NECK_LOW))


def turned(poses: AnyFloat, track: ArrayLike, share: Float64) -> AnyFloat:
    """Poses [shape=(T, V, 3)] with the head turned on its neck.

    Parameters
    ----------
    poses : array [shape=(T, V, 3)]
        Of an embedded head, cm.
    track : array [shape=(T, 6)]
        Degrees and cm.
    share : array [shape=(V,)]
        From `neck_share`.
    """
    rotation, translation = (part.astype(poses.dtype) for part in matrices(track))
    moved: AnyFloat = poses @ rotation.transpose(0, 2, 1)
    moved += translation[:, None] - poses
    moved *= share[:, None].astype(poses.dtype)
    moved += poses
    return moved
