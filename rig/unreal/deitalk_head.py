"""Keys of the head's turn on a body control rig in Unreal, run inside the editor.

Lies beside ``deitalk_unreal.py`` and needs nothing else::

    import deitalk_head as h
    h.head_control(r"C:/take/speech.unreal.json", dry_run=True)
    h.head_control(r"C:/take/speech.unreal.json")            # head_ctrl of MetaHuman_ControlRig

A control turns about axes of its own, taken here as those of the head's bone: x up, y forward, z to
its right. That was not tried in the editor; if the head turns another way, name the axes or their
signs, ``axes="x,y,-z"``.
"""

from __future__ import annotations

import re
from fractions import Fraction

import deitalk_clip  # type: ignore[import-not-found]
import deitalk_unreal as importer  # type: ignore[import-not-found]

BODY = "MetaHuman_ControlRig"
CONTROL = "head_ctrl"
AXES = "x,y,z"
"""Channels of the rotation that `TURNS` are keyed on."""
TURNS = ("HeadRoll", "HeadPitch", "HeadYaw")
"""Curves of the turn to the left, of the tilt to the right shoulder and of the nod."""


def head_control(
    path: str,
    sequence: str = "",
    rig: str = BODY,
    control: str = CONTROL,
    start_frame: int = 0,
    axes: str = AXES,
    dry_run: bool = False,
) -> list[str]:
    """Key the rotation of the head's control in a Level Sequence, in degrees.

    Parameters
    ----------
    path : str
        A ``*.unreal.json`` with a head track.
    sequence : str
        Asset path of the Level Sequence; the one open in Sequencer if it is empty.
    rig, control : str
        Name of the control rig, whose track must be in the sequence, and of its control.
    start_frame : int
        First frame, in the sequence's display rate.
    axes : str
        Axes of turn, tilt and nod, each x, y or z, with a minus to turn the other way.
    dry_run : bool
        Print what would be done and change nothing.

    Returns
    -------
    list of str
        Channels that were keyed.
    """
    data = deitalk_clip.load(path)
    if any(name not in data["raw"] for name in TURNS):
        raise importer.DeitalkError(f"{path} has no head track; animate without --life head=0")
    turns = dict(zip(_axes(axes), TURNS))  # noqa: B905  (Python 3.9)
    for (axis, sign), name in turns.items():
        described = deitalk_clip.describe(data["raw"][name])
        importer.say(f"{control} rotation {'-' if sign < 0 else ''}{axis}: {name}, {described}")
    if dry_run:
        return []
    importer.need_unreal()
    level_sequence = importer.find_sequence(sequence)
    section = importer.channels_of_rig(importer.find_proxy(level_sequence, rig))
    display = level_sequence.get_display_rate()
    fps = Fraction(display.numerator, display.denominator)
    last = start_frame + deitalk_clip.frame_count(data, fps) - 1
    names = {
        f"{control}.rotation.{axis}".lower(): (sign, name) for (axis, sign), name in turns.items()
    }
    missing = [name for name in names if name not in section]
    if missing:
        raise importer.DeitalkError(f"{rig} has no channel {missing[0]}; name its head's control")
    with importer.unreal.ScopedEditorTransaction("deitalk: keys on the head"):
        for channel, (sign, name) in names.items():
            values = [sign * v for v in deitalk_clip.resampled(data, data["raw"][name], fps)]
            importer.write_channel(section[channel], values, start_frame, last)
    importer.say(f"keyed {', '.join(names)}, frames {start_frame} to {last}")
    return list(names)


def _axes(text: str) -> list[tuple[str, float]]:
    """Axes and signs of turn, tilt and nod."""
    parts = [part.strip() for part in text.lower().split(",")]
    found = [re.fullmatch("(-?)([xyz])", part) for part in parts]
    if len(parts) != 3 or None in found or len({part[-1] for part in parts}) != 3:
        raise importer.DeitalkError(f"axes {text!r}: three of x, y and z, such as {AXES}")
    return [(part[-1], -1.0 if part.startswith("-") else 1.0) for part in parts]
