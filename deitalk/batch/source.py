"""A manifest or a folder of recordings to lines, with outputs that differ."""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from graphlib import CycleError, TopologicalSorter
from pathlib import Path, PurePosixPath

from deitalk.audio.decoding import RECORDINGS
from deitalk.batch.cloud import cloud_errors, file_system, is_url
from deitalk.batch.lines import TAKE, BadLine, Line
from deitalk.batch.manifest import checked_output, read_manifest
from deitalk.errors import DataError
from rig import limits
from rig.errors import UserError, listed
from rig.files.reading import decode_text, read_text

SUMMARY, FAILED, ACTORS = "batch-summary.csv", "batch-failed.csv", "batch-actors"
"""Tables and references of a batch in its output folder."""


@dataclass(frozen=True)
class Plan:
    """Lines of a batch in the order of their source."""

    lines: list[Line | BadLine]
    notes: tuple[str, ...] = ()
    """On the columns of a manifest, or on recordings of one name in a folder."""


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
        # Recordings that differ from another by their suffix, or by case, alone.
        stems = Counter(os.path.splitext(name)[0].casefold() for name in names)
        doubled = [
            name for name in sorted(names) if stems[os.path.splitext(name)[0].casefold()] > 1
        ]
        lines = distinct(list(_found(base, names, doubled, defaults)))
        outputs = listed([_with_suffix(name) for name in doubled])
        note = f"recordings that differ by their suffix alone have it in their results: {outputs}"
        return Plan(lines, (note,) if doubled else ())
    if base.lower().endswith(RECORDINGS):
        raise DataError(f"{base}: a recording; name its folder or a table, or use deitalk animate")
    if not is_url(base):
        text = read_text(Path(base), limits.DATASET_TABLE_BYTES, error=DataError)
    else:
        system, path = file_system(base)
        with cloud_errors(base):
            data = system.cat_file(path)
        text = decode_text(data, base, error=DataError)
    lines, notes = read_manifest(text, base, os.path.dirname(base), defaults)
    return Plan(_in_no_circle(distinct(lines)), notes)


def _with_suffix(name: str) -> str:
    """Output of a recording that shares its name: ``line_mp3`` of ``line.mp3``."""
    stem, suffix = os.path.splitext(name)
    return f"{stem}_{suffix[1:]}"


def _found(
    folder: str, names: list[str], doubled: list[str], defaults: Line
) -> Iterator[Line | BadLine]:
    apart = set(doubled)
    if not names:
        known = " ".join(RECORDINGS)
        raise DataError(f"{folder}: holds no recording ({known}); name another folder")
    if len(names) > limits.BATCH_LINES:
        raise DataError(f"{folder}: more than {limits.BATCH_LINES:,} recordings; divide it")
    for place, name in enumerate(sorted(names), 1):
        audio = f"{folder}/{name}"
        try:
            stem = _with_suffix(name) if name in apart else os.path.splitext(name)[0]
            output = checked_output(stem)
        except UserError as error:
            yield BadLine(place, audio, "", str(error))
        else:
            yield replace(defaults, number=place, audio=audio, output=output)


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


def waves(lines: Sequence[Line | BadLine]) -> list[list[int]]:
    """Places of the lines, those that others begin or end at before these.

    Lines of a wave depend on lines of the waves before it alone; lines of a circle are in none.
    """
    places = {line.output: k for k, line in enumerate(lines) if isinstance(line, Line)}
    sorter = TopologicalSorter[int]()
    for k, line in enumerate(lines):
        beside = line.beside.values() if isinstance(line, Line) else ()
        sorter.add(k, *(places[name] for name in beside if name in places))
    with suppress(CycleError):
        sorter.prepare()
    found = []
    while wave := sorter.get_ready():
        found.append(sorted(wave))
        sorter.done(*wave)
    return found


def _in_no_circle(lines: list[Line | BadLine]) -> list[Line | BadLine]:
    """The lines, those that wait for one another made bad."""
    reached = {k for wave in waves(lines) for k in wave}
    return [
        line
        if k in reached or isinstance(line, BadLine)
        else BadLine(
            line.number, line.audio, line.output,
            f"line {line.output} follows {' and '.join(line.beside.values())}, which waits for it; "
            "of two lines give one `after` or `into`, not both",
        )
        for k, line in enumerate(lines)
    ]  # fmt: skip


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
