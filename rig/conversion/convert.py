"""Conversion between the known control sets: board, raw curves, ARKit shapes."""

from collections.abc import Callable, Sequence

from rig.controls import DEFAULT_ID, ControlSet, default_controls
from rig.conversion.arkit import ARKIT_ID, arkit_controls, arkit_to_raw, raw_to_arkit
from rig.conversion.raw import RAW_ID, board_to_raw, raw_controls, raw_to_board
from rig.curves import RigCurves
from rig.errors import ControlError

KNOWN: dict[str, Callable[[], ControlSet]] = {
    DEFAULT_ID: default_controls,
    RAW_ID: raw_controls,
    ARKIT_ID: arkit_controls,
}
_STEPS: dict[tuple[str, str], Callable[[RigCurves], RigCurves]] = {
    (DEFAULT_ID, RAW_ID): board_to_raw,
    (RAW_ID, DEFAULT_ID): raw_to_board,
    (ARKIT_ID, RAW_ID): arkit_to_raw,
    (RAW_ID, ARKIT_ID): lambda curves: raw_to_arkit(curves).curves,
    (DEFAULT_ID, ARKIT_ID): lambda curves: raw_to_arkit(curves).curves,
}


def known_controls(control_set: str) -> ControlSet | None:
    """Return a control set by its id, or None for a user's own."""
    make = KNOWN.get(control_set)
    return None if make is None else make()


def convert(curves: RigCurves, control_set: str) -> RigCurves:
    """Convert curves to another control set, through the raw curves where needed.

    Raises
    ------
    ControlError
        If there is no conversion between the two sets.
    """
    if curves.control_set == control_set:
        return curves
    direct = _STEPS.get((curves.control_set, control_set))
    if direct is not None:
        return direct(curves)
    to_raw = _STEPS.get((curves.control_set, RAW_ID))
    from_raw = _STEPS.get((RAW_ID, control_set))
    if to_raw is None or from_raw is None:
        raise ControlError(
            f"no conversion from control set {curves.control_set!r} to {control_set!r}; "
            f"known: {', '.join(KNOWN)}; keep a rig of your own as .csv, .json or .npz"
        )
    return from_raw(to_raw(curves))


def controls_of(names: Sequence[str], *, where: str) -> ControlSet:
    """Return the known control set that has all of some names.

    Raises
    ------
    ControlError
        If there is none; the message is that of the set with most of the names.
    """
    sets = [make() for make in KNOWN.values()]
    known = [sum(name in controls for name in names) for controls in sets]
    best = sets[known.index(max(known))]
    if max(known) < len(names):
        unknown = next(name for name in names if name not in best)
        try:
            best.canonical(unknown)
        except ControlError as error:
            raise ControlError(f"{where}: {error}") from None
    return best
