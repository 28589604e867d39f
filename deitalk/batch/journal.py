"""Journal of a batch: what was written, from what; an SQLite file in the output folder.

The files of a line are entered with their hashes before they get their names, so that after ``kill
-9`` every file in the output folder is either known here or not of the batch.

::

    about   format, source of the batch
    lines   one row for each output: recording, key, state, result
    files   path, hash, size, time; `is_new` until the line is done
    voice_strengths   measured on recordings for references of actors
"""

import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from deitalk.batch.orders import File
from deitalk.pipeline.actor_voice import MeasuredVoice
from rig.errors import TargetError

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
            with self._errors():
                run = self._database.execute
                run("PRAGMA locking_mode = EXCLUSIVE")  # WAL without shared memory: on any disk
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
        except BaseException:
            self.close()  # else its lock stays until the object is collected
            raise

    def close(self) -> None:
        """Write everything into the one file and close it."""
        self._database.close()

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
