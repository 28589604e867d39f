"""Files of jobs: a folder, or whatever fsspec reaches, such as an S3 bucket.

::

    deitalk-inputs/<id>/<name>              what a request sent
    deitalk-results/<id>/<holder>-<name>    what a worker made; the table names the one that counts
    deitalk-check-<random>                  empty, for a moment, when a server starts

Other folders of the place are never listed, and never removed.
"""

import secrets
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from time import time
from typing import Any

import fsspec

from api.errors import Problem

INPUTS, RESULTS = "deitalk-inputs", "deitalk-results"
BLOCK_BYTES = 1 << 20
UNKNOWN_SECONDS = 86_400.0


class Store:
    """Files under an fsspec URL or a folder.

    Parameters
    ----------
    url : str
        ``/var/lib/…``, ``s3://bucket/prefix``, ``memory://…``.
    """

    def __init__(self, url: str) -> None:
        # Listings are not kept: other servers add and remove files.
        self.files, self.root = fsspec.core.url_to_fs(url, use_listings_cache=False)
        self.files.makedirs(self.root, exist_ok=True)

    def check(self) -> None:
        """Write an empty file and remove it; raises what the file system raises."""
        path = self._at(f"deitalk-check-{secrets.token_hex(8)}")
        self.files.pipe_file(path, b"")
        self.files.rm_file(path)

    def put_folder(self, folder: Path, job_id: str) -> None:
        """Copy the files of a folder to be a job's inputs."""
        self._make(f"{INPUTS}/{job_id}")
        for path in sorted(path for path in folder.iterdir() if path.is_file()):
            self.files.put_file(str(path), self._at(f"{INPUTS}/{job_id}/{path.name}"))

    def get_folder(self, job_id: str, folder: Path) -> None:
        """Copy a job's inputs into a folder."""
        for name in self.files.ls(self._at(f"{INPUTS}/{job_id}"), detail=False):
            self.files.get_file(name, str(folder / name.rpartition("/")[2]))

    def put_result(self, path: Path, job_id: str, holder: str) -> str:
        """Copy a result; return its name."""
        name = f"{RESULTS}/{job_id}/{holder}-{path.name}"
        self._make(f"{RESULTS}/{job_id}")
        self.files.put_file(str(path), self._at(name))
        return name

    def read(self, name: str, begin: int, end: int, size: int) -> Iterator[bytes]:
        """Open a file of `size` bytes; return those from `begin` to before `end`, in blocks.

        Raises
        ------
        Problem
            410 if it is not there any more, or not whole.
        """
        try:
            file = self.files.open(self._at(name), "rb")
        except FileNotFoundError:
            raise Problem(410, "the file of the result is gone; send the job again") from None
        if file.size is not None and file.size < size:
            file.close()
            raise Problem(410, "the file of the result is not whole; send the job again")

        def blocks(at: int = begin) -> Iterator[bytes]:
            with file:
                file.seek(at)
                while at < end and (block := file.read(min(BLOCK_BYTES, end - at))):
                    at += len(block)
                    yield block

        return blocks()

    def remove(self, job_id: str) -> None:
        """Remove all files of a job."""
        for kind in (INPUTS, RESULTS):
            self._remove(self._at(f"{kind}/{job_id}"))

    def remove_inputs(self, job_id: str) -> None:
        """Remove what a job's request sent."""
        self._remove(self._at(f"{INPUTS}/{job_id}"))

    def jobs(self) -> set[str]:
        """Ids of all jobs that have files."""
        found: set[str] = set()
        for kind in (INPUTS, RESULTS):
            if self.files.exists(self._at(kind)):
                listed = self.files.ls(self._at(kind), detail=False, refresh=True)
                found |= {name.rstrip("/").rpartition("/")[2] for name in listed}
        return found

    def age(self, job_id: str) -> float:
        """Age of the newest file of a job, seconds; a day where that is unknown.

        A folder without files counts itself: its first file may be on its way.
        """
        newest = 0.0
        for kind in (INPUTS, RESULTS):
            folder = self._at(f"{kind}/{job_id}")
            if self.files.exists(folder):
                found = self.files.find(folder, detail=True) or {folder: self.files.info(folder)}
                newest = max(newest, *(_written(about) for about in found.values()))
        return time() - newest if newest else UNKNOWN_SECONDS

    def _at(self, name: str) -> str:
        return f"{self.root.rstrip('/')}/{name}"

    def _make(self, name: str) -> None:
        self.files.makedirs(self._at(name), exist_ok=True)

    def _remove(self, path: str) -> None:
        try:
            self.files.rm(path, recursive=True)
        except FileNotFoundError:
            return
        invalidate: Any = getattr(self.files, "invalidate_cache", lambda: None)
        invalidate()


def _written(about: dict[str, Any]) -> float:
    """Time at which a file was written, as file systems name it; now if they do not."""
    found = about.get("mtime", about.get("LastModified", about.get("created")))
    if isinstance(found, datetime):
        return found.timestamp()
    return float(found) if isinstance(found, int | float) else time()
