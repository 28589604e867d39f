"""Units of what other programs write: shapes in percent, angles in degrees, times in milliseconds.

A unit is told by what a face can do: a shape goes little beyond its range, a head turns by at most
90 degrees, a face is captured at 1 to 300 frames a second. What is corrected becomes a note of the
curves; what fits no unit, or two, is an error.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Float32, Float64
from rig.controls import ControlSet
from rig.conversion.arkit import ARKIT_ID
from rig.curves import RigCurves
from rig.errors import FormatError, listed
from rig.formats.angles import as_live_link, half_turns
from rig.limits import FPS_HIGHEST, FPS_LOWEST

TIME_UNITS = (
    ("seconds", 1.0),
    ("milliseconds", 1e-3),
    ("microseconds", 1e-6),
    ("nanoseconds", 1e-9),
)
ROUNDED = 1.001
"""Factor on a step of rounded times."""


def seconds_of(
    times: Float64, rate: float | None, where: object, *, is_known: bool = False
) -> tuple[Float64, str]:
    """Convert times of frames to seconds; return them and a note (else empty).

    Times are seconds, milli-, micro- or nanoseconds, or numbers of frames; the step between frames
    decides.

    Parameters
    ----------
    times : array [shape=(T,)]
        As in the file.
    rate : float, optional
        Frames per second, of numbers of frames.
    where : object
        Beginning of a message: a path.
    is_known : bool
        Whether they are seconds for certain.

    Raises
    ------
    FormatError
        If times do not rise, numbers of frames have no rate, or the step is that of no capture.
    """
    steps = np.diff(times)
    if not len(steps):
        return times, ""
    if not (steps > 0).all():
        row = int(np.argmax(~(steps > 0))) + 2
        raise FormatError(f"{where}: data row {row} comes not after the one before; sort the times")
    step = float(np.sort(steps)[len(steps) // 2])  # np.median imports masked arrays
    if is_known:
        return times, ""
    if step == 1 and (times == np.rint(times)).all():
        if rate is None:
            raise FormatError(
                f"{where}: times go up by 1: they are numbers of frames, or frames are a second "
                "apart; give `fps`",
                parameter="fps",
            )
        return times / rate, f"times are numbers of frames, at {rate:g} Hz"
    for name, unit in TIME_UNITS:
        if 1 / FPS_HIGHEST <= step * unit * ROUNDED and step * unit < 1 / FPS_LOWEST:
            return times * unit, "" if unit == 1 else f"times are taken as {name}"
    raise FormatError(
        f"{where}: frames are {step:g} apart; captures have {FPS_LOWEST:g} to {FPS_HIGHEST:g} "
        "frames a second in seconds, milliseconds, microseconds or nanoseconds: mend the times, or "
        "remove them and give `fps`",
        parameter="fps",
    )


def check_rate(fps: float, where: object) -> None:
    """Refuse the rate of a file at which no face is captured or animated.

    Raises
    ------
    FormatError
        If it is not from `FPS_LOWEST` to `FPS_HIGHEST`.
    """
    if not FPS_LOWEST <= fps <= FPS_HIGHEST:
        raise FormatError(
            f"{where}: {fps:g} frames a second; a face has {FPS_LOWEST:g} to {FPS_HIGHEST:g}: "
            "give the rate (deitalk convert: `source_fps`)",
            parameter="source_fps",
        )


OVERSHOOT = 1.5
"""Factor of the end of a range by less than which calibrated captures exceed it."""
CLEARLY = 3.0
"""Factor of the end of a range by which no capture exceeds it."""
QUIET = 0.2
"""Peak from which on a column within its range may be of another unit than the others."""
PERCENT, OVER_PERCENT, BYTE = 100.0, 130.0, 255.0
FEW_QUIET, QUIET_SHARE = 3, 0.15
"""Such columns of shapes that hardly move, in percent, and their share of all that move."""
SIDES_APART = 20.0
"""Ratio of the peaks of left and right from which on they are in different units."""


def in_units(curves: RigCurves, controls: ControlSet, where: object) -> RigCurves:
    """Curves of a known set with shapes in their ranges, and angles as the set has them.

    Parameters
    ----------
    curves : RigCurves
        As in the file.
    controls : ControlSet
        Their set.
    where : object
        Beginning of a message: a path.

    Returns
    -------
    RigCurves
        With a note for each correction.

    Raises
    ------
    FormatError
        If values are far outside their ranges in no single unit, or the head turns by more than 90
        degrees.
    """
    if not len(curves):
        return curves
    places = controls.indices(curves.names)
    largest = np.maximum(np.abs(controls.minimum), np.abs(controls.maximum))[places]
    angles = np.array([name.endswith(("Yaw", "Pitch", "Roll")) for name in curves.names])
    angles &= controls.id == ARKIT_ID
    shapes = np.flatnonzero(~angles & (largest > 0))
    values, notes = curves.values, list(curves.notes)
    scale, note = _scale(curves, controls, shapes, largest[shapes], where)
    if scale != 1:
        values = values.copy()
        values[:, shapes] /= scale
        notes.append(note)
    if angles.any():
        values, said = as_live_link(values, curves.names, where)
        notes += said
    if curves.head is not None and len(curves.head):
        half_turns(curves.head[:, :3], "the head", where)
    if len(notes) == len(curves.notes):
        return curves
    return replace(curves, values=values, notes=tuple(notes))


def _scale(
    curves: RigCurves, controls: ControlSet, shapes: NDArray[np.intp], ends: Float32, where: object
) -> tuple[float, str]:
    """Divisor of the values, 1, 100 or 255, and a note."""
    if not len(shapes):
        return 1.0, ""
    values = curves.values[:, shapes]
    reach = np.maximum(ends, 1)  # percent of a smaller range is of 1, too
    peaks = (np.abs(values) / reach).max(axis=0)
    top = float(peaks.max())
    if top <= OVERSHOOT:
        return 1.0, ""
    names = [curves.names[i] for i in shapes]
    quiet = [name for name, peak in zip(names, peaks, strict=True) if QUIET < peak <= OVERSHOOT]
    count = int((peaks > QUIET).sum())
    few = min(max(FEW_QUIET, QUIET_SHARE * count), count - len(quiet))
    is_one_unit = len(quiet) <= few
    is_whole = bool((values == np.rint(values)).all())
    if top > CLEARLY and is_one_unit and not _sides_differ(names, peaks):
        if top <= PERCENT or (top <= OVER_PERCENT and not is_whole):
            also = [f"whole numbers to {top:g}, not 0 to 255"] if is_whole else []
            also += [f"{listed(quiet)} below 1.5 percent"] if quiet else []
            said = f" ({'; '.join(also)})" if also else ""
            return PERCENT, f"values are percent: divided by 100{said}"
        if OVER_PERCENT < top <= BYTE and is_whole:
            return BYTE, "values are 0 to 255: divided by 255"
        if top <= OVER_PERCENT:
            raise FormatError(
                f"{where}: values are whole numbers to {top:g}: percent beyond 100, or 0 to 255; "
                "divide them by 100 or 255"
            )
    if top <= CLEARLY:
        return 1.0, ""
    row, column = (int(i) for i in np.argwhere(np.abs(values) / reach > CLEARLY)[0])
    mixed = f", while {listed(quiet)} stay within theirs" if quiet else ""
    low = controls.minimum[controls.index(names[column])]
    raise FormatError(
        f"{where}: data row {row + 1}, column {names[column]!r} is {values[row, column]:g}, far "
        f"outside {low:g} to {ends[column]:g}{mixed}: no one unit fits; give all columns one"
    )


def _sides_differ(names: Sequence[str], peaks: Float32) -> bool:
    """Whether a shape of one side is in another unit than its counterpart."""
    by_name = dict(zip(names, peaks.tolist(), strict=True))
    for name, left in by_name.items():
        other = name.replace("Left", "Right") if "Left" in name else name.replace("_L_", "_R_")
        right = by_name.get(other, left)
        low, high = sorted((left, right))
        if "Look" in name or name.removeprefix("CTRL_expressions_").lower().startswith(ONE_WAY):
            continue  # a side alone is natural
        if high > CLEARLY and QUIET < low <= 1 and high > SIDES_APART * low:
            return True
    return False


ONE_WAY = ("jawleft", "jawright", "mouthleft", "mouthright")
