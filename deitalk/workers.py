"""Worker processes that end with their parent: by an error, a signal or ``kill -9``."""

import os
import sys
import threading
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait

WORKER_START = "fork" if sys.platform == "linux" else "spawn"
"""How the processes of a `DataLoader` start: a fork has the data and what cannot be pickled. It is
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
