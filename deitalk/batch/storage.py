"""Files on this machine or wherever fsspec reaches: ``s3://bucket/lines``, ``gs://…``, ``memory://…``.

The package of a service comes with its own client, such as ``s3fs`` or ``gcsfs``.
"""

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from deitalk.batch.journal import File
from deitalk.errors import AudioError, DataError, MissingError
from rig import limits
from rig.errors import UserError, one_line

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
            if is_url(audio):
                self._list(audio.rpartition("/")[0])
                self._known.setdefault(audio, "")
            else:
                self._known[audio] = _local_signature(audio)
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


def _local_signature(audio: str) -> str:
    try:
        found = os.stat(audio)
    except (OSError, ValueError):
        return ""
    return f"{found.st_size}-{found.st_mtime_ns}"


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
