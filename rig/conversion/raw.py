"""Board channels to the 251 raw curves ``CTRL_expressions_*`` of a MetaHuman face, and back.

Raw curves are the input of Unreal's RigLogic; an AnimSequence stores them, not the board. Each is a
clamped piecewise linear function of one board channel, given by its knots in ``raw.csv``. Ranges
and slopes are facts of the mh4 rig: Epic's MetaHuman-DNA-Calibration assembles the rig from them.
(A mapper file of Live Link Face disagrees in one: it takes ``mouthRight`` from the positive half of
``CTRL_C_mouth.tx``, which gives negative values; the rig takes it from the negative half.)

``CTRL_C_eye`` moves both eyes: it is added to ``CTRL_L_eye`` and ``CTRL_R_eye``. The way back gives
the sum to each eye. Switches, multipliers and ``lipsPressD`` move no raw curve; the way back rests
them. ``noseWrinkleUpper`` rests at 1 here as on the board.
"""

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Float32
from rig.controls import DEFAULT_ID, Control, ControlSet, default_controls
from rig.curves import RigCurves
from rig.files.reading import rows_of

RAW_ID = "metahuman-raw-251@mh4"
PREFIX = "CTRL_expressions_"
BOTH_EYES = {f"CTRL_{side}_eye.t{axis}": f"CTRL_C_eye.t{axis}" for side in "LR" for axis in "xy"}
OLDER_TONGUE = {
    "tongueBendUp": "tongueRollUp",
    "tongueBendDown": "tongueRollDown",
    "tongueTwistLeft": "tongueRollLeft",
    "tongueTwistRight": "tongueRollRight",
}
"""Names of the mh3 rig for the same movements."""


@cache
def raw_controls() -> ControlSet:
    """Return the 251 raw curves, all in [0, 1], ``metahuman-raw-251@mh4``.

    Names without the prefix resolve too.
    """
    return ControlSet(
        RAW_ID,
        tuple(
            Control(
                PREFIX + row["name"],
                rest=float(row["rest"]),
                aliases=(row["name"],),
                mh3_name=PREFIX + OLDER_TONGUE[row["name"]] if row["name"] in OLDER_TONGUE else "",
            )
            for row in rows_of("conversion/raw.csv")
        ),
    )


def board_to_raw(curves: RigCurves) -> RigCurves:
    """Convert board channels to all 251 raw curves.

    Parameters
    ----------
    curves : RigCurves
        Of the default board; channels that are absent rest.

    Returns
    -------
    RigCurves
        Of `raw_controls`, values in [0, 1].
    """
    board = curves.reorder(default_controls())
    raw = raw_controls()
    values = np.empty((len(curves), len(raw)), np.float32)
    for driver, (columns, inputs, outputs) in _paths().items():
        both = BOTH_EYES.get(driver)
        x = board[driver] if both is None else np.clip(board[driver] + board[both], -1, 1)
        for column, output in zip(columns, outputs.T, strict=True):
            values[:, column] = np.interp(x, inputs, output)
    return replace(board, values=values, names=raw.names, control_set=RAW_ID)


def raw_to_board(curves: RigCurves) -> RigCurves:
    """Convert raw curves to the board channels that come nearest to them.

    The raw curves of one channel trace a path as the channel moves; each frame takes the nearest
    point of it (least squares). On the path this is the exact inverse, but for two cases:
    ``CTRL_C_neck_swallow`` at 1 becomes 0, and the gaze of `BOTH_EYES` is added to each eye.

    Parameters
    ----------
    curves : RigCurves
        Raw curves; those that are absent rest.

    Raises
    ------
    ControlError
        If a curve is no raw curve.
    """
    raw = curves.reorder(raw_controls())
    board = default_controls()
    values = np.tile(board.rest, (len(curves), 1))
    for driver, (columns, inputs, outputs) in _paths().items():
        # Return the input of the nearest point on a path [points shape=(T, curves)].
        points = raw.values[:, columns]
        best = np.full(len(points), np.inf, np.float32)
        x = np.zeros(len(points), np.float32)
        for i in range(len(inputs) - 1):
            start, step = outputs[i], outputs[i + 1] - outputs[i]
            along = np.clip((points - start) @ step / (step @ step), 0, 1)
            distance = ((points - start - along[:, None] * step) ** 2).sum(axis=1)
            is_nearer = distance < best
            best = np.where(is_nearer, distance, best)
            x = np.where(is_nearer, inputs[i] + along * (inputs[i + 1] - inputs[i]), x)
        values[:, board.index(driver)] = x
    return replace(raw, values=values, names=board.names, control_set=DEFAULT_ID)


def raw_knots() -> dict[str, tuple[str, tuple[list[float], list[float]]]]:
    """Return, by raw curve, its board channel and its knots: places there, and values."""
    return {
        PREFIX + row["name"]: (row["driver"], _knots(row["knots"]))
        for row in rows_of("conversion/raw.csv")
    }


def board_of_raw_curves(names: Iterable[str]) -> set[str]:
    """Return the board channels that move at least one of some raw curves."""
    raw, wanted = raw_controls(), set(names)
    return {
        driver
        for driver, (columns, _, _) in _paths().items()
        if any(raw.names[i] in wanted for i in columns)
    }


@cache
def _paths() -> dict[str, tuple[NDArray[np.intp], Float32, Float32]]:
    """Return, by board channel: its raw columns, its knots (K,), and their values (K, columns)."""
    by_driver: dict[str, list[tuple[int, str]]] = {}
    for column, row in enumerate(rows_of("conversion/raw.csv")):
        by_driver.setdefault(row["driver"], []).append((column, row["knots"]))
    paths = {}
    for driver, curves in by_driver.items():
        knots = [_knots(text) for _, text in curves]
        inputs = np.array(sorted({0.0, *(place for x, _ in knots for place in x)}))
        outputs = np.stack([np.interp(inputs, x, y) for x, y in knots], axis=1)
        columns = np.array([column for column, _ in curves], np.intp)
        paths[driver] = (columns, inputs.astype(np.float32), outputs.astype(np.float32))
    return paths


def _knots(text: str) -> tuple[list[float], list[float]]:
    pairs = [pair.split(":") for pair in text.split()]
    return [float(x) for x, _ in pairs], [float(y) for _, y in pairs]
