"""A filmed face to rig curves: landmarks, straightened, measured, repeated on the embedded head."""

from dataclasses import dataclass

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.data.video.head import HeadFace
from deitalk.data.video.landmarks import FaceTrack, at_rig_frames
from deitalk.data.video.measures import measure
from deitalk.data.video.pose import straightened
from deitalk.data.video.solve import shown_controls, solve_curves
from rig import RigCurves, default_controls
from rig.arrays import Bool, Float32
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
