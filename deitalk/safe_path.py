"""Nothing of the working folder is imported by the processes that are started.

Python puts the working folder first where it looks for modules in what `multiprocessing` starts
(new processes, the fork server, the resource tracker): a ``struct.py`` there would be executed.
"""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

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
