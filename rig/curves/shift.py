"""Curves moved in time by frames, with frames added before and after."""

from dataclasses import replace

import numpy as np

from rig.curves import RigCurves
from rig.errors import CurveError, quoted
from rig.limits import MOST_DELAY, MOST_HANDLES

DAY_SECONDS = 24 * 3600.0


def checked_shift(delay: int, handles: int) -> None:
    """Refuse a delay or handles out of range.

    Raises
    ------
    CurveError
        If one is no whole number, or beyond `MOST_DELAY` or `MOST_HANDLES`.
    """
    rows = (("delay", delay, -MOST_DELAY, MOST_DELAY), ("handles", handles, 0, MOST_HANDLES))
    for name, value, low, high in rows:
        if type(value) is not int or not low <= value <= high:
            raise CurveError(
                f"{name} {quoted(value)} must be a whole number of frames, {low} to {high}",
                parameter=name,
            )


def shift(curves: RigCurves, delay: int = 0, handles: int = 0) -> RigCurves:
    """Move the face against the sound, and add frames that hold its first and last pose.

    Parameters
    ----------
    curves : RigCurves
        At the rate whose frames are meant.
    delay : int
        Frames by which the face is late; early if negative. The length stays: the pose of the
        first or last frame is held.
    handles : int
        Frames added before and after.

    Raises
    ------
    CurveError
        As `checked_shift`.
    """
    checked_shift(delay, handles)
    if not (delay or handles) or not len(curves):
        return curves
    count = len(curves)
    moved = np.clip(np.arange(count) - delay, 0, count - 1)
    rows = moved[np.clip(np.arange(-handles, count + handles), 0, count - 1)]
    tracks = {name: track[rows] for name, track in curves.tracks.items()}
    return replace(curves, values=curves.values[rows], **tracks)  # type: ignore[arg-type]


def unshifted(curves: RigCurves, delay: int = 0, handles: int = 0) -> RigCurves:
    """Undo `shift`: frames that it cut hold the pose beside them.

    Raises
    ------
    CurveError
        As `checked_shift`.
    """
    checked_shift(delay, handles)
    return shift(curves[handles : len(curves) - handles], -delay)


def start_with_handles(start: float, handles: int, fps: float) -> float:
    """Time of day of the first frame with handles, seconds; 0 is no time and stays."""
    return (start - handles / fps) % DAY_SECONDS if start else start
