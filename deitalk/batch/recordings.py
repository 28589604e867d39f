"""Recordings of a batch, in files or at URLs: their state, and their content."""

import hashlib
import os
from contextlib import suppress
from pathlib import Path

from deitalk.batch.cloud import cloud_errors, file_system, is_url, version_of
from deitalk.errors import AudioError
from rig import limits

IN_MEMORY_BYTES = 64 * limits.MIB
"""Largest recording on disk that is hashed and decoded from one reading."""


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
            folder = audio.rpartition("/")[0]
            if is_url(audio) and folder not in self._listed:
                self._listed.add(folder)
                system, path = file_system(folder)
                with cloud_errors(folder):
                    infos = system.ls(path, detail=True) if system.isdir(path) else []
                for info in infos:
                    self._known[f"{folder}/{info['name'].rpartition('/')[2]}"] = version_of(info)
            elif not is_url(audio):
                with suppress(OSError, ValueError):
                    state = os.stat(audio)
                    found = f"{state.st_size}-{state.st_mtime_ns}"
            self._known.setdefault(audio, found)
        return self._known[audio]

    def size(self, audio: str) -> float:
        """Bytes of a recording; 0 if it is not there."""
        return float(self.signature(audio).partition("-")[0] or 0)


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
