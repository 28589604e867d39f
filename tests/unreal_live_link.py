"""Unreal's import of a Live Link Face CSV, written from its description and not from our code.

Rules: comma-separated cells, empty ones dropped; at least two lines and three columns, the first two
called Timecode and BlendShapeCount in any case; a row with another number of cells ends the import;
a malformed time code skips its row; 60 frames a second if a frame field exceeds 30.0, else 30; times
are seconds and frames divided by that rate.
"""

from dataclasses import dataclass
from pathlib import Path


@dataclass
class Imported:
    subject: str
    rate: int
    times: list
    columns: dict


def subject(stem):
    for ending in ("_cal", "_raw", "_neutral"):
        if stem.endswith(ending):
            stem = stem[: -len(ending)]
    tokens = stem.split("_")
    if len(tokens) <= 3:
        return stem
    rest = tokens[1:]
    while rest and not rest[0].isdecimal():
        rest = rest[1:]
    return "_".join(rest[1:]) if rest else stem


def import_csv(path):
    """Return what Unreal makes of a file; an AssertionError where it refuses it."""
    path = Path(path)
    lines = path.read_text(encoding="utf-8").splitlines()
    assert len(lines) >= 2, "no data"
    header = [cell for cell in lines[0].split(",") if cell]
    assert len(header) >= 3, "fewer than three columns"
    assert [cell.lower() for cell in header[:2]] == ["timecode", "blendshapecount"], header[:2]
    rows = []
    for line in lines[1:]:
        cells = [cell for cell in line.split(",") if cell]
        assert len(cells) == len(header), "did not contain the correct number of columns"
        tokens = cells[0].split(":")
        if len(tokens) == 4:
            hours, minutes, seconds, frames = (float(token) for token in tokens)
            rows.append((hours * 3600 + minutes * 60 + seconds, frames, cells[2:]))
    rate = 60 if any(frames > 30.0 for _, frames, _ in rows) else 30
    columns = {name: [float(row[2][i]) for row in rows] for i, name in enumerate(header[2:])}
    times = [second + frames / rate for second, frames, _ in rows]
    return Imported(subject(path.stem), rate, times, columns)
