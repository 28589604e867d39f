"""Recordings and outputs of a batch in a storage service that fsspec reaches; the workers upload.

A file there cannot be moved at once, so the lines to make are entered in the journal before any is
animated; what lies at their outputs after a killed run is taken for the batch's own. SQLite needs a
disk: the journal is in the user's cache folder, and is copied to the output folder every five
minutes and at the end, from where another machine goes on.
"""

import hashlib
import os
import secrets
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import Any, TypeAlias

from deitalk.batch.journal import DONE, PLACING, Entry, Journal
from deitalk.batch.orders import File, Outcome
from deitalk.batch.outputs import PRIVATE, Outputs
from deitalk.errors import AudioError, DataError, MissingError
from rig import limits
from rig.errors import TargetError, UserError, one_line
from rig.files import cache_folder, claim

IN_MEMORY_BYTES = 64 * limits.MIB
"""Largest recording on disk that is hashed and decoded from one reading."""
_VERSIONS = (
    "ETag", "etag", "md5Hash", "content_md5", "mtime", "LastModified", "last_modified", "updated",
    "created",
)  # fmt: skip
"""Entries of file information that change with the content, the best first."""


def is_url(path: str | Path) -> bool:
    """Whether a path is one that fsspec reads."""
    return "://" in str(path)


@contextmanager
def cloud_errors(url: str) -> Iterator[None]:
    """Turn errors of a storage service into one line."""
    try:
        yield
    except UserError:
        raise
    except FileNotFoundError:
        raise DataError(f"{url} does not exist; check the address") from None
    except ImportError as error:
        raise MissingError(one_line(f"{url}: {error}")) from None
    except Exception as error:  # every service has its own
        text = f"{url}: {type(error).__name__}: {error}; check the address and the access"
        raise DataError(one_line(text)) from None


def file_system(url: str) -> tuple[Any, str]:
    """Fsspec's file system of a URL, and the path in it."""
    import fsspec

    with cloud_errors(url):
        system, path = fsspec.core.url_to_fs(url)
        return system, path.rstrip("/")


def version_of(info: dict[str, Any]) -> str:
    """State of a file in a storage service: size, and what changes with its content."""
    changing = next((info[name] for name in _VERSIONS if info.get(name)), "")
    if hasattr(changing, "timestamp"):  # one service gives a time in two ways
        changing = changing.timestamp()
    if isinstance(changing, float):
        changing = f"{changing:.3f}"
    return f"{info.get('size') or 0}-{changing}"


class Recordings:
    """Signatures of recordings: size and time, by which an unchanged one is recognised unread.

    A folder in a storage service is listed once.
    """

    def __init__(self) -> None:
        self._known: dict[str, str] = {}
        self._listed: set[str] = set()

    def signature(self, audio: str) -> str:
        """Size and time of a recording, divided by ``-``; empty if it is not there."""
        if audio not in self._known:
            found = ""
            if is_url(audio):
                self._list(audio.rpartition("/")[0])
            else:
                with suppress(OSError, ValueError):
                    state = os.stat(audio)
                    found = f"{state.st_size}-{state.st_mtime_ns}"
            self._known.setdefault(audio, found)
        return self._known[audio]

    def size(self, audio: str) -> float:
        """Bytes of a recording; 0 if it is not there."""
        return float(self.signature(audio).partition("-")[0] or 0)

    def _list(self, folder: str) -> None:
        if folder in self._listed:
            return
        self._listed.add(folder)
        system, path = file_system(folder)
        with cloud_errors(folder):
            found = system.ls(path, detail=True) if system.isdir(path) else []
        for info in found:
            name = info["name"].rpartition("/")[2]
            self._known[f"{folder}/{name}"] = version_of(info)


def read_recording(audio: str) -> tuple[bytes | None, str]:
    """Content of a recording (None: too large to be held twice) and its SHA-256.

    Raises
    ------
    AudioError, DataError
        If it cannot be read.
    """
    if is_url(audio):
        system, path = file_system(audio)
        with cloud_errors(audio):
            if system.size(path) > limits.STREAM_BYTES:
                raise AudioError(f"{audio} is larger than 2 GiB; split it into shorter files")
            data = system.cat_file(path)
        return data, hashlib.sha256(data).hexdigest()
    from deitalk.audio.load import check_path

    check_path(Path(audio))
    with open(audio, "rb") as file:
        if os.fstat(file.fileno()).st_size > IN_MEMORY_BYTES:
            return None, hashlib.file_digest(file, "sha256").hexdigest()
        data = file.read()
    return data, hashlib.sha256(data).hexdigest()


def upload(url: str, source: Path, file: File) -> File:
    """Copy a staged file to its place below a URL; its version there is its hash."""
    system, root = file_system(url)
    path = f"{root}/{file.path}"
    with cloud_errors(f"{url}/{file.path}"):
        system.makedirs(path.rpartition("/")[0], exist_ok=True)
        system.put_file(str(source), path)
        return File(file.path, version_of(system.info(path)), file.size, 0)


SAVE_SECONDS = 300.0
"""Time between two copies of the journal."""
_JOURNAL, _STAMP = f"{PRIVATE}/journal.sqlite", f"{PRIVATE}/stamp"


class CloudOutputs:
    """Results of lines below a URL; methods as those of `deitalk.batch.outputs.Outputs`."""

    stage = ""
    """Workers use temporary folders of their machines."""

    def __init__(self, url: str, journal: Journal) -> None:
        self.folder = self.url = url.rstrip("/")
        self.journal = journal
        self.system, self.root = file_system(url)
        self._there: dict[str, str] = {}
        self._saved = monotonic()

    def begin(self) -> None:
        """List what is there."""
        with cloud_errors(self.url):
            self.system.invalidate_cache()
            found = self.system.find(self.root, detail=True)
        start = len(self.root) + 1
        self._there = {name[start:]: version_of(info) for name, info in found.items()}

    def state(self, output: str) -> str:
        """Whether the files of a finished line are ``intact``, ``missing`` or ``edited``."""
        files = self.journal.files(output, new=False)
        if any(file.path not in self._there for file in files):
            return "missing"
        return "intact" if all(self._there[f.path] == f.sha for f in files) else "edited"

    def check_free(self, targets: Sequence[str]) -> None:
        """Refuse targets where files lie that the batch did not write.

        Raises
        ------
        TargetError
            If there is one, or one was changed since it was written.
        """
        own = {entry.output for entry in self.journal.entries(PLACING)} if self._there else set()
        for target in targets:
            if any(target == output or target.startswith(f"{output}.") for output in own):
                continue
            for path in (target, *(p for p in self._there if p.startswith(f"{target}/"))):
                version = self._there.get(path)
                if version and all(file.sha != version for file in self.journal.hashes(path)):
                    raise TargetError(
                        f"{self.url}/{path} was not written by this batch, or was changed since; "
                        "move it away, or name another output"
                    )

    def announce(self, entries: Sequence[Entry]) -> None:
        """Enter lines before they are animated."""
        with self.journal.transaction():
            for entry in entries:
                self.journal.write(replace(entry, state=PLACING))
        self.save()

    def place(self, results: Sequence[tuple[Entry, Outcome]]) -> None:
        """Enter results whose files are there, and remove what lines no longer write."""
        for entry, outcome in results:
            if outcome.files:
                kept = {file.path for file in outcome.files}
                for file in self.journal.files(entry.output, new=False):
                    if file.path not in kept and self._there.get(file.path) == file.sha:
                        with cloud_errors(self.url):
                            self.system.rm_file(f"{self.root}/{file.path}")
        with self.journal.transaction():
            for entry, outcome in results:
                if outcome.files:
                    self.journal.announce(entry.output, outcome.files)
                    self.journal.settle(entry.output)
                    entry.state = DONE
                self.journal.write(entry)
        if monotonic() - self._saved > SAVE_SECONDS:
            self.save()

    def reference(self, name: str) -> bytes | None:
        """Content of a reference of an actor."""
        if name not in self._there:
            return None
        with cloud_errors(f"{self.url}/{name}"):
            content: bytes = self.system.cat_file(f"{self.root}/{name}")
        return content

    def keep_reference(self, name: str, text: str) -> None:
        """Write a reference of an actor."""
        self._put(name, text.encode())

    def has_table(self, name: str) -> bool:
        """Whether a table is there."""
        return name in self._there

    def write_table(self, name: str, text: str) -> None:
        """Write a table; one that is there must be the batch's.

        Raises
        ------
        TargetError
            If the user changed it.
        """
        known = self.journal.about(f"version of {name}")
        if self._there.get(name, known) != known:
            raise TargetError(
                f"{self.url}/{name} was not written by this batch, or was changed since; move it "
                "away"
            )
        version = self._put(name, text.encode())
        with self.journal.transaction():
            self.journal.describe(f"version of {name}", version)

    def save(self) -> None:
        """Copy the journal to the service."""
        stamp = secrets.token_hex(8)
        with self.journal.transaction():
            self.journal.describe("stamp", stamp)
        copy = self.journal.path.with_name("copy.sqlite")
        self.journal.copy(copy)
        with cloud_errors(self.url):
            self.system.makedirs(f"{self.root}/{PRIVATE}", exist_ok=True)
            self.system.put_file(str(copy), f"{self.root}/{_JOURNAL}")
            self.system.pipe_file(f"{self.root}/{_STAMP}", stamp.encode())
        copy.unlink()
        self._saved = monotonic()

    def _put(self, name: str, content: bytes) -> str:
        path = f"{self.root}/{name}"
        with cloud_errors(f"{self.url}/{name}"):
            self.system.makedirs(path.rpartition("/")[0], exist_ok=True)
            self.system.pipe_file(path, content)
            return version_of(self.system.info(path))


AnyOutputs: TypeAlias = Outputs | CloudOutputs
"""Results in a folder or at a URL."""


@contextmanager
def opened_cloud(url: str) -> Iterator[CloudOutputs]:
    """The outputs at a URL, with the newest journal; copied there at the end.

    Raises
    ------
    TargetError
        If another process of this machine writes there, or files of others lie there.
    """
    name = hashlib.sha256(url.rstrip("/").encode()).hexdigest()[:32]
    path = cache_folder() / "batch" / name / "journal.sqlite"
    path.parent.mkdir(parents=True, exist_ok=True)
    with claim(path.parent):
        _fetch(url, path)
        with closing(Journal(path, url)) as journal:
            outputs = CloudOutputs(url, journal)
            yield outputs
            outputs.save()


def _fetch(url: str, path: Path) -> None:
    """Take the journal of the service, if it is not the one that this machine saved there."""
    system, root = file_system(url)
    with cloud_errors(url):
        system.invalidate_cache()
        if not system.exists(f"{root}/{_STAMP}"):
            if system.isdir(root) and system.find(root):
                raise TargetError(f"{url} holds files that deitalk did not write; name another")
            _remove_journal(path)
            return
        stamp = system.cat_file(f"{root}/{_STAMP}").decode()
    if path.is_file():
        with closing(Journal(path, url)) as journal:
            if journal.about("stamp") == stamp:
                return
    _remove_journal(path)
    with cloud_errors(url):
        system.get_file(f"{root}/{_JOURNAL}", str(path))


def _remove_journal(path: Path) -> None:
    for suffix in ("", "-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)
