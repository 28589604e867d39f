"""One process at a time per target, by locks in the user's cache folder."""

import hashlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rig.errors import TargetError


def cache_folder() -> Path:
    """Cache folder: ``$DEITALK_CACHE``, else the system's for this user."""
    if chosen := os.environ.get("DEITALK_CACHE"):
        return Path(chosen)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "deitalk"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "deitalk"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "deitalk"


@contextmanager
def claim(target: Path | str) -> Iterator[None]:
    """Keep other processes and threads of this machine from writing to `target`.

    The thread that holds a target may claim it again. The operating system frees a lock when its
    process ends, however it ends. Where the cache folder cannot be written to (a read-only home),
    there is no lock.

    Parameters
    ----------
    target : Path or str
        File or folder; it need not exist.

    Raises
    ------
    TargetError
        If another process or thread writes to it.
    """
    from filelock import FileLock, Timeout

    name = hashlib.sha256(os.fsencode(os.path.realpath(target))).hexdigest()[:32]
    path = cache_folder() / "locks" / f"{name}.lock"
    lock = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = FileLock(path, timeout=0, is_singleton=True)
        lock.acquire()
    except Timeout:
        raise TargetError(
            f"{target} is being written by another process; wait for it, or name another target"
        ) from None
    except (OSError, RuntimeError):
        lock = None
    try:
        yield
    finally:
        if lock is not None:
            lock.release()
