"""Worker processes: they end with their parent, and import nothing from the working folder.

Python puts the working folder first where it looks for modules in what `multiprocessing` starts
(new processes, the fork server, the resource tracker): a ``struct.py`` there would be executed.
"""

import multiprocessing
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.context import BaseContext, SpawnContext, SpawnProcess

SAFE_PATH = "PYTHONSAFEPATH"
"""With this variable Python leaves the working folder out."""
_lock = threading.Lock()
_given: list[str | None] = []
"""Values of `SAFE_PATH` before each of the blocks that are being executed."""


@contextmanager
def safe_path() -> Iterator[None]:
    """Every Python that is started in the block imports nothing from the working folder."""
    with _lock:
        _given.append(os.environ.get(SAFE_PATH))
        os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        with _lock:
            # Blocks of several threads may end in any order; the last one has the first value.
            given = _given.pop()
            if given is None:
                del os.environ[SAFE_PATH]
            else:
                os.environ[SAFE_PATH] = given


class _NewProcess(SpawnProcess):
    def start(self) -> None:
        with safe_path():
            super().start()


class _NewProcesses(SpawnContext):
    Process = _NewProcess


NEW_PROCESSES = _NewProcesses()
"""Context of processes that begin anew, on every system."""

if sys.platform == "win32":
    FORK_SERVER: BaseContext = NEW_PROCESSES
else:
    from multiprocessing.context import ForkServerContext, ForkServerProcess

    class _ForkedProcess(ForkServerProcess):
        def start(self) -> None:
            with safe_path():  # it may start the server again
                super().start()

    class _ForkServer(ForkServerContext):
        Process = _ForkedProcess

    FORK_SERVER = _ForkServer()
    """Context of processes that are forked from one that has imported what they need."""

DATA_WORKERS = multiprocessing.get_context("fork") if sys.platform == "linux" else NEW_PROCESSES
"""Context of the processes of a `DataLoader`: a fork has the data and what cannot be pickled. It is
Python's own choice up to 3.13."""


def end_with_parent(worker_id: int = 0) -> None:
    """End this process when its parent does; as ``worker_init_fn`` of a `DataLoader`."""
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=exit_after, args=(parent.sentinel,), daemon=True).start()


def exit_after(end: Connection | int) -> None:
    """End this process when a pipe is closed or another process has ended."""
    wait([end])
    os._exit(1)
