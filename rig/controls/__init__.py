"""The controls of a face: names, ranges, rest values, mirrors and spellings."""

from rig.controls.control_set import DEFAULT_ID, Control, ControlSet, check_unique, default_controls

__all__ = ["DEFAULT_ID", "Control", "ControlSet", "check_unique", "default_controls"]
