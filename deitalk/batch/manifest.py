"""Rows of a manifest: a table with the columns that a line can have.

::

    audio             recording, relative to the manifest or absolute; the only column that must be
    output            name in the output folder, without suffix; by default that of the recording
    formats           csv;take …  (`deitalk convert` lists them)
    emotion           as for `deitalk animate`; a track is relative to the manifest
    intensity         factor, 0 to 4
    intensity_curve   edited intensity.csv of a take
    actor             who speaks: lines of one actor share a reference
    voice             reference of the actor, instead of the one that is measured
    fps, digits, seed, listen   numbers
    timecode          zero, recording or HH:MM:SS:FF
    life, look_at, gain   as for `deitalk animate`
    transcript, phones    what is said: text, or a file relative to the manifest; not both
    language          espeak-ng's voice for the words

Cells are separated by commas, semicolons or tabs; text is UTF-8 or UTF-16.
"""

import csv
import io
import os
import re
from collections.abc import Iterator
from dataclasses import replace

from deitalk.batch.lines import BadLine, Line, Settings, check_settings, is_track, parse_formats
from deitalk.emotions.track_files import number
from deitalk.errors import DataError, DeitalkError
from deitalk.pipeline.arguments import whole_seed
from deitalk.pipeline.words.transcript import is_words_file
from rig import limits
from rig.errors import UserError, quoted
from rig.formats.table import writable_suffixes

COLUMNS = (
    "audio", "output", "formats", "emotion", "intensity", "intensity_curve", "actor", "voice",
    "fps", "digits", "timecode", "seed", "life", "look_at", "listen", "gain", "transcript",
    "phones", "language",
)  # fmt: skip
_SETTINGS = tuple(name for name in COLUMNS if name not in ("audio", "output", "formats"))
_SEPARATORS = ",;\t"
_SUFFIXES = sorted(writable_suffixes(), key=len, reverse=True)
Row = dict[str, str]


def read_manifest(
    text: str, where: str, base: str, defaults: Settings
) -> tuple[list[Line | BadLine], tuple[str, ...]]:
    """Lines of a manifest in their order, and the names of columns that are not used.

    Parameters
    ----------
    text : str
        Content of the file.
    where : str
        Its name, for messages.
    base : str
        Folder or URL that relative paths begin at.
    defaults : Settings
        For empty cells and missing columns.

    Raises
    ------
    DataError
        If it has no column ``audio``, a column twice, no rows or too many.
    """
    header, rows = _rows(text, where)
    if "audio" not in header:
        raise DataError(
            f"{where}: no column 'audio' among {quoted(', '.join(header))}; a manifest has the "
            f"columns {', '.join(COLUMNS)}"
        )
    known = [name for name in header if name in COLUMNS]
    doubled = next((name for name in known if known.count(name) > 1), None)
    if doubled is not None:
        raise DataError(f"{where}: column {doubled!r} is there twice; keep one")
    read = _Reader(base, defaults)
    lines = [read.line(i, row) for i, row in enumerate(rows, 1)]
    if not lines:
        raise DataError(f"{where}: holds no rows; write one for each recording")
    return lines, tuple(name for name in header if name and name not in COLUMNS)


def _rows(text: str, where: str) -> tuple[list[str], Iterator[Row]]:
    """Names of the columns, and the rows that are not empty."""
    first, _, rest = text.partition("\n")
    if first.lower().startswith("sep="):  # Excel's own first line
        text = rest
        first = rest.partition("\n")[0]
    separator = max(_SEPARATORS, key=first.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    try:
        header = [name.strip().lower() for name in next(reader, [])]
    except csv.Error as error:
        raise DataError(f"{where}: no table ({error}); save it as CSV") from None
    return header, _filled(reader, header, where)


def _filled(reader: Iterator[list[str]], header: list[str], where: str) -> Iterator[Row]:
    count = 0
    try:
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            count += 1
            if count > limits.BATCH_LINES:
                raise DataError(
                    f"{where}: more than {limits.BATCH_LINES:,} rows; divide the manifest"
                )
            yield {name: cell.strip() for name, cell in zip(header, cells, strict=False)}
    except csv.Error as error:
        raise DataError(f"{where}, row {count + 1}: {error}; save it as CSV again") from None


class _Reader:
    """Rows to lines; rows of equal settings share one object."""

    def __init__(self, base: str, defaults: Settings) -> None:
        self.base, self.defaults = base, defaults
        self._known: dict[tuple[str | None, ...], Settings] = {}

    def line(self, place: int, row: Row) -> Line | BadLine:
        audio = row.get("audio", "")
        try:
            if not audio:
                raise DeitalkError("no recording is named in the column audio")
            formats, output = _named(row, audio, self.defaults)
            return Line(place, joined(self.base, audio), output, self._settings(row, formats))
        except UserError as error:
            return BadLine(place, audio, row.get("output", ""), str(error))

    def _settings(self, row: Row, formats: tuple[str, ...]) -> Settings:
        cells = (*formats, *(row.get(name) for name in _SETTINGS))
        if cells not in self._known:
            defaults = replace(self.defaults, formats=formats)
            self._known[cells] = _settings(row, self.base, defaults)
        return self._known[cells]


def _settings(row: Row, base: str, defaults: Settings) -> Settings:
    found: dict[str, object] = {}
    if emotion := row.get("emotion"):
        found["emotion"] = joined(base, emotion) if is_track(emotion) else emotion
    for name in ("intensity_curve", "voice", "transcript", "phones"):
        if cell := row.get(name):
            is_path = name in ("intensity_curve", "voice") or is_words_file(cell)
            found[name] = joined(base, cell) if is_path else cell
    for name in ("intensity", "fps", "listen"):
        if cell := row.get(name):
            found[name] = number(cell, name, "column")
    for name in ("actor", "life", "look_at", "gain", "timecode", "language"):
        if text := row.get(name):
            found[name] = text
    if seed := row.get("seed"):
        found["seed"] = whole_seed(int(seed) if seed.isdecimal() else seed)
    if digits := row.get("digits"):
        found["digits"] = int(digits) if digits.isdecimal() else digits
    settings = replace(defaults, **found)  # type: ignore[arg-type]
    check_settings(settings)
    return settings


def _named(row: Row, audio: str, defaults: Settings) -> tuple[tuple[str, ...], str]:
    """Formats and output of a row; the suffix of an output is its format if none is named."""
    text = row.get("formats", "")
    formats = parse_formats(text) if text else defaults.formats
    output = row.get("output", "")
    if not output:
        return formats, output_of(audio)
    suffix = next((s for s in _SUFFIXES if output.lower().endswith(s)), "")
    if suffix and (not text or suffix in formats):
        formats = formats if text else (suffix,)
        output = output[: -len(suffix)]
    return formats, checked_output(output)


def output_of(audio: str) -> str:
    """Output of a recording that is named by a relative path: the same without suffix."""
    is_below = not (os.path.isabs(audio) or "://" in audio or ".." in re.split(r"[/\\]", audio))
    name = audio if is_below else re.split(r"[/\\]", audio)[-1]
    return checked_output(os.path.splitext(name)[0])


def checked_output(output: str) -> str:
    """An output with ``/`` between its parts.

    Raises
    ------
    DeitalkError
        If it leaves the output folder, is hidden or is no text.
    """
    path = output.replace("\\", "/")
    parts = [part for part in path.split("/") if part not in ("", ".")]
    if not parts or path.startswith("/") or ":" in parts[0] or ".." in parts or "\0" in path:
        raise DeitalkError(f"output {quoted(output)} must be a name below the output folder")
    if any(part.startswith(".") for part in parts):
        raise DeitalkError(f"output {quoted(output)} has a hidden part; name it without a dot")
    if not path.isascii():
        try:
            path.encode()
        except UnicodeEncodeError:
            raise DeitalkError(
                f"output {quoted(output)} is no UTF-8; rename the recording"
            ) from None
    return "/".join(parts)


def joined(base: str, path: str) -> str:
    """A path or URL of a manifest, from the folder that relative ones begin at."""
    if "://" in path or os.path.isabs(path) or not base:
        return path
    if "://" in base:
        return f"{base.rstrip('/')}/{path}"
    return os.path.join(base, path)
