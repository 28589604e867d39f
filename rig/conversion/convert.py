"""Conversion between the known control sets: board, raw curves, ARKit shapes, avatars' shapes."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial

import numpy as np

from rig.arrays import AnyFloat
from rig.controls import DEFAULT_ID, ControlSet, default_controls
from rig.conversion.arkit import (
    ARKIT_ID,
    arkit_controls,
    arkit_to_raw,
    raw_curves_of_shapes,
    raw_to_arkit,
)
from rig.conversion.avatars import AVATARS, avatar_controls, avatar_to_raw, raw_to_avatar
from rig.conversion.raw import RAW_ID, board_of_raw_curves, board_to_raw, raw_controls, raw_to_board
from rig.conversion.shape_fit import shape_key
from rig.curves import RigCurves
from rig.errors import ControlError, FormatError, listed

KNOWN: dict[str, Callable[[], ControlSet]] = {
    DEFAULT_ID: default_controls,
    RAW_ID: raw_controls,
    ARKIT_ID: arkit_controls,
    **{avatar: partial(avatar_controls, avatar) for avatar in AVATARS},
}
_TO_RAW: dict[str, Callable[[RigCurves], RigCurves]] = {
    DEFAULT_ID: board_to_raw,
    RAW_ID: lambda curves: curves,
    ARKIT_ID: arkit_to_raw,
    **dict.fromkeys(AVATARS, avatar_to_raw),
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
    return convert_and_note(curves, control_set)[0]


def convert_and_note(curves: RigCurves, control_set: str) -> tuple[RigCurves, str]:
    """Convert as `convert`; return also a line on what the other set cannot show, or none."""
    if curves.control_set == control_set:
        return curves, ""
    if curves.control_set not in KNOWN or control_set not in KNOWN:
        raise ControlError(
            f"no conversion from control set {curves.control_set!r} to {control_set!r}; "
            f"known: {', '.join(KNOWN)}; keep a rig of your own as .csv, .json or .npz"
        )
    if control_set == ARKIT_ID and curves.control_set == DEFAULT_ID:
        fit = raw_to_arkit(curves)  # in pieces, so that an hour fits
        return fit.curves, str(fit)
    raw = _TO_RAW[curves.control_set](curves)
    if control_set == ARKIT_ID:
        fit = raw_to_arkit(raw)
        return fit.curves, str(fit)
    if control_set in AVATARS:
        shapes, found = raw_to_avatar(raw, control_set)
        return shapes, f"{control_set}: {found}"
    return (raw if control_set == RAW_ID else raw_to_board(raw)), ""


def unshown(curves: RigCurves, shown: Iterable[str], target: str) -> str:
    """Return a line on controls of the board that move and that a target does not show, or none."""
    names = set(shown) if curves.control_set == DEFAULT_ID else set(curves.names)
    lost = [name for name in curves.names if name not in names and np.ptp(curves[name]) > 1e-6]
    return f"{target} does not show {len(lost)} moving controls: {listed(lost)}" if lost else ""


def controls_of(names: Sequence[str], *, where: str) -> ControlSet:
    """Return the known control set that has all of some names.

    Raises
    ------
    ControlError
        If there is none; the message is that of the set with most of the names.
    """
    best = best_set(names)
    try:
        best.indices(names)
    except ControlError as error:
        raise ControlError(f"{where}: {error}") from None
    return best


def best_set(names: Sequence[str]) -> ControlSet:
    """Return the known control set with most of some names."""
    sets = [make() for make in KNOWN.values()]
    return max(sets, key=lambda controls: sum(name in controls for name in names))


def curves_of_shapes(
    names: Sequence[str],
    weights: AnyFloat,
    fps: float,
    where: str,
    controls: ControlSet | None = None,
) -> RigCurves:
    """Return the curves of the set with most of some names of shapes; its others rest.

    Parameters
    ----------
    names : sequence of str [length K]
        In any case of letters; unknown ones are left out.
    weights : array [shape=(T, K)]
        Of the shapes.
    fps : float
        Frames per second.
    where : str
        Beginning of a message.
    controls : ControlSet, optional
        The set; by default ARKit's, one of the avatars, or the raw curves.

    Raises
    ------
    FormatError
        If no set has any.
    """
    keys = [shape_key(name) for name in names]
    sets = [controls] if controls else [KNOWN[id]() for id in (ARKIT_ID, *AVATARS, RAW_ID)]
    found: list[list[int | None]] = []
    for known in sets:
        by_key = {shape_key(name): i for i, name in enumerate(known.names)}
        found.append([by_key.get(key) for key in keys])
    chosen, places = min(zip(sets, found, strict=True), key=lambda pair: pair[1].count(None))
    if places.count(None) == len(keys):
        raise FormatError(f"{where}: {', '.join(names[:4])} … are no shapes of ARKit or an avatar")
    values = np.tile(chosen.rest, (len(weights), 1))
    for column, place in enumerate(places):
        if place is not None:
            values[:, place] = weights[:, column]
    return RigCurves(values, chosen.names, fps, control_set=chosen.id)


def reached_controls(names: Iterable[str], control_set: str) -> tuple[str, ...]:
    """Return the board channels that some curves move, in the order of the board.

    That is what a capture can know. A Live Link Face take of all shapes reaches 73 of 185 channels;
    the tongue, the lip bite and the teeth are not among them: their rest is no measurement.

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
