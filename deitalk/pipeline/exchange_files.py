"""Files of a take for other programs: a Live Link Face CSV, and one for Unreal's script."""

import re
from pathlib import Path

from rig.curves import RigCurves
from rig.formats import write_curves
from rig.formats.livelink_csv import take_name

SUBJECT = "deitalk"
MAX_SLATE = 100
"""Letters of a slate; file systems take 255 bytes for a whole name."""


def exchange_names(slate: str) -> tuple[str, str]:
    """Names of the Live Link Face CSV and of the file for Unreal; see `write_exchange_files`."""
    slate = re.sub(r"[^0-9A-Za-z]+", "-", slate)[:MAX_SLATE].strip("-") or "take"
    return take_name(slate, 1, SUBJECT), f"{slate}.unreal.json"


def write_exchange_files(
    folder: Path,
    curves: RigCurves,
    *,
    slate: str,
    digits: int | None = None,
    start: float = 0.0,
) -> dict[str, str]:
    """Write a Live Link Face CSV and the file for the script inside Unreal.

    Parameters
    ----------
    folder : Path
        Must exist.
    curves : RigCurves
        Of the default board.
    slate : str
        Name of the recording; characters other than letters and digits become ``-``.
    digits : int, optional
        Of the file for Unreal; see `rig.write_curves`.
    start : float
        Time of day of the first frame, seconds.

    Returns
    -------
    dict
        File names and a line on each, for ``take.json``.
    """
    live_link, unreal = exchange_names(slate)
    report = write_curves(folder / live_link, curves, format="livelink", start=start)
    write_curves(folder / unreal, curves, format="unreal", digits=digits, start=start)
    return {
        live_link: f"Live Link Face CSV, subject {SUBJECT}; {report.note}",
        unreal: "raw curves and board keys for rig/unreal/deitalk_unreal.py",
    }
