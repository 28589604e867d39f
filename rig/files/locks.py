"""Locks on files that the operating system frees when their process ends, however it ends."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

POLL_SECONDS = 0.05
"""Between two tries on Windows, whose locks do not wait for long."""


@contextmanager
def locked(path: Path, *, waits: bool = False) -> Iterator[None]:
    """Hold the lock on a file, which is made if it is not there and never removed.

    Every other block is kept out, of this process or another one.

    Raises
    ------
    BlockingIOError
        If another block holds it, unless this one `waits`.
    """
    with path.open("ab") as file:
        _lock(file.fileno(), waits)
        try:
            yield
        finally:
            if sys.platform != "win32":  # forked processes have the file open still
                fcntl.flock(file, fcntl.LOCK_UN)


def _lock(number: int, waits: bool) -> None:
    if sys.platform == "win32":
        while not _taken(number):
            if not waits:
                raise BlockingIOError
            time.sleep(POLL_SECONDS)
    else:
        fcntl.flock(number, fcntl.LOCK_EX | (0 if waits else fcntl.LOCK_NB))


def _taken(number: int) -> bool:
    """Take a lock on Windows, if it is free."""
    if sys.platform == "win32":
        with suppress(OSError):
            msvcrt.locking(number, msvcrt.LK_NBLCK, 1)
            return True
    return False
