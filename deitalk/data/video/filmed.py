"""A filmed face to rig curves: landmarks, straightened, measured, repeated on the embedded head."""

from dataclasses import dataclass

import numpy as np
import torch

from deitalk.audio.frames import FRAME_RATE
from deitalk.data.lip_fit import nearest_curves
from deitalk.data.video.landmarks import LIDS, PLACE, RIGID, RIGID_MIRROR, FaceTrack, at_rig_frames
from deitalk.data.video.measures import MEASURES, SIDES, HeadFace, Measured, measure
from rig import ControlSet, RigCurves, default_controls
from rig.arrays import Bool, Float32, Float64
from rig.face.head import build_head

SIDEWAYS_DEGREES = 30.0
"""Yaw from which on the far side of the face is guessed by the detector."""
SIDEWAYS_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class Filmed:
    """Curves of a filmed face.

    Parameters
    ----------
    curves : RigCurves
        T frames at 30 per second, with the turn of the head.
    known : tuple of str
        Controls that landmarks show.
    seen : array of bool [shape=(T,)]
        Frames with a face; the others hold the nearest ones' values.
    notes : tuple of str
        What a user should know.
    """

    curves: RigCurves
    known: tuple[str, ...]
    seen: Bool
    notes: tuple[str, ...]


def filmed_curves(track: FaceTrack, where: str) -> Filmed:
    """Curves of a face whose landmarks are measured.

    Parameters
    ----------
    track : FaceTrack
        At any rate.
    where : str
        Name of the video, for messages.

    Raises
    ------
    DataError
        If the face is in too few frames, or the rate is too low.
    """
    even, seen = at_rig_frames(track, where)
    straight, degrees = straightened(even, seen)
    face, controls = HeadFace(build_head()), default_controls()
    measured = measure(straight, seen, face)
    values = solve_curves(measured, face, controls)
    head = np.pad(degrees, ((0, 0), (0, 3)))
    curves = RigCurves(values, controls.names, float(FRAME_RATE), head=head)
    known = shown_controls(controls, gaze=measured.gaze is not None)
    return Filmed(curves, known, seen, (*track.notes, *measured.notes, *_notes(degrees, seen)))


def _notes(degrees: Float32, seen: Bool) -> list[str]:
    notes = []
    if not seen.all():
        notes.append(f"no face in {1 - seen.mean():.0%} of the frames, left out")
    aside = float((np.abs(degrees[seen, 0]) > SIDEWAYS_DEGREES).mean())
    if aside > SIDEWAYS_SHARE:
        notes.append(
            f"the head is turned more than {SIDEWAYS_DEGREES:.0f} degrees in {aside:.0%} of the "
            "frames, sides there are guessed"
        )
    return notes


# Landmarks without the head's motion, and the head's turn, from one camera.
#
# Every frame is turned, scaled and shifted onto the person's mean shape by the points that move
# with the skull (least squares over rotations, Umeyama 1991, IEEE PAMI 13(4):376, eq. 40-43). The
# mean shape is made symmetric, so that its middle plane faces the camera.
#
# Letters: T frames, P points, R rigid points.


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


# Rig curves that repeat measured faces on the embedded head.
#
# Letters: T frames at 30 per second, C controls, M measures.


LOOSENESS = {
    "CTRL_C_jaw.ty": 0.5,
    "CTRL_C_jaw.tx": 0.15,
    "CTRL_C_mouth.tx": 0.15,
    "mouth_upperLipRaise": 0.4,
    "mouth_lowerLipDepress": 0.4,
    "mouth_cornerPull": 0.4,
    "mouth_cornerDepress": 0.3,
    "mouth_stretch.ty": 0.3,
    "mouth_funnel": 0.3,
    "mouth_purse": 0.3,
    "mouth_lipsTogether": 0.6,
    "brow_down": 0.4,
    "brow_lateral": 0.3,
    "brow_raiseIn": 0.5,
    "brow_raiseOut": 0.5,
    "eye_blink": 0.6,
    "eye_squintInner": 0.3,
}
"""Controls that landmarks show, by parts of their names, and how far they readily move."""
GAZE = tuple(f"CTRL_{side}_eye.{axis}" for axis in ("tx", "ty") for side in SIDES)
TOLERANCE_CM = {
    "opening": 0.02,
    "jaw": 0.2,
    "edge": 0.12,
    "brow_squeeze": 0.12,
    "lower_lid": 0.08,
}
"""Error of a measure that costs as much as a control moved by its looseness, by parts of names:
the detector places the rims of lips and lids well, chin and outer edges of the lips less so."""
USUAL_TOLERANCE_CM = 0.04
CHUNK = 1000
"""Frames that are solved at a time."""


def shown_controls(controls: ControlSet, *, gaze: bool) -> tuple[str, ...]:
    """Controls that landmarks determine: no tongue, teeth, lip bite or cheeks."""
    return tuple(
        name
        for name in controls.names
        if any(part in name for part in LOOSENESS) or (gaze and name in GAZE)
    )


def solve_curves(measured: Measured, face: HeadFace, controls: ControlSet) -> Float32:
    """Curves near rest with which the head does what was measured [shape=(T, C)].

    Bounded least squares (`deitalk.data.lip_fit.nearest_curves`): squared errors of the measures
    over `TOLERANCE_CM` plus squared controls over `LOOSENESS`, within the ranges of the controls.
    The gaze is not solved for but taken, since lids follow it.

    Parameters
    ----------
    measured : Measured
        T frames.
    face : HeadFace
        The head.
    controls : ControlSet
        The default board.
    """
    n_frames = len(measured.displacements)
    prior = torch.tensor(np.tile(controls.rest, (n_frames, 1))).float()
    if measured.gaze is not None:
        for name in GAZE:
            column = measured.gaze[:, int(name.endswith(".ty"))]
            prior[:, controls.index(name)] = torch.from_numpy(column.copy())
    loose = torch.tensor(
        [
            next((far for part, far in LOOSENESS.items() if part in name), 0.0)
            for name in controls.names
        ]
    )
    tolerance = torch.tensor(
        [
            next((far for part, far in TOLERANCE_CM.items() if part in name), USUAL_TOLERANCE_CM)
            for name in MEASURES
        ]
    )
    wanted = torch.from_numpy(measured.displacements)
    solved = [
        nearest_curves(
            prior[k : k + CHUNK], wanted[k : k + CHUNK], face, loose, tolerance, controls
        )
        for k in range(0, n_frames, CHUNK)
    ]
    values: Float32 = torch.cat(solved).numpy()
    return values
