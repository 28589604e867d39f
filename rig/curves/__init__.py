"""Values of named controls over time, and edits of them."""

from rig.curves.rig_curves import (
    HEAD,
    RigCurves,
    check_clip,
    concatenate,
    frames_to_time,
    n_frames_for,
    rest_curves,
    snap_fps,
    time_to_frames,
)

__all__ = [
    "HEAD",
    "RigCurves",
    "check_clip",
    "concatenate",
    "frames_to_time",
    "n_frames_for",
    "rest_curves",
    "snap_fps",
    "time_to_frames",
]
