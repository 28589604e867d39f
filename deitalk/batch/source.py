"""A manifest or a folder of recordings to lines, with outputs that differ."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from deitalk.audio.headers import RECORDINGS
from deitalk.batch.lines import TAKE, BadLine, Line, Settings
from deitalk.batch.manifest import checked_output, read_manifest
from deitalk.errors import DataError
from rig import limits
from rig.errors import UserError
from rig.files.reading import read_text

SUMMARY, FAILED, ACTORS = "batch-summary.csv", "batch-failed.csv", "batch-actors"
"""Tables and references of a batch in its output folder."""


@dataclass(frozen=True)
class Plan:
    """Lines of a batch in the order of their source."""

    lines: list[Line | BadLine]
    unused: tuple[str, ...] = ()
    """Columns of the manifest that are not used."""


def read_source(source: Path, out: Path, defaults: Settings) -> Plan:
    """Lines of a manifest (a file) or of all recordings in a folder and its subfolders.

    Hidden files and folders are left out, and the output folder where it lies in the source.

    Raises
    ------
    DataError
        If there is no recording, or the manifest is missing or no table.
    """
    if source.is_dir():
        return Plan(distinct(list(_in_folder(source, out, defaults))))
    text = read_text(source, limits.DATASET_TABLE_BYTES, error=DataError)
    lines, unused = read_manifest(text, str(source), str(source.parent), defaults)
    return Plan(distinct(lines), unused)


def _in_folder(folder: Path, out: Path, defaults: Settings) -> Iterator[Line | BadLine]:
    names = _recordings(folder, out)
    if not names:
        known = " ".join(RECORDINGS)
        raise DataError(f"{folder}: holds no recording ({known}); name another folder")
    for number, name in enumerate(names, 1):
        audio = str(folder / name)
        try:
            output = checked_output(os.path.splitext(name)[0])
        except UserError as error:
            yield BadLine(number, audio, "", str(error))
        else:
            yield Line(number, audio, output, defaults)


def _recordings(folder: Path, out: Path) -> list[str]:
    """Recordings below a folder, with ``/``, sorted."""
    left_out, found = os.path.realpath(out), []
    for root, folders, names in os.walk(folder):
        folders[:] = [
            name
            for name in folders
            if not name.startswith(".") and os.path.realpath(os.path.join(root, name)) != left_out
        ]
        below = Path(root).relative_to(folder)
        for name in names:
            if name.lower().endswith(RECORDINGS) and not name.startswith("."):
                found.append((below / name).as_posix())
        if len(found) > limits.BATCH_LINES:
            raise DataError(f"{folder}: more than {limits.BATCH_LINES:,} recordings; divide it")
    return sorted(found)


def distinct(lines: list[Line | BadLine]) -> list[Line | BadLine]:
    """The lines, those whose outputs are another line's made bad."""
    owners: dict[str, Line] = {}
    takes: dict[str, Line] = {}
    result: list[Line | BadLine] = []
    for line in lines:
        if isinstance(line, Line):
            error = _clash(line, owners, takes)
            if error:
                result.append(BadLine(line.number, line.audio, line.output, error))
                continue
            for target in line.targets:
                owners[target.casefold()] = line
            if TAKE in line.settings.formats:
                takes[line.output.casefold()] = line
        result.append(line)
    return _outside_takes(result, takes)


def _clash(line: Line, owners: dict[str, Line], takes: dict[str, Line]) -> str:
    for target in line.targets:
        folded = target.casefold()
        if folded in (SUMMARY, FAILED, ACTORS) or folded.startswith(f"{ACTORS}/"):
            return f"output {target} is a table of the batch itself; name another"
        if other := owners.get(folded):
            return (
                f"output {target} is that of line {other.number} ({other.audio}) too; name another"
            )
    return ""


def _outside_takes(lines: list[Line | BadLine], takes: dict[str, Line]) -> list[Line | BadLine]:
    """The lines, those with an output within the take of another made bad."""
    if not takes:
        return lines
    result: list[Line | BadLine] = []
    for line in lines:
        parents = PurePosixPath(line.output.casefold()).parents if isinstance(line, Line) else ()
        other = next((takes[str(p)] for p in parents if str(p) in takes), None)
        if other is not None:
            error = f"output {line.output} lies in the take of line {other.number}; name another"
            result.append(BadLine(line.number, line.audio, line.output, error))
        else:
            result.append(line)
    return result
