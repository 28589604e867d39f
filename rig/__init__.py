"""What a face is: controls, curves, formats, meshes. No torch, no audio, no HTTP."""

from rig.controls import Control, ControlSet, default_controls
from rig.curves import EMOTIONS, RigCurves, concatenate, frames_to_time, rest_curves

__all__ = [
    "EMOTIONS",
    "Control",
    "ControlSet",
    "RigCurves",
    "concatenate",
    "default_controls",
    "frames_to_time",
    "rest_curves",
]
