"""A pool of worker processes that end with their parent.

A pool of the standard library waits for running tasks, and its workers outlive a killed parent;
both would write into folders that the next command uses.
"""

import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import Connection

from deitalk.safe_path import safe_path
from deitalk.workers import NEW_PROCESSES, exit_after


@contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool of new processes that end at once if the block fails or this process ends.

    Parameters
    ----------
    workers : int
        Processes, 1 or more.
    """
    reader, writer = NEW_PROCESSES.Pipe(duplex=False)
    with safe_path():  # its locks start a resource tracker
        pool = ProcessPoolExecutor(workers, NEW_PROCESSES, _end_with, (reader,))
    try:
        yield pool
    except BaseException:
        writer.close()  # running tasks are abandoned
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        writer.close()
        reader.close()


def _end_with(reader: Connection) -> None:
    """End this process when the pool's side of the pipe is closed; Ctrl-C is the parent's."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=exit_after, args=(reader,), daemon=True).start()
