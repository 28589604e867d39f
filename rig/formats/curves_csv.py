"""Curves as a wide CSV: ``frame,time,<one column per control>``.

For pandas, spreadsheets and Unreal's data tables. Controls are values only: emotion
and intensity tracks go into JSON and NPZ, and beside a take into its ``intensity.csv``.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rig.arrays import Float64
from rig.controls import ControlSet
from rig.conversion.convert import controls_of, known_controls
from rig.curves import RigCurves, snap_fps
from rig.errors import FormatError
from rig.formats.decimal_text import Block, rows
from rig.formats.wide_csv import read_header, read_numbers
from rig.limits import FPS_HIGHEST

DECIMALS = 6
"""Digits of a value: half a millionth of error at most."""
TIME_DECIMALS = 9
INDEX_COLUMNS = ("frame", "time")


def write(path: Path, curves: RigCurves, digits: int = DECIMALS) -> None:
    """Write all controls, so many digits after the point, trailing zeros left out."""
    frame = np.arange(len(curves)).reshape(-1, 1)
    blocks = [
        Block(frame, 0),
        Block(curves.times.reshape(-1, 1), TIME_DECIMALS),
        Block(curves.values, digits),
    ]
    with path.open("wb") as stream:
        stream.write(",".join((*INDEX_COLUMNS, *curves.names)).encode() + b"\n")
        stream.writelines(rows(blocks))


def read(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read all controls of a set, in any column order and any known spelling.

    Parameters
    ----------
    path : Path
        The file.
    controls : ControlSet, optional
        Control set of the columns; inferred from their names if not given.
    fps : float, optional
        Frames per second; taken from the ``time`` column if not given.

    Raises
    ------
    FormatError, ControlError
        If the file is no such table, a control is missing, doubled or unknown, or the times are
        not evenly spaced.
    """
    header = read_header(path)
    columns = [i for i, name in enumerate(header) if name not in INDEX_COLUMNS]
    controls = controls or controls_of([header[i] for i in columns], where=str(path))
    names = controls.resolve([header[i] for i in columns])
    require_all(path, controls, [header[i] for i in columns])
    numbers, _ = read_numbers(path, header)
    if fps is None:
        if "time" not in header:
            raise FormatError(
                f"{path} has no column 'time'; add one, or give the curves' rate (deitalk convert: "
                "`source_fps`)",
                parameter="source_fps",
            )
        fps = fps_of(numbers[:, header.index("time")], where=str(path))
    curves = RigCurves(numbers[:, columns].astype(np.float32), names, fps, control_set=controls.id)
    return curves.reorder(controls)


def require_all(path: Path, controls: ControlSet, names: Sequence[str]) -> None:
    """Raise FormatError if a header lacks controls of the set."""
    missing = controls.missing(names)
    if missing:
        shown = ", ".join(missing[:3]) + (", …" if len(missing) > 3 else "")
        raise FormatError(
            f"{path} lacks {len(missing)} of the {len(controls)} controls of {controls.id}: "
            f"{shown}; add these columns, or read it with a control set of its own"
        )


def names_of_set(
    path: Path, set_id: str, names: Sequence[str], controls: ControlSet | None
) -> tuple[list[str], ControlSet | None]:
    """Canonical names of a file that holds its control set, and the set.

    An unknown set is a user's own (None): its names stay as they are.

    Raises
    ------
    FormatError
        If it is not the required set, or lacks some of its controls.
    """
    known = controls or known_controls(set_id)
    if known is None:
        return list(names), None
    if set_id != known.id:
        raise FormatError(f"{path} is of control set {set_id!r}, not {known.id!r}; name its rig")
    require_all(path, known, names)
    return list(known.resolve(names)), known


def fps_of(times: Float64, *, where: str) -> float:
    """Return the rate of evenly spaced times (seconds): a standard one where it fits.

    Raises
    ------
    FormatError
        If times do not rise, or a step differs from the mean step by more than a tenth.
    """
    if len(times) < 2:
        return 30.0
    steps = np.diff(times)
    mean = (times[-1] - times[0]) / len(steps)
    if not mean > 0:
        raise FormatError(f"{where}: the times do not rise; give each frame a later time")
    if mean < 0.5 / FPS_HIGHEST:
        raise FormatError(
            f"{where}: frames are {mean:g} s apart; at most {FPS_HIGHEST:g} a second are read"
        )
    uneven = np.abs(steps - mean) > 0.1 * mean
    if uneven.any():
        row = int(np.argmax(uneven)) + 2
        raise FormatError(
            f"{where}: data row {row} comes {steps[row - 2]:g} s after the last, others "
            f"{mean:g} s; frames must be evenly spaced"
        )
    exact = float(1.0 / mean)
    rounded = round(exact, 4)
    return snap_fps(rounded if abs(rounded - exact) < 2e-5 * exact and rounded else exact)
