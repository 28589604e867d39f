"""Curves at uneven times onto an even grid."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Bool, Float64
from rig.curves import check_clip
from rig.curves.rig_curves import STANDARD_RATES
from rig.errors import FormatError
from rig.limits import GAP_FRAMES, GAP_SHARE

UNEVEN = 0.1
"""Share of a step by which steps may differ without being put on an even grid."""
LONGEST_GAP_SECONDS = 1.0
"""Time without a frame that is bridged by a straight line."""


def rate_of(seconds: Float64) -> float:
    """Frames per second of rising times: of the steps near the median one.

    The nearest whole or standard rate where the digits of the times cannot tell it apart.
    """
    steps = np.diff(seconds)
    if not len(steps):
        return 30.0
    median = float(np.median(steps))
    usual = usual_steps(steps)
    rate = 1 / float(usual.mean())
    resolution = 0.0
    for digit in (1e-5, 1e-4, 1e-3, 1e-2):
        past = (seconds - seconds[0]) / digit
        if (np.abs(past - np.rint(past)) < 1e-3).all():
            resolution = digit
    near = float(np.clip(resolution / usual.sum(), 2e-5, 5e-4)) * rate
    if np.ptp(steps) > UNEVEN * median:  # they are put on a grid, whose rate is free
        near = 3e-3 * rate
    for standard in (round(rate), *STANDARD_RATES):
        if standard and abs(rate - standard) <= near:
            return float(standard)
    rounded = round(rate, 4)
    return rounded if rounded and abs(rounded - rate) < 2e-5 * rate else rate


def usual_steps(steps: NDArray[np.number[Any]]) -> Float64:
    """Steps within a quarter of the median one, or that one where none is."""
    median = float(np.median(steps))
    near = steps[np.abs(steps - median) <= 0.25 * median]
    return np.asarray(near if len(near) else [median], np.float64)


def even(
    path: Path, values: Float64, seconds: Float64, fps: float
) -> tuple[Float64, Bool | None, list[str]]:
    """Rows at uneven times on an even grid that begins with the first one.

    Parameters
    ----------
    path : Path
        Beginning of a message.
    values : array [shape=(T, N)]
        NaN in rows without a face.
    seconds : array [shape=(T,)]
        Rising.
    fps : float
        Rate of the grid.

    Returns
    -------
    values : array [shape=(F, N)]
    seen : array of bool [shape=(F,)] or None
        Frames within `LONGEST_GAP_SECONDS` of a gap, or of a face; None: all.
    notes : list of str

    Raises
    ------
    FormatError
        If no row has a face, or most of the time has none.
    """
    faces: Bool = np.ones(len(values), bool)
    if values.shape[1]:
        faces = np.asarray(~np.isnan(values).all(axis=1), bool)
    if not faces.any():
        raise FormatError(f"{path}: no row has a face; every cell is empty")
    notes: list[str] = []
    steps = np.diff(seconds)
    is_even = not len(steps) or np.ptp(steps) <= UNEVEN * float(np.median(steps))
    if is_even and faces.all():
        return values, None, notes
    grid = grid_over(seconds, fps, values.shape[1], path)
    known, rows = seconds[faces], values[faces]
    filled = np.stack([np.interp(grid, known, column) for column in rows.T], axis=1)
    if not is_even:
        notes.append(
            f"frames {steps.min() * 1000:.3g} to {steps.max() * 1000:.3g} ms apart, put on "
            f"{fps:g} fps"
        )
    seen = seen_of(grid, known, fps)
    if not faces.all():
        notes.append(f"{int((~faces).sum())} of {len(faces)} rows are without a face")
    return filled, None if seen.all() else seen, notes


def grid_over(seconds: Float64, fps: float, n_curves: int, where: object) -> Float64:
    """Even times [shape=(F,)] from the first to the last of rising ones.

    Raises
    ------
    FormatError, CurveError
        If most of the time has no frame, or there are more frames than `limits.FRAMES`.
    """
    n_frames = int((seconds[-1] - seconds[0]) * fps + 0.5) + 1
    most = GAP_FRAMES + GAP_SHARE * len(seconds)
    if n_frames > most:
        raise FormatError(
            f"{where}: {len(seconds)} frames last {n_frames}; at most {most} are made of them: cut "
            "the take where nothing was recorded"
        )
    check_clip(n_frames, n_curves)
    return np.asarray(seconds[0] + np.arange(n_frames) / fps)


def seen_of(grid: Float64, known: Float64, fps: float) -> Bool:
    """Frames of a grid that were captured: not in a long gap, nor before or after all rows."""
    seen = (grid >= known[0] - 0.5 / fps) & (grid <= known[-1] + 0.5 / fps)
    for gap in np.flatnonzero(np.diff(known) > LONGEST_GAP_SECONDS):
        seen[(grid > known[gap]) & (grid < known[gap + 1])] = False
    return np.asarray(seen, bool)
