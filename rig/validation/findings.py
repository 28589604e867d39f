"""A finding of a check; those on curves that never move, jump, or end with an open mouth."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from rig.arrays import AnyFloat
from rig.conversion.convert import known_controls
from rig.conversion.raw import PREFIX

Level = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """One finding.

    Parameters
    ----------
    level : str
        ``error``, ``warning`` or ``note``.
    path : Path
        The file.
    text : str
        One line.
    """

    level: Level
    path: Path
    text: str


Rows = list[tuple[Level, str]]
"""Findings on one file: level and text."""
OPEN_MOUTH = 0.1
"""Jaw opening at the end of a clip above which a warning is given."""
JUMP = 0.8
"""Share of a control's range that is too far for one frame."""
MOUTH_SHAPES = ("JawOpen", "CTRL_C_jaw.ty", f"{PREFIX}jawOpen")


def motion(values: AnyFloat, names: tuple[str, ...], control_set: str) -> Rows:
    """Find curves that never move, jumps, and a mouth that stays open at the end."""
    findings: Rows = []
    dead = [name for name, still in zip(names, np.ptp(values, axis=0) < 1e-6, strict=True) if still]
    if len(dead) == len(names):
        findings.append(("warning", "no curve moves at all"))
    elif dead:
        text = f"{len(dead)} of {len(names)} curves never move ({', '.join(dead[:3])}, …)"
        findings.append(("note", text))
    controls = known_controls(control_set)
    if controls is not None and len(values) > 1:
        spans = {c.name: c.maximum - c.minimum for c in controls.controls}
        span = np.array([spans.get(name, np.inf) for name in names])
        steps = np.abs(np.diff(values, axis=0)) / span
        if steps.max() > JUMP:
            row, column = (int(i) for i in np.argwhere(steps > JUMP)[0])
            text = (
                f"{names[column]} jumps by {steps[row, column]:.0%} of its range at frame {row + 1}"
            )
            findings.append(("warning", text))
    for name in MOUTH_SHAPES:
        if name in names and values[-1, names.index(name)] > OPEN_MOUTH:
            text = f"the clip ends with the mouth open ({name} {values[-1, names.index(name)]:.2f})"
            findings.append(("warning", text))
    return findings
