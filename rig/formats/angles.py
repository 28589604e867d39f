"""Angles of head and eyes: degrees or radians, told by how far a face turns."""

from collections.abc import Sequence

import numpy as np

from rig.arrays import Float32
from rig.conversion.arkit import HEAD, HEAD_DEGREES
from rig.errors import FormatError

MOST_DEGREES = 90.0
"""Turn of a head or an eye from straight ahead."""
MOST_RADIANS = np.pi / 2
WIDE_RADIANS = 0.9
"""Turn of a head that is said: as degrees it would be a head that is held still."""
EYE_RADIANS = 1.1
"""Turn of an eye that exceeds its reach."""


def as_live_link(values: Float32, names: Sequence[str], where: object) -> tuple[Float32, list[str]]:
    """Values with head and eyes as Live Link has them, nearly radians, and notes."""
    head = [i for i, name in enumerate(names) if name in HEAD]
    eyes = [i for i, name in enumerate(names) if "Eye" in name and name not in HEAD
            and name.endswith(("Yaw", "Pitch", "Roll"))]  # fmt: skip
    head_top, eye_top = (_top(values, places) for places in (head, eyes))
    notes: list[str] = []
    by_degrees = [(HEAD.index(names[i]), i) for i in head]
    if head_top > MOST_RADIANS or (eye_top > EYE_RADIANS and head_top > 0):
        values = values.copy()
        turned = half_turns(values[:, head], "the head", where)
        per_value = np.abs([HEAD_DEGREES[place] for place, _ in by_degrees])
        values[:, head] = turned / per_value
        notes.append(
            f"head angles are degrees, up to {_top(turned, range(len(head))):.3g}: taken as such"
        )
    elif head_top > WIDE_RADIANS:
        notes.append(
            f"the head turns by up to {head_top:.2g}: taken as radians, {np.degrees(head_top):.0f} "
            "degrees"
        )
    if eye_top > EYE_RADIANS:
        values = values.copy()
        values[:, eyes] = np.radians(half_turns(values[:, eyes], "an eye", where))
        notes.append("angles of the eyes are degrees: taken as such")
    return values, notes


def _top(values: Float32, places: Sequence[int]) -> float:
    return float(np.abs(values[:, list(places)]).max(initial=0))


def half_turns(degrees: Float32, what: str, where: object) -> Float32:
    """Degrees within half a turn; those of 0 to 360 are taken back."""
    is_whole_turn = degrees.min() >= 0 and MOST_DEGREES < degrees.max() <= 360
    turned: Float32 = (degrees + 180) % 360 - 180 if is_whole_turn else degrees
    beyond = np.abs(turned) > MOST_DEGREES
    if beyond.any():
        row, column = (int(i) for i in np.argwhere(beyond)[0])
        raise FormatError(
            f"{where}: data row {row + 1} turns {what} by {turned[row, column]:g} degrees, at most "
            f"{MOST_DEGREES:g}; write angles as radians or degrees from straight ahead"
        )
    return turned
