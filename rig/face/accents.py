"""Accents of a posed head: how deep creases are, and the shadow of lids on eyes.

One number a vertex and frame, 0..1. On skin it is the depth of the map of creases, in regions that
follow controls; on eyes it is shadow. `deitalk/preview/web/src/face/accents.ts` is the same.
"""

import numpy as np
from numpy.typing import ArrayLike

from rig.arrays import AnyFloat, Float32, Float64, Int64
from rig.controls import default_controls
from rig.face.geometry.mesh import smoothstep
from rig.face.geometry.topology import EYE_L, EYE_R
from rig.face.head import Head

REGIONS: dict[str, dict[str, float]] = {
    "forehead": {"brow_raiseIn.ty": 0.65, "brow_raiseOut.ty": 0.55},
    "glabella": {"brow_down.ty": 0.7, "brow_lateral.ty": 0.6, "nose.ty": 0.2},
    "eye": {"eye_cheekRaise.ty": 0.75, "eye_squintInner.ty": 0.12, "mouth_cornerPull.ty": 0.3,
            "eye_faceScrunch.ty": 0.6},
    "nasolabial": {"mouth_cornerPull.ty": 0.75, "nose.tx": 0.5, "nose.ty": 0.45,
                   "mouth_upperLipRaise.ty": 0.45, "mouth_sharpCornerPull.ty": 0.6},
}  # fmt: skip
"""Controls of each region (of either side), and the depth that each gives at 1."""
LEAST = {"forehead": 0.04, "glabella": 0.03, "eye": 0.05, "nasolabial": 0.10}
"""Depth of each region at rest."""
SHADOW_RADIANS, SHADOW = 0.34, 0.85
"""How far below the upper lid its shadow reaches on the eye, and its depth at the rim."""


def gains() -> Float64:
    """Depth of each region on either side by each control [shape=(185, 8)], left regions first."""
    controls = default_controls()
    table = np.zeros((len(controls.names), 2 * len(REGIONS)))
    for k, weights in enumerate(REGIONS.values()):
        for place, side in ((k, "L"), (k + len(REGIONS), "R")):
            for name, gain in weights.items():
                table[controls.index(f"CTRL_{side}_{name}"), place] = gain
    return table


def least() -> Float64:
    """Depth of each region at rest [shape=(8,)]."""
    return np.tile([LEAST[name] for name in REGIONS], 2)


def upper_rim(head: Head, kind: int) -> Int64:
    """Vertices of an upper lid's rim, from the character's right to left."""
    rim = head.features.loop(kind, 0)
    upper = rim[: len(rim) // 2 + 1]
    return upper[np.argsort(head.features.vertices[upper, 0])]


def masks(head: Head) -> Float32:
    """Share of each region's depth that every skin vertex takes [shape=(8, V of the skin)]."""
    x, y, z = head.skin.vertices.T
    place = head.features.anatomy
    far = np.abs(x)
    eye_x, mouth_y = place.eye[0], place.mouth_y
    middle = smoothstep((2.2 - far) / 0.9)
    side = smoothstep((far - eye_x - 0.6) / 0.8) + smoothstep((-0.7 - y) / 0.4)
    found = {
        "forehead": smoothstep((y - 2.5) / 0.7),
        "glabella": middle * smoothstep((y + 0.2) / 0.5) * smoothstep((3.4 - y) / 0.8),
        "eye": np.minimum(side, 1) * smoothstep((2.1 - y) / 0.6) * smoothstep((y + 2.6) / 0.8),
        "nasolabial": smoothstep((-2.9 - y) / 0.8) * smoothstep((y - mouth_y + 2.4) / 1.0),
    }
    left = smoothstep(x / 0.8 + 0.5)
    front = np.stack([found[name] for name in REGIONS]) * (z > 0) * (head.features.ring >= 0)
    both = np.concatenate([front * left, front * (1 - left)])
    return (head.identity.creases * both).astype(np.float32)


def accents(head: Head, values: AnyFloat, poses: AnyFloat) -> Float32:
    """Accents [shape=(T, V)] of control values [shape=(T, 185)] and their poses [shape=(T, V, 3)].

    The poses are those of `Head.pose`, before the head is turned.
    """
    found = np.zeros(poses.shape[:2], np.float32)
    depth = np.clip(least() + np.maximum(values, 0) @ gains(), 0, 1).astype(np.float32)
    found[:, head.slices["skin"]] = np.minimum(depth @ masks(head), 1)
    for side, kind in (("L", EYE_L), ("R", EYE_R)):
        found[:, head.slices[f"eye_{side}"]] = _under_lid(head, poses, side, kind)
    return found


def _under_lid(head: Head, poses: AnyFloat, side: str, kind: int) -> Float32:
    """Shadow [shape=(T, V of an eye)] by how far a vertex lies below the rim of the upper lid."""
    center = head.features.anatomy.eye * [1 if side == "L" else -1, 1, 1]
    lid = poses[:, upper_rim(head, kind)] - center
    ball = poses[:, head.slices[f"eye_{side}"]] - center
    high, angle = (np.arctan2(p[..., 1], p[..., 2]) for p in (lid, ball))
    edge = np.stack(
        [np.interp(b, a, h) for b, a, h in zip(ball[..., 0], lid[..., 0], high, strict=True)]
    )
    shadow = SHADOW * smoothstep(1 - (edge - angle) / SHADOW_RADIANS)
    return np.asarray(shadow * (ball[..., 2] > 0), np.float32)


# Turn and shift of a whole head on its neck.
#
# A head track has six columns: yaw to the character's right, pitch up and roll to the right
# shoulder in degrees; shift to the character's left, up and forward in cm (`rig.curves.HEAD`).
# The head's axes are x to its left, y up, z forward, so that rotations follow the right hand
# about -y, -x and z.
#
# Letters: T frames, V vertices.

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
    rotation, translation = matrices(track)
    moved = poses @ rotation.transpose(0, 2, 1) + translation[:, None]
    mixed: AnyFloat = (poses + share[:, None] * (moved - poses)).astype(poses.dtype)
    return mixed
