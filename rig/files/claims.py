"""One process at a time per target, by locks in the user's cache folder."""

import hashlib
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from rig.errors import TargetError
from rig.files.locks import locked

_holders: set[tuple[str, int]] = set()
"""Claimed targets, by the names of their locks, and the threads that hold them."""


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
    name = hashlib.sha256(os.fsencode(os.path.realpath(target))).hexdigest()[:32]
    path, holder = cache_folder() / "locks" / f"{name}.lock", (name, threading.get_ident())
    with ExitStack() as held:
        if holder not in _holders:
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                held.enter_context(locked(path))
            except BlockingIOError:
                raise TargetError(
                    f"{target} is being written by another process; wait for it, or name another "
                    "target"
                ) from None
            except OSError:
                pass
            _holders.add(holder)
            held.callback(_holders.discard, holder)
        yield
