"""One process at a time per target, by locks in the user's cache folder."""

import hashlib
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rig.errors import TargetError

_held: dict[str, tuple[Any, int, int]] = {}  # path: lock, thread, depth
_guard = threading.Lock()


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
    key = os.path.realpath(target)
    _acquire(key, Path(target))
    try:
        yield
    finally:
        _release(key)


def _acquire(key: str, target: Path) -> None:
    thread = threading.get_ident()
    with _guard:
        if key in _held:
            lock, owner, depth = _held[key]
            if owner != thread:
                raise _busy(target)
            _held[key] = (lock, owner, depth + 1)
            return
        _held[key] = (_lock(key, target), thread, 1)


def _lock(key: str, target: Path) -> Any:
    """An acquired lock, or None where locks cannot be made."""
    from filelock import FileLock, Timeout

    name = hashlib.sha256(os.fsencode(key)).hexdigest()[:32]
    path = cache_folder() / "locks" / f"{name}.lock"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = FileLock(path, timeout=0, thread_local=False)
        lock.acquire()
    except Timeout:
        raise _busy(target) from None
    except (OSError, RuntimeError):
        return None
    return lock


def _busy(target: Path) -> TargetError:
    return TargetError(
        f"{target} is being written by another process; wait for it, or name another target"
    )


def _release(key: str) -> None:
    with _guard:
        lock, owner, depth = _held[key]
        if depth > 1:
            _held[key] = (lock, owner, depth - 1)
            return
        del _held[key]
        if lock is not None:
            lock.release()
