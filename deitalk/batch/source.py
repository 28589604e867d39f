"""A manifest or a folder of recordings to lines, with outputs that differ."""

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from deitalk.audio.headers import RECORDINGS
from deitalk.batch.lines import TAKE, BadLine, Line
from deitalk.batch.manifest import checked_output, read_manifest
from deitalk.batch.storage import cloud_errors, file_system, is_url
from deitalk.errors import DataError
from rig import limits
from rig.errors import UserError
from rig.files.reading import decode_text, read_text

SUMMARY, FAILED, ACTORS = "batch-summary.csv", "batch-failed.csv", "batch-actors"
"""Tables and references of a batch in its output folder."""


@dataclass(frozen=True)
class Plan:
    """Lines of a batch in the order of their source."""

    lines: list[Line | BadLine]
    notes: tuple[str, ...] = ()
    """On the columns of the manifest."""


def read_source(source: str | Path, out: str | Path, defaults: Line) -> Plan:
    """Lines of a manifest (a file) or of all recordings in a folder and its subfolders.

    Hidden files and folders are left out, and the output folder where it lies in the source.

    Raises
    ------
    DataError
        If there is no recording, or the manifest is missing or no table.
    """
    base = str(source).rstrip("/") if is_url(source) else os.path.normpath(source)
    names = _names_at(base, out) if is_url(source) else _names_in(base, out)
    if names is not None:
        return Plan(distinct(list(_found(base, names, defaults))))
    text = _text_of(base)
    lines, notes = read_manifest(text, base, os.path.dirname(base), defaults)
    return Plan(distinct(lines), notes)


def _text_of(manifest: str) -> str:
    if not is_url(manifest):
        return read_text(Path(manifest), limits.DATASET_TABLE_BYTES, error=DataError)
    system, path = file_system(manifest)
    with cloud_errors(manifest):
        data = system.cat_file(path)
    return decode_text(data, manifest, error=DataError)


def _found(folder: str, names: list[str], defaults: Line) -> Iterator[Line | BadLine]:
    if not names:
        known = " ".join(RECORDINGS)
        raise DataError(f"{folder}: holds no recording ({known}); name another folder")
    if len(names) > limits.BATCH_LINES:
        raise DataError(f"{folder}: more than {limits.BATCH_LINES:,} recordings; divide it")
    for number, name in enumerate(sorted(names), 1):
        audio = f"{folder}/{name}"
        try:
            output = checked_output(os.path.splitext(name)[0])
        except UserError as error:
            yield BadLine(number, audio, "", str(error))
        else:
            yield replace(defaults, number=number, audio=audio, output=output)


def _names_in(folder: str, out: str | Path) -> list[str] | None:
    """Recordings below a folder, with ``/``; None if it is no folder."""
    if not os.path.isdir(folder):
        return None
    left_out, found = os.path.realpath(out), []
    for root, folders, names in os.walk(folder):
        folders[:] = [
            name for name in folders if os.path.realpath(os.path.join(root, name)) != left_out
        ]
        below = Path(root).relative_to(folder)
        found += [(below / name).as_posix() for name in names]
    return [name for name in found if _is_recording(name)]


def _names_at(url: str, out: str | Path) -> list[str] | None:
    """Recordings below a URL; None if it is no folder."""
    system, path = file_system(url)
    with cloud_errors(url):
        if not system.isdir(path):
            return None
        names = [name[len(path) + 1 :] for name in system.find(path)]
    left_out = f"{out}/".removeprefix(f"{url}/")
    return [name for name in names if _is_recording(name) and not name.startswith(left_out)]


def _is_recording(name: str) -> bool:
    is_hidden = name.startswith(".") or "/." in name
    return name.lower().endswith(RECORDINGS) and not is_hidden


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
            if TAKE in line.written.formats:
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
