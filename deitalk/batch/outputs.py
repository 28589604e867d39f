"""Files of a batch in its output folder, none of the user's replaced; the journal of them."""

import os
import shutil
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from deitalk.batch.orders import File, Outcome
from deitalk.pipeline.performance import KIND as TAKE_KIND
from deitalk.pipeline.speech import MeasuredVoice
from rig import limits
from rig.errors import TargetError
from rig.files import (
    atomic_write,
    begin_folder,
    check_folder,
    claim,
    output_folder,
    recover,
    replace_recorded,
)
from rig.files.folder import MANIFEST, digest_of
from rig.files.reading import read_bytes

# Journal of a batch: what was written, from what; an SQLite file in the output folder.
#
# A line's files are entered with their hashes before they get their names, so that after ``kill
# -9`` every file in the output folder is either known here or not of the batch.
#
# ::
#
#     about   format, source of the batch
#     lines   one row for each output: recording, key, state, result
#     files   path, hash, size, time; `is_new` until the line is done
#     voice_strengths   measured on recordings for references of actors


FORMAT = "1"
_TABLES = """
CREATE TABLE IF NOT EXISTS about (name TEXT PRIMARY KEY, value TEXT) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS lines (
    output TEXT PRIMARY KEY, audio TEXT, signature TEXT, sound TEXT, key TEXT, state TEXT,
    seconds REAL, frames INTEGER, warnings TEXT, error TEXT
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS files (
    path TEXT, sha TEXT, size INTEGER, mtime INTEGER, output TEXT, is_new INTEGER,
    PRIMARY KEY (path, sha)
) WITHOUT ROWID;
CREATE INDEX IF NOT EXISTS files_of ON files (output);
CREATE TABLE IF NOT EXISTS voice_strengths (
    audio TEXT PRIMARY KEY, signature TEXT, strength REAL, effort REAL, seconds REAL
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS edges (output TEXT PRIMARY KEY, first TEXT, last TEXT) WITHOUT ROWID;
"""

PLACING, DONE, FAILED = "placing", "done", "failed"
"""States of a line: its files are on the way to their names, are there, could not be made."""


@dataclass(slots=True)
class Entry:
    """A row of ``lines``."""

    output: str
    audio: str
    signature: str = ""
    """Size and time of the recording, by which an unchanged one is recognised unread."""
    sound: str = ""
    """SHA-256 of the recording."""
    key: str = ""
    state: str = ""
    seconds: float = 0.0
    frames: int = 0
    warnings: str = ""
    """One a line."""
    error: str = ""


_NAMES = tuple(f.name for f in fields(Entry))


class Journal:
    """The open journal; one process at a time.

    Parameters
    ----------
    path : Path
        Made if it does not exist; its folder must.
    folder : Path or str
        The output folder, for messages.

    Raises
    ------
    TargetError
        If it is damaged, of another format or open elsewhere.
    """

    def __init__(self, path: Path, folder: Path | str) -> None:
        self.path, self.folder = path, folder
        with self._errors():
            self._database = sqlite3.connect(path, timeout=1.0, isolation_level=None)
        try:
            self._prepare()
        except BaseException:
            self.close()  # else its lock stays until the object is collected
            raise

    def _prepare(self) -> None:
        """Lock the file, make what it lacks, and check its format."""
        with self._errors():
            run = self._database.execute
            run("PRAGMA locking_mode = EXCLUSIVE")  # WAL without shared memory: on any file system
            run("PRAGMA journal_mode = WAL")
            run("PRAGMA synchronous = NORMAL")
            self._database.executescript(_TABLES)
        found = self.about("format")
        if found is None:
            with self.transaction():
                self.describe("format", FORMAT)
        elif found != FORMAT:
            raise TargetError(
                f"{self.folder} was written by another version of deitalk (journal {found}, "
                f"this reads {FORMAT}); name another folder"
            )

    def close(self) -> None:
        """Write everything into the one file and close it."""
        self._database.close()

    def copy(self, path: Path) -> None:
        """Copy everything into another file."""
        with self._errors():
            path.unlink(missing_ok=True)
            self._database.execute("VACUUM INTO ?", (str(path),))

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Make the changes of the block at once or not at all."""
        with self._errors():
            self._database.execute("BEGIN IMMEDIATE")
            try:
                yield
            except BaseException:
                self._database.execute("ROLLBACK")
                raise
            self._database.execute("COMMIT")

    def about(self, name: str) -> str | None:
        """A value of ``about``."""
        row = self._one("SELECT value FROM about WHERE name = ?", name)
        return None if row is None else str(row[0])

    def describe(self, name: str, value: str) -> None:
        """Set a value of ``about``."""
        self._run("INSERT OR REPLACE INTO about VALUES (?, ?)", name, value)

    def entry(self, output: str) -> Entry | None:
        """The row of an output."""
        row = self._one(f"SELECT {', '.join(_NAMES)} FROM lines WHERE output = ?", output)
        return None if row is None else Entry(*row)

    def entries(self, state: str) -> list[Entry]:
        """All rows in a state."""
        query = f"SELECT {', '.join(_NAMES)} FROM lines WHERE state = ?"
        with self._errors():
            return [Entry(*row) for row in self._database.execute(query, (state,))]

    def write(self, entry: Entry) -> None:
        """Add or replace a row."""
        marks = ", ".join("?" * len(_NAMES))
        values = (getattr(entry, name) for name in _NAMES)
        self._run(f"INSERT OR REPLACE INTO lines ({', '.join(_NAMES)}) VALUES ({marks})", *values)

    def files(self, output: str, *, new: bool) -> list[File]:
        """Files of an output: those of its last result, or (`new`) those on their way."""
        query = "SELECT path, sha, size, mtime FROM files WHERE output = ? AND is_new = ?"
        with self._errors():
            return [File(*row) for row in self._database.execute(query, (output, int(new)))]

    def hashes(self, path: str) -> list[File]:
        """Every content that the batch may have given to a path."""
        query = "SELECT path, sha, size, mtime FROM files WHERE path = ?"
        with self._errors():
            return [File(*row) for row in self._database.execute(query, (path,))]

    def announce(self, output: str, files: Iterable[File]) -> None:
        """Enter files before they get their names."""
        for file in files:
            row = (*file, output, 1)
            self._run("INSERT OR REPLACE INTO files VALUES (?, ?, ?, ?, ?, ?)", *row)

    def settle(self, output: str) -> None:
        """Make the announced files of an output its result, in place of those before."""
        self._run("DELETE FROM files WHERE output = ? AND is_new = 0", output)
        self._run("UPDATE files SET is_new = 0 WHERE output = ?", output)

    def voice(self, audio: str, signature: str) -> MeasuredVoice | None:
        """Voice of a recording, if it was measured."""
        query = "SELECT strength, effort, seconds FROM voice_strengths"
        row = self._one(f"{query} WHERE audio = ? AND signature = ?", audio, signature)
        return None if row is None else MeasuredVoice(*row)

    def write_voice(self, audio: str, signature: str, voice: MeasuredVoice) -> None:
        """Keep the voice of a recording."""
        row = (audio, signature, *voice)
        self._run("INSERT OR REPLACE INTO voice_strengths VALUES (?, ?, ?, ?, ?)", *row)

    def edges(self, output: str) -> tuple[str, str] | None:
        """First and last edge of the take of an output, if a line needed them."""
        row = self._one("SELECT first, last FROM edges WHERE output = ?", output)
        return None if row is None else (str(row[0]), str(row[1]))

    def write_edges(self, output: str, edges: tuple[str, str]) -> None:
        """Keep the edges of an output."""
        self._run("INSERT OR REPLACE INTO edges VALUES (?, ?, ?)", output, *edges)

    def _run(self, query: str, *values: Any) -> None:
        with self._errors():
            self._database.execute(query, values)

    def _one(self, query: str, *values: Any) -> Any:
        with self._errors():
            return self._database.execute(query, values).fetchone()

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.OperationalError as error:
            if "locked" in str(error):
                raise TargetError(
                    f"{self.folder} is being written by another process; wait for it, "
                    "or name another folder"
                ) from None
            raise TargetError(
                f"cannot write {self.path}: {error}; free space and run the same batch again, the "
                "finished lines are kept"
            ) from None
        except sqlite3.DatabaseError as error:
            raise TargetError(
                f"{self.path} is damaged ({error}), so what the batch wrote is unknown; name "
                "another folder"
            ) from None


KIND = "batch"
"""Kind of the output folder in its manifest."""
PRIVATE = ".deitalk-batch"
"""Folder of the journal and of unfinished files."""


class Outputs:
    """Results of lines below one folder.

    Parameters
    ----------
    folder : Path
        The output folder.
    journal : Journal
        Of that folder.
    """

    def __init__(self, folder: Path, journal: Journal) -> None:
        self.folder, self.journal = folder, journal
        self.stage, self.url = str(folder / PRIVATE / "stage"), ""
        self._made: set[Path] = set()

    def begin(self) -> None:
        """Finish what a killed process placed, or leave it to be made again."""
        shutil.rmtree(self.stage, ignore_errors=True)
        os.makedirs(self.stage)
        for entry in self.journal.entries(PLACING):
            recover(self.folder / entry.output)
            new = self.journal.files(entry.output, new=True)
            if new and all(self._state(file) == "intact" for file in new):
                self._finish([entry])

    def state(self, output: str) -> str:
        """Whether the files of a finished line are ``intact``, ``missing`` or ``edited``."""
        states = {self._state(file) for file in self.journal.files(output, new=False)}
        return next((s for s in ("missing", "edited") if s in states), "intact")

    def check_free(self, targets: Sequence[str]) -> None:
        """Refuse targets where files lie that the batch did not write.

        Raises
        ------
        TargetError
            If there is one, or one was changed since it was written.
        """
        for target in targets:
            path = self.folder / target
            if not os.path.lexists(path):
                self._check_above(path)
            elif path.is_dir() and not path.is_symlink() and not path.suffix:
                self._check_take(path, target)
            elif not self._is_own(target):
                raise TargetError(
                    f"{path} was not written by this batch, or was changed since; move it away, or "
                    "name another output"
                )

    def announce(self, entries: Sequence[Entry]) -> None:
        """Nothing: files are entered before they get their names."""

    def place(self, results: Sequence[tuple[Entry, Outcome]]) -> None:
        """Give staged files their names and enter the results, all in two transactions."""
        good = []
        with self.journal.transaction():
            for entry, outcome in results:
                if outcome.files:
                    entry.state = PLACING
                    self.journal.announce(entry.output, outcome.files)
                    good.append((entry, outcome))
                self.journal.write(entry)
        placed = []
        for entry, outcome in good:
            try:
                self._move(Path(outcome.stage), outcome)
            except TargetError as error:  # the user changed it meanwhile
                entry.state, entry.error = FAILED, str(error)
                with self.journal.transaction():
                    self.journal.write(entry)
            else:
                placed.append(entry)
        self._finish(placed)

    def reference(self, name: str) -> bytes | None:
        """Content of a reference of an actor."""
        path = self.folder / name
        return read_bytes(path, limits.TRACK_JSON_BYTES) if path.is_file() else None

    def keep_reference(self, name: str, text: str) -> None:
        """Write a reference of an actor."""
        (self.folder / name).parent.mkdir(exist_ok=True)
        with atomic_write(self.folder / name) as beside:
            beside.write_text(text, encoding="utf-8")

    def has_table(self, name: str) -> bool:
        """Whether a table is there."""
        return (self.folder / name).is_file()

    def write_table(self, name: str, text: str) -> None:
        """Write a table.

        Raises
        ------
        TargetError
            If the user changed it.
        """
        replace_recorded(self.folder, name, text)

    def _finish(self, entries: Sequence[Entry]) -> None:
        """Remove what lines no longer write, and enter them as done."""
        for entry in entries:
            new = {file.path for file in self.journal.files(entry.output, new=True)}
            for file in self.journal.files(entry.output, new=False):
                if file.path not in new and self._state(file) == "intact":
                    (self.folder / file.path).unlink(missing_ok=True)
                    with suppress(OSError):
                        (self.folder / file.path).parent.rmdir()
        with self.journal.transaction():
            for entry in entries:
                self.journal.settle(entry.output)
                entry.state = DONE
                self.journal.write(entry)

    def _move(self, stage: Path, outcome: Outcome) -> None:
        for target in outcome.targets:
            source, path = stage / target.name, self.folder / target.path
            self.check_free([target.path])
            if path.parent not in self._made:
                path.parent.mkdir(parents=True, exist_ok=True)
                self._made.add(path.parent)
            if source.is_dir() and path.is_dir():
                self._exchange(source, path)
            else:
                os.replace(source, path)
        shutil.rmtree(stage, ignore_errors=True)

    def _exchange(self, source: Path, folder: Path) -> None:
        """Replace the files of a take; others in its folder stay."""
        with output_folder(folder, kind=TAKE_KIND, force=True) as stage:
            for name in os.listdir(source):
                if name != MANIFEST:
                    os.replace(source / name, stage / name)

    def _state(self, file: File) -> str:
        """Whether a file is as it was written."""
        path = self.folder / file.path
        try:
            found = path.lstat()
        except OSError:
            return "missing"
        if found.st_size == file.size and found.st_mtime_ns == file.mtime:
            return "intact"
        is_same = found.st_size == file.size and path.is_file() and digest_of(path) == file.sha
        return "intact" if is_same else "edited"

    def _is_own(self, target: str) -> bool:
        return any(self._state(file) == "intact" for file in self.journal.hashes(target))

    def _check_take(self, path: Path, target: str) -> None:
        """A folder may be filled if its take is of the batch and unchanged, or it holds nothing."""
        recover(path)
        check_folder(path, kind=TAKE_KIND, force=True)
        if any(path.iterdir()) and not self._is_own(f"{target}/take.json"):
            raise TargetError(
                f"{path} is a take that this batch did not write; move it away, or name another "
                "output"
            )

    def _check_above(self, path: Path) -> None:
        """Folders above a new file must be folders."""
        for parent in path.parents:
            if parent == self.folder or parent in self._made:
                return
            if parent.exists():
                if not parent.is_dir():
                    raise TargetError(f"{parent} is a file; name another output")
                return


@contextmanager
def opened_folder(out: Path) -> Iterator[Outputs]:
    """The outputs in a folder that no other process writes to.

    Raises
    ------
    TargetError
        If another process writes there, the folder holds files of others, or a table was edited.
    """
    with claim(out):
        begin_folder(out, kind=KIND)
        (out / PRIVATE).mkdir(exist_ok=True)
        with closing(Journal(out / PRIVATE / "journal.sqlite", out)) as journal:
            outputs = Outputs(out, journal)
            yield outputs
            shutil.rmtree(outputs.stage, ignore_errors=True)
