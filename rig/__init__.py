"""Faces: controls, curves, formats and meshes. No torch, no audio, no HTTP."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rig.controls import Control, ControlSet, default_controls
    from rig.curves import RigCurves, concatenate, frames_to_time, rest_curves
    from rig.curves.edit import ClampReport, clamp, gain, smooth
    from rig.emotions import EMOTIONS, LABELS
    from rig.formats import WriteReport, read_curves, write_curves

__all__ = [
    "EMOTIONS",
    "LABELS",
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

_HOMES = {
    "controls": ("Control", "ControlSet", "default_controls"),
    "curves": ("RigCurves", "concatenate", "frames_to_time", "rest_curves"),
    "curves.edit": ("ClampReport", "clamp", "gain", "smooth"),
    "emotions": ("EMOTIONS", "LABELS"),
    "formats": ("WriteReport", "read_curves", "write_curves"),
}


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def __getattr__(name: str) -> Any:
    """Import a public name at its first use: a command line starts without pandas and scipy."""
    for home, names in _HOMES.items():
        if name in names:
            from importlib import import_module

            return getattr(import_module(f"rig.{home}"), name)
    raise AttributeError(f"module 'rig' has no attribute {name!r}")
