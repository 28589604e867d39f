"""Board curves whose ARKit shapes are wanted ones, near curves that are there already.

`raw_to_board` of `arkit_to_raw` gives the board that the shapes alone would give. A take moves
more than the shapes show, and values end at ranges: what is added there is lost in part. Here each
frame is corrected until its own shapes, fitted to it, are the wanted ones (Gauss-Newton with
differences), by the smallest change of the controls.
"""

from dataclasses import replace

import numpy as np

from rig.arrays import Float32, Float64, Int64
from rig.controls import default_controls
from rig.conversion.arkit import ARKIT_ID, arkit_controls, raw_to_arkit, shapes_together
from rig.conversion.convert import reached_controls
from rig.curves.rig_curves import RigCurves

CLOSE = 1e-4
"""Largest difference of a shape that is left."""
STEPS = 12
CHANGE = 0.02
"""Change of a control by which its effect on the shapes is measured."""
SMALLEST = 0.05
"""Least effect that is used, as a share of the largest."""
HALVINGS = 3
"""Most halvings of a step that comes no nearer."""
FRAMES_AT_ONCE = 512


def board_of_shapes(curves: RigCurves, wanted: RigCurves) -> RigCurves:
    """Correct board curves so that their ARKit shapes are the wanted ones, as far as they can be.

    Parameters
    ----------
    curves : RigCurves
        All controls of the default board.
    wanted : RigCurves
        Some of the 52 shapes of ARKit, of the same frames.

    Returns
    -------
    RigCurves
        Frames whose shapes are the wanted ones already are not changed. Shapes that no pose of the
        board has come as near as they can.
    """
    values = curves.values.astype(float)
    for first in range(0, len(curves), FRAMES_AT_ONCE):
        part = slice(first, first + FRAMES_AT_ONCE)
        _correct(values[part], wanted.values[part], wanted.names)
    return replace(curves, values=values.astype(np.float32))


def shapes_of(values: Float64, names: tuple[str, ...]) -> Float32:
    """ARKit shapes [shape=(T, N)] of board values (T, C)."""
    board = RigCurves(values.astype(np.float32), default_controls().names, fps=30.0)
    return raw_to_arkit(board).curves.values[:, arkit_controls().indices(names)]


def _correct(values: Float64, wanted: Float32, names: tuple[str, ...]) -> None:
    board = default_controls()
    missed = (wanted - shapes_of(values, names)).astype(np.float64)
    for _ in range(STEPS):
        rows = np.flatnonzero(np.abs(missed).max(axis=1) > CLOSE)
        if not len(rows):
            return
        off = np.abs(missed[rows]).max(axis=0) > CLOSE
        moving = shapes_together(name for name, is_off in zip(names, off, strict=True) if is_off)
        columns = board.indices(reached_controls(moving, ARKIT_ID))
        step = _step(values[rows], missed[rows], columns, names)
        moved, share, better = rows, 1.0, 0
        for _ in range(HALVINGS):
            tried = values[moved]
            tried[:, columns] = np.clip(
                tried[:, columns] + share * step, board.minimum[columns], board.maximum[columns]
            )
            left = wanted[moved] - shapes_of(tried, names)
            is_better = np.square(left).sum(axis=1) < np.square(missed[moved]).sum(axis=1) - 1e-12
            values[moved[is_better]], missed[moved[is_better]] = tried[is_better], left[is_better]
            better += int(is_better.sum())
            moved, step, share = moved[~is_better], step[~is_better], share / 4
            if not len(moved):
                break
        if not better:
            return


def _step(values: Float64, missed: Float64, columns: Int64, names: tuple[str, ...]) -> Float64:
    """Smallest change of some columns that makes up for missed shapes (T, N), to first order."""
    board = default_controls()
    moved = np.repeat(values[None], 2 * len(columns), axis=0)
    for place, column in enumerate(columns):
        moved[2 * place, :, column] += CHANGE
        moved[2 * place + 1, :, column] -= CHANGE
    np.clip(moved, board.minimum, board.maximum, out=moved)
    shapes = shapes_of(moved.reshape(-1, len(board)), names).reshape(*moved.shape[:2], -1)
    apart = [moved[2 * k, :, c] - moved[2 * k + 1, :, c] for k, c in enumerate(columns)]
    effects = (shapes[::2] - shapes[1::2]) / np.maximum(apart, 1e-9)[:, :, None]
    inverse = np.linalg.pinv(effects.transpose(1, 2, 0), rcond=SMALLEST)
    found: Float64 = (inverse @ missed[:, :, None])[:, :, 0]
    return found
