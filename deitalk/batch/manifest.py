"""Rows of a manifest: a table with the columns that a line can have.

::

    audio             recording, relative to the manifest or absolute; the only one that must be
    output            name in the output folder, without suffix; by default that of the recording
    formats           csv;take …  (`deitalk convert` lists them)
    actor             who speaks: lines of one actor share a measured voice
    fps, digits       numbers
    timecode          zero, recording or HH:MM:SS:FF
    delay, handles    frames by which the face is late, and added before and after
    track, channel, raw  which signal, as for `deitalk.load_audio`
    performance       take or curves whose mouth the recording replaces, as for `deitalk dub`;
                      with sound, mapping, stretch, source_fps
    after, into       the output of the line before it or next, or a take
    emotion, life …   each field of `deitalk.acting.Acting`; files are relative to the manifest

Cells are separated by commas, semicolons or tabs; text is UTF-8 or UTF-16.
"""

import os
import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from deitalk.acting import Acting
from deitalk.audio.choice import AudioChoice
from deitalk.batch.lines import BadLine, Dubbing, Line, Written, parse_formats
from deitalk.emotions.track_files import number
from deitalk.errors import DataError, DeitalkError
from rig import limits
from rig.errors import UserError, listed, quoted
from rig.files.text_rows import Row, rows_of_text
from rig.formats.table import writable_suffixes

SIGNAL = ("track", "channel", "raw")
DUBBING = ("performance", "sound", "mapping", "stretch", "source_fps")
OWN_COLUMNS = (
    "audio", "output", "formats", "actor", "fps", "digits", "timecode", "delay", "handles", *SIGNAL,
    *DUBBING,
)  # fmt: skip
BESIDE = ("after", "into")
"""Columns that name another line, or a take."""
COLUMNS = (*OWN_COLUMNS, *Acting.model_fields)
_SETTINGS = COLUMNS[3:]
_SUFFIXES = sorted(writable_suffixes(), key=len, reverse=True)


def read_manifest(
    text: str, where: str, base: str, defaults: Line
) -> tuple[list[Line | BadLine], tuple[str, ...]]:
    """Lines of a manifest in their order, and notes on its columns.

    Parameters
    ----------
    text : str
        Content of the file.
    where : str
        Its name, for messages.
    base : str
        Folder or URL that relative paths begin at.
    defaults : Line
        For empty cells and missing columns.

    Raises
    ------
    DataError
        If it has no column ``audio``, a column twice, no rows or too many.
    """
    header, rows = rows_of_text(
        text, where, error=DataError, once=COLUMNS, most=limits.BATCH_LINES, lower=True
    )
    if "audio" not in header:
        raise DataError(
            f"{where}: no column 'audio' among {quoted(', '.join(header))}; a manifest has the "
            f"columns {', '.join(COLUMNS)}"
        )
    read = _Reader(base, defaults)
    lines = read.linked([read.line(i, row) for i, row in enumerate(rows, 1)])
    if not lines:
        raise DataError(f"{where}: holds no rows; write one for each recording")
    unused = [name for name in header if name and name not in COLUMNS]
    notes = (f"columns of the manifest that are not used: {listed(unused)}",) if unused else ()
    return lines, notes


class _Reader:
    """Rows to lines; rows of equal settings share their objects."""

    def __init__(self, base: str, defaults: Line) -> None:
        self.base, self.defaults = base, defaults
        self._known: dict[tuple[str | None, ...], Line] = {}

    def line(self, place: int, row: Row) -> Line | BadLine:
        audio = row.get("audio", "")
        try:
            if not audio:
                raise DeitalkError("no recording is named in the column audio")
            formats, output = _named(row, audio, self.defaults.written)
            # A line with the settings of a row.
            cells = (*formats, *(row.get(name) for name in _SETTINGS if name not in BESIDE))
            if cells not in self._known:
                self._known[cells] = self._read(row, formats)
            like = self._known[cells]
            beside = {name: row[name] for name in BESIDE if row.get(name)}
            return replace(
                like, number=place, audio=joined(self.base, audio), output=output, beside=beside
            )
        except UserError as error:
            return BadLine(place, audio, row.get("output", ""), str(error))

    def linked(self, lines: list[Line | BadLine]) -> list[Line | BadLine]:
        """The lines, with the takes before and after that are no lines of the batch read."""
        outputs = {line.output for line in lines if isinstance(line, Line)}
        found: list[Line | BadLine] = []
        for line in lines:
            if isinstance(line, Line) and line.beside:
                inside, others = {}, dict(line.beside)
                for name, cell in line.beside.items():
                    with suppress(UserError):
                        if (output := checked_output(cell)) in outputs:
                            inside[name] = output
                            del others[name]
                try:
                    acting = Acting.of(line.acting, files=_Beside(self.base), **others)
                    line = replace(line, acting=acting, beside=inside)
                except UserError as error:
                    line = BadLine(line.number, line.audio, line.output, str(error))
            found.append(line)
        return found

    def _read(self, row: Row, formats: tuple[str, ...]) -> Line:
        cells = {name: row[name] for name in _SETTINGS if row.get(name)}
        alone = [name for name in Acting.model_fields if name not in BESIDE]
        fields = {name: cells[name] for name in alone if name in cells}
        acting = Acting.of(self.defaults.acting, files=_Beside(self.base), **fields)
        form: dict[str, Any] = {"formats": formats}
        if fps := cells.get("fps"):
            form["fps"] = number(fps, "fps", "column")
        if timecode := cells.get("timecode"):
            form["timecode"] = timecode
        for name in ("digits", "delay", "handles"):
            if cell := cells.get(name):  # what is no number is refused with the others
                form[name] = int(cell) if cell.lstrip("+-").isdecimal() else cell
        written = replace(self.defaults.written, **form).checked()
        actor = cells.get("actor", self.defaults.actor)
        signal = {name: cells[name] for name in SIGNAL if name in cells}
        choice = AudioChoice.of(**self.defaults.choice.settings | signal)
        line = replace(self.defaults, acting=acting, written=written, actor=actor, choice=choice)
        given: dict[str, Any] = {name: cells[name] for name in DUBBING if name in cells}
        if not given:
            return replace(line, dubbing=None)
        if "performance" not in given:
            raise DeitalkError(
                f"{', '.join(given)} without a performance; name one, or leave it out"
            )
        for name, cell in given.items():
            is_path = name in DUBBING[:3]
            given[name] = joined(self.base, cell) if is_path else number(cell, name, "column")
        return replace(line, dubbing=Dubbing(**given))


class _Beside(dict[str, Path]):
    """Files by the names that a manifest gives them."""

    def __init__(self, base: str) -> None:
        super().__init__()
        self.base = base

    def __contains__(self, name: object) -> bool:
        return True

    def __getitem__(self, name: str) -> Path:
        return Path(joined(self.base, name))


def _named(row: Row, audio: str, defaults: Written) -> tuple[tuple[str, ...], str]:
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
