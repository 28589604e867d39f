"""Files that other programs open right away, beside the curves of a take."""

import re
from pathlib import Path

from rig.curves import RigCurves
from rig.formats import write_curves
from rig.formats.livelink_csv import take_name

SUBJECT = "deitalk"


def write_exchange_files(
    folder: Path, curves: RigCurves, *, slate: str, take: int = 1, subject: str = SUBJECT
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
    take : int
        Number of the take.
    subject : str
        Live Link subject that Unreal's importer makes of the CSV.

    Returns
    -------
    dict
        File names and a line on each, for ``take.json``.
    """
    slate = re.sub(r"[^0-9A-Za-z]+", "-", slate).strip("-") or "take"
    live_link = take_name(slate, take, subject)
    report = write_curves(folder / live_link, curves, format="livelink")
    write_curves(folder / f"{slate}.unreal.json", curves, format="unreal")
    return {
        live_link: f"Live Link Face CSV, subject {subject}; {report.note}",
        f"{slate}.unreal.json": "raw curves and board keys for rig/unreal/deitalk_unreal.py",
    }
