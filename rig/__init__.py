"""What a face is: controls, curves, formats, meshes. No torch, no audio, no HTTP."""

from rig.controls import Control, ControlSet, default_controls
from rig.curves import EMOTIONS, RigCurves, concatenate, frames_to_time, rest_curves
from rig.edit import ClampReport, clamp, gain, smooth
from rig.formats import WriteReport, read_curves, write_curves

__all__ = [
    "EMOTIONS",
    "ClampReport",
    "Control",
    "ControlSet",
    "RigCurves",
    "WriteReport",
    "clamp",
    "concatenate",
    "default_controls",
    "frames_to_time",
    "gain",
    "read_curves",
    "rest_curves",
    "smooth",
    "write_curves",
]
