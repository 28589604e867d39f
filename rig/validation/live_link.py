"""Checks of a Live Link Face CSV by the rules of Unreal's importer."""

import re
from pathlib import Path

import numpy as np

from rig.conversion.arkit import ARKIT_ID, arkit_controls
from rig.conversion.convert import known_controls
from rig.conversion.raw import PREFIX
from rig.curves.timecode import TICKS_PER_SECOND
from rig.errors import FormatError
from rig.files.reading import decode_text, open_file
from rig.formats.livelink_csv import COUNT, LiveLinkTake, read_take, suffix_note
from rig.formats.units import in_units
from rig.formats.wide_csv import count_rows, read_header
from rig.limits import CURVES_BYTES, HEADER_BYTES
from rig.unreal.deitalk_clip import subject_of
from rig.validation.findings import Rows, motion

TAKE = re.compile(r"(?P<slate>.+)_(?P<take>\d+)_(?P<subject>[^_]+)")
"""The app's names, ``<Slate>_<Take>_<Subject>``."""


MARK = f"{PREFIX}mouthUp"
"""Property by which the face blueprint recognises raw curves."""
SWITCH = "HeadControlSwitch"


def is_live_link(path: Path) -> bool:
    """Return whether a file is a CSV that begins as those of Live Link Face, quoted or not."""
    if path.suffix.lower() != ".csv":
        return False
    header = [cell.lower() for cell in read_header(path)[:2]]
    return header == ["timecode", COUNT.lower()]


def check_live_link(path: Path) -> Rows:
    """Return the findings on a file that `is_live_link`.

    Raises
    ------
    FormatError
        If the importer refuses the file, stops inside it, or it cannot be read.
    """
    _check_header(path, _first_line(path))
    highest = _highest_frame_field(path)
    take = read_take(path)
    subject = subject_of(path.name)
    text = f"Unreal makes the Live Link subject {subject!r}"
    parts = TAKE.fullmatch(path.stem)
    if parts and subject == path.stem:
        better = f"{parts['slate']}_take_{parts['take']}_{parts['subject']}.csv"
        text += f", the whole name; {better} gives {parts['subject']!r}"
    if suffix_note(path):
        text = suffix_note(path)
    seconds = (take.ticks[-1] - take.ticks[0]) / TICKS_PER_SECOND
    size = f"Live Link take, {len(take.ticks)} frames at {take.fps:g} fps over {seconds:.2f} s"
    findings: Rows = [("note", size), ("note", text)]
    if take.ticks[0] > TICKS_PER_SECOND:
        text = "the time code starts late: Unreal places the section at that hour of the timeline"
        findings.append(("warning", text))
    findings += _clock(take) or _pace(take, highest)
    findings += _units(path, take) + _metahuman(take)
    missing = [name for name in arkit_controls().names if name not in take.names]
    if missing and not any(name.startswith(PREFIX) for name in take.names):
        text = f"{len(missing)} of 61 columns are missing ({missing[0]}, …): they stay at 0"
        findings.append(("warning", text))
    shapes = [i for i, name in enumerate(take.names) if name in arkit_controls().names[:52]]
    values = np.asarray(take.values[:, shapes], np.float64)
    outside = (values < 0) | (values > 1)
    if outside.any():
        worst = float(np.maximum(values - 1, -values).max())
        count = int(outside.sum())
        text = f"{count} values are outside 0 to 1, by {worst:.3g} at most: Unreal keeps them"
        findings.append(("warning", text))
    return findings + motion(take.values, take.names, ARKIT_ID)


def _first_line(path: Path) -> str:
    with open_file(path, CURVES_BYTES) as stream:
        return decode_text(stream.readline(HEADER_BYTES), path).rstrip("\r\n")


def _check_header(path: Path, line: str) -> None:
    """Refuse what the importer's comparison of the first two columns refuses."""
    if "=" in line.split(",")[0]:
        raise FormatError(f"{path} begins with {line!r}; Unreal takes it for the header: remove it")
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if mark in line and "," not in line:
            raise FormatError(f"{path} has {name} between its cells; Unreal reads commas")
    if '"' in line:
        raise FormatError(f"{path} has quotes in its first line; Unreal compares names with them")
    for cell in line.split(","):
        if cell != cell.strip():
            raise FormatError(
                f"{path} has white space at {cell[:40]!r}; Unreal compares names with it"
            )


def _highest_frame_field(path: Path) -> float:
    """Return the highest FF.mmm; rows must have as many cells as the header.

    Unreal drops empty cells, and ends its import at a row of another number of cells.
    """
    width = _first_line(path).count(",") + 1
    count_rows(path, width)
    highest = 0.0
    with open_file(path, CURVES_BYTES) as stream:
        stream.readline()
        for number, data in enumerate(stream, 1):
            line = decode_text(data, path).strip("\r\n")
            if not line:
                continue
            n_cells = line.count(",") + 1
            if ",," in line or line.endswith(",") or line.startswith(","):
                n_cells = sum(bool(cell) for cell in line.split(","))
            if n_cells != width:
                raise FormatError(
                    f"{path}: data row {number} has {n_cells} filled cells, the header {width}; "
                    "Unreal ends its import there"
                )
            field = line.partition(",")[0].rpartition(":")[2]
            highest = max(highest, float(field) if re.fullmatch(r"\d+(\.\d+)?", field) else 0.0)
    return highest


def _metahuman(take: LiveLinkTake) -> Rows:
    """Find raw curves that the face blueprint of Unreal 5.6 and later does not take as such."""
    if not any(name.startswith(PREFIX) for name in take.names):
        return []
    texts = []
    if MARK not in take.names:
        texts.append(f"no column {MARK}: Unreal takes the columns for ARKit shapes")
    turns = [i for i, name in enumerate(take.names) if name in ("HeadYaw", "HeadPitch", "HeadRoll")]
    switch = [i for i, name in enumerate(take.names) if name == SWITCH]
    if take.values[:, turns].any() and not take.values[:, switch].any():
        texts.append(f"the head turns, but {SWITCH} is not 1: Unreal leaves the head still")
    return [("warning", text) for text in texts]


def _clock(take: LiveLinkTake) -> Rows:
    """Find time codes that Unreal takes for others."""
    taken = "Unreal takes FF for sixtieths, or for thirtieths where it never exceeds 30"
    return [
        ("error", f"{note}: {taken}; deitalk convert writes sixtieths")
        for note in take.notes
        if note.startswith(("time codes count", "drop-frame"))
    ]


def _units(path: Path, take: LiveLinkTake) -> Rows:
    """Find percent and degrees, which Unreal takes for shares and nearly radians."""
    try:
        curves = take.to_curves()
    except FormatError:  # properties of another rig
        return []
    known = known_controls(curves.control_set)
    assert known is not None
    notes = in_units(curves, known, path).notes[len(curves.notes) :]
    return [
        ("error", f"{note}; Unreal takes them as they are, deitalk convert mends them")
        for note in notes
        if "radians" not in note
    ] + [("warning", note) for note in notes if "radians" in note]


def _pace(take: LiveLinkTake, highest: float) -> Rows:
    """Find files that Unreal reads at 30 fps, and dropped frames."""
    if 0 < highest <= 30.0 and take.ticks[-1] - take.ticks[0] <= TICKS_PER_SECOND:
        text = (
            "FF never exceeds 30, so Unreal counts thirtieths: if FF are sixtieths, the clip plays "
            "at half speed; hold the last frame for a second"
        )
        return [("warning", text)]
    if 0 < highest <= 30.0:
        text = (
            "FF never exceeds 30: read as 30 frames a second, as by Unreal since August 2023; an "
            "older importer plays each second in half a second, then freezes"
        )
        return [("warning", text)]
    steps = np.diff(take.ticks)
    jumps = steps > 1.5 * float(np.median(steps)) if len(steps) > 1 else np.zeros(0)
    text = f"{int(jumps.sum())} gaps in the time codes: frames were dropped there"
    return [("warning", text)] if jumps.any() else []
