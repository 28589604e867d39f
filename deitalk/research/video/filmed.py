"""A filmed face to rig curves: landmarks, straightened, measured, repeated on the embedded head."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.data.captures.take import VIDEOS, CapturedCurves
from deitalk.research.video.detector import Progress, track_face
from deitalk.research.video.head_face import HeadFace
from deitalk.research.video.landmarks import (
    FaceTrack,
    at_rig_frames,
    read_landmarks,
)
from deitalk.research.video.proportions import measure
from deitalk.research.video.solve import shown_controls, solve_curves
from deitalk.research.video.straighten import straightened
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


def read_capture(path: Path, progress: Progress) -> CapturedCurves:
    """Curves of the face in a video, or of a file of its landmarks; errors as `filmed_curves`."""
    is_video = path.suffix.lower() in VIDEOS
    found = filmed_curves(
        track_face(path, progress) if is_video else read_landmarks(path), str(path)
    )
    return CapturedCurves(found.curves, found.known, "video", notes=found.notes, seen=found.seen)


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
