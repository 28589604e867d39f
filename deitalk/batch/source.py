"""A manifest or a folder of recordings to lines, with outputs that differ."""

import os
from collections import Counter
from collections.abc import Sequence
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
    names = _names_in(base, out)
    if names is not None:
        # Recordings that differ from another by their suffix, or by case, alone.
        stems = Counter(os.path.splitext(name)[0].casefold() for name in names)
        doubled = [
            name for name in sorted(names) if stems[os.path.splitext(name)[0].casefold()] > 1
        ]
        if not names:
            known = " ".join(RECORDINGS)
            raise DataError(f"{base}: holds no recording ({known}); name another folder")
        if len(names) > limits.BATCH_LINES:
            raise DataError(f"{base}: more than {limits.BATCH_LINES:,} recordings; divide it")
        lines, apart = list[Line | BadLine](), set(doubled)
        for place, name in enumerate(sorted(names), 1):
            audio = f"{base}/{name}"
            stem = _with_suffix(name) if name in apart else os.path.splitext(name)[0]
            try:
                output = checked_output(stem)
            except UserError as error:
                lines.append(BadLine(place, audio, "", str(error)))
            else:
                lines.append(replace(defaults, number=place, audio=audio, output=output))
        lines = distinct(lines)
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


def _names_in(folder: str, out: str | Path) -> list[str] | None:
    """Recordings below a folder or a URL, with ``/``; None if it is no folder."""
    if is_url(folder):
        system, path = file_system(folder)
        with cloud_errors(folder):
            if not system.isdir(path):
                return None
            left_out = f"{out}/".removeprefix(f"{folder}/")
            found = [name[len(path) + 1 :] for name in system.find(path)]
            found = [name for name in found if not name.startswith(left_out)]
    else:
        if not os.path.isdir(folder):
            return None
        left_out, found = os.path.realpath(out), []
        for root, folders, names in os.walk(folder):
            folders[:] = [
                name for name in folders if os.path.realpath(os.path.join(root, name)) != left_out
            ]
            below = Path(root).relative_to(folder)
            found += [(below / name).as_posix() for name in names]
    return [
        name
        for name in found
        if name.lower().endswith(RECORDINGS) and not (name.startswith(".") or "/." in name)
    ]


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
    """The lines, those made bad whose outputs are another line's, a table, or lie in a take."""
    owners: dict[str, Line] = {}
    takes: dict[str, Line] = {}
    errors: dict[int, str] = {}
    for place, line in enumerate(lines):
        if isinstance(line, BadLine):
            continue
        for target in line.targets:
            folded = target.casefold()
            if folded in (SUMMARY, FAILED, ACTORS) or folded.startswith(f"{ACTORS}/"):
                errors[place] = f"output {target} is a table of the batch itself; name another"
            elif other := owners.get(folded):
                first = f"line {other.number} ({other.audio})"
                errors[place] = f"output {target} is that of {first} too; name another"
        if place not in errors:
            owners |= {target.casefold(): line for target in line.targets}
            takes |= {line.output.casefold(): line} if TAKE in line.written.formats else {}
    for place, line in enumerate(lines) if takes else ():
        parents = PurePosixPath(line.output.casefold()).parents if isinstance(line, Line) else ()
        other = next((takes[str(p)] for p in parents if str(p) in takes), None)
        if other is not None and place not in errors:
            errors[place] = (
                f"output {line.output} lies in the take of line {other.number}; name another"
            )
    return [
        BadLine(line.number, line.audio, line.output, errors[place]) if place in errors else line
        for place, line in enumerate(lines)
    ]
