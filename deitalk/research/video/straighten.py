"""Landmarks without the head's motion, and the head's turn, from one camera.

Every frame is turned, scaled and shifted onto the person's mean shape by the points that move
with the skull (least squares over rotations, Umeyama 1991, IEEE PAMI 13(4):376, eq. 40-43). The
mean shape is made symmetric, so that its middle plane faces the camera.

Letters: T frames, P points, R rigid points.
"""

import numpy as np

from deitalk.research.video.landmarks import LIDS, PLACE, RIGID, RIGID_MIRROR, FaceTrack
from rig.arrays import Bool, Float32, Float64

ROUNDS = 4
MOST_FRAMES = 3000
"""Frames that the mean shape is taken from, evenly spread."""


def straightened(track: FaceTrack, seen: Bool) -> tuple[FaceTrack, Float32]:
    """Remove the motion of the head.

    Parameters
    ----------
    track : FaceTrack
        T frames.
    seen : array of bool [shape=(T,)]
        Frames with a face.

    Returns
    -------
    track : FaceTrack
        In distances between the outer corners of the eyes: x to the person's left, y up, z towards
        the camera, 0 between the eyes.
    degrees : array [shape=(T, 3)]
        Yaw, pitch and roll of the head in the signs of `rig.curves.HEAD`, against the median of the
        take: where the camera stood is not known.
    """
    points = track.points * np.array([1, -1, -1], np.float32)
    rigid = points[:, [PLACE[n] for n in RIGID]].astype(np.float64)
    frames = np.flatnonzero(seen)
    frames = frames[np.linspace(0, len(frames) - 1, min(len(frames), MOST_FRAMES)).astype(int)]
    shape = _mean_shape(rigid[frames])
    rotation, scale, center = _onto(rigid, shape)
    corners = [RIGID.index(LIDS[side]["corners"][0]) for side in ("L", "R")]
    unit = float(np.linalg.norm(shape[corners[0]] - shape[corners[1]]))
    middle = shape[corners].mean(axis=0)
    moved = (points - center[:, None]) @ rotation.transpose(0, 2, 1) * scale[:, None, None]
    straight = ((moved - middle) / unit).astype(np.float32)
    return FaceTrack(straight, track.times, track.notes), _degrees(rotation, seen)


def _mean_shape(rigid: Float64) -> Float64:
    """Mean shape (R, 3) about its centre, symmetric to x = 0, of size 1."""
    shape = _centred(rigid[len(rigid) // 2])
    for _ in range(ROUNDS):
        rotation, scale, center = _onto(rigid, shape)
        moved = (rigid - center[:, None]) @ rotation.transpose(0, 2, 1) * scale[:, None, None]
        shape = _centred(np.median(moved, axis=0))
    places = [RIGID.index(n) for n in RIGID_MIRROR]
    for _ in range(ROUNDS):
        other = shape[places] * [-1, 1, 1]
        rotation, scale, center = _onto(other[None], shape)
        shape = _centred((shape + (other - center[0]) @ rotation[0].T * scale[0]) / 2)
        across = (shape - shape[places]).reshape(-1, 3)
        direction = np.linalg.svd(across)[2][0]
        shape = shape @ _turn_to_x(direction if direction[0] > 0 else -direction).T
    return shape


def _centred(shape: Float64) -> Float64:
    shape = shape - shape.mean(axis=0)
    return np.asarray(shape / np.sqrt((shape**2).sum()))


def _turn_to_x(direction: Float64) -> Float64:
    """The smallest rotation (3, 3) that turns a unit vector to x."""
    axis = np.cross(direction, [1.0, 0.0, 0.0])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1 + direction[0]))


def _onto(rigid: Float64, shape: Float64) -> tuple[Float64, Float64, Float64]:
    """Rotation (T, 3, 3), scale (T,) and centre (T, 3) that lay frames (T, R, 3) on a shape."""
    center = rigid.mean(axis=1)
    around = rigid - center[:, None]
    u, _, v = np.linalg.svd(np.einsum("rk,trl->tkl", shape, around))
    sign = np.sign(np.linalg.det(u @ v))
    u[:, :, 2] *= sign[:, None]
    rotation = u @ v
    along = np.einsum("trk,rk->t", around @ rotation.transpose(0, 2, 1), shape)
    scale = along / np.maximum((around**2).sum(axis=(1, 2)), 1e-12)
    return rotation, scale, center


def _degrees(rotation: Float64, seen: Bool) -> Float32:
    """Yaw, pitch and roll against their medians; `rotation` turns each frame to the camera."""
    head = rotation.transpose(0, 2, 1)  # from the resting head to the turned one
    yaw = -np.degrees(np.arctan2(head[:, 0, 2], head[:, 2, 2]))
    pitch = np.degrees(np.arcsin(np.clip(head[:, 1, 2], -1, 1)))
    roll = np.degrees(np.arctan2(head[:, 1, 0], head[:, 1, 1]))
    turns = np.stack([yaw, pitch, roll], axis=1)
    return np.asarray(turns - np.median(turns[seen], axis=0), np.float32)
