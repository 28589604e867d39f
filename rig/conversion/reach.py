"""Board channels that a source of curves can move at all: what a capture can know.

A Live Link Face take of all shapes reaches 73 of 185 channels; the tongue, the lip bite and the
teeth are not among them, and their values at rest are no measurement.
"""

from collections.abc import Iterable

from rig.controls import DEFAULT_ID, default_controls
from rig.conversion.arkit import ARKIT_ID, arkit_controls, raw_curves_of_shapes
from rig.conversion.convert import KNOWN
from rig.conversion.raw import RAW_ID, board_of_raw_curves, raw_controls
from rig.errors import ControlError


def reached_controls(names: Iterable[str], control_set: str) -> tuple[str, ...]:
    """Return the board channels that some curves move, in the order of the board.

    Parameters
    ----------
    names : iterable of str
        Columns of a source, in any known spelling.
    control_set : str
        The set they belong to: board, raw curves or ARKit shapes.

    Raises
    ------
    ControlError
        If the set or a name is unknown.
    """
    if control_set == ARKIT_ID:
        reached = board_of_raw_curves(raw_curves_of_shapes(arkit_controls().resolve(list(names))))
    elif control_set == RAW_ID:
        reached = board_of_raw_curves(raw_controls().resolve(list(names)))
    elif control_set == DEFAULT_ID:
        reached = set(default_controls().resolve(list(names)))
    else:
        raise ControlError(f"control set {control_set!r} is unknown; known: {', '.join(KNOWN)}")
    return tuple(name for name in default_controls().names if name in reached)
