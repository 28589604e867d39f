"""One worker process and its owner, who gives it an order, waits, and stops it at a limit."""

import ctypes
import json
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from pathlib import Path
from time import monotonic
from typing import Any

from api.compute.order import Answer, Limits, Order, TooLarge
from api.errors import DISK_FULL, describe, is_disk_full, names_of
from deitalk.workers import (
    FORK_SERVER,
    NEW_PROCESSES,
    Worker,
    WorkerLost,
    begin_worker,
    safe_path,
)
from rig.errors import UserError

START_SECONDS = 120.0
"""Longest time until a new worker is ready."""
_POLL_SECONDS = 0.1


class OutOfTime(Exception):
    """The worker was stopped because its time was over."""


class Stopped(Exception):
    """The worker was stopped because its owner wanted it."""


class OrderWorker(Worker):
    """A process that is started at the first order and again after it was stopped.

    Parameters
    ----------
    limits : Limits
        Limits and models of the process.

    Notes
    -----
    On Linux the process is forked from one that holds the models; elsewhere it starts anew and
    reads them.
    """

    def __init__(self, limits: Limits) -> None:
        super().__init__(process_context(limits["backend"]), work, limits)
        self.is_ready = False

    @property
    def is_alive(self) -> bool:
        """Whether the process has started and not ended; not while an order is at work."""
        return self.is_ready and super().is_alive

    def start(self) -> None:
        """Start the process and wait until its models are read.

        Raises
        ------
        WorkerLost
            If it ends before, or the one that it is forked from.
        """
        if self.is_alive:
            return
        super().start()
        try:
            is_ready = self.receive(START_SECONDS)
        except WorkerLost:
            is_ready = None
        if is_ready is None:
            self.stop()
            raise WorkerLost("a worker process did not start")
        self.is_ready = True

    def run(
        self,
        order: Order,
        seconds: float,
        progress: Callable[[float], None] = lambda share: None,
        stopped: Callable[[], bool] = lambda: False,
    ) -> Answer:
        """Wait for the answer to an order.

        Parameters
        ----------
        order : Order
            Its folder must exist.
        seconds : float
            Time after which the process is stopped.
        progress : callable
            Called with the share done, 0 to 1.
        stopped : callable
            Called ten times a second; True stops the process.

        Raises
        ------
        WorkerLost, OutOfTime, Stopped
            The next order has a new process.
        """
        self.start()
        end = monotonic() + seconds
        try:
            self.send(json.dumps(order).encode())
            while True:
                while (message := self.receive(_POLL_SECONDS)) is None:
                    if stopped():
                        raise Stopped
                    if monotonic() > end:
                        raise OutOfTime
                answer: Answer = json.loads(message)
                if "progress" not in answer:
                    return answer
                progress(answer["progress"])
                if stopped():
                    raise Stopped
        except BaseException:
            self.stop()
            raise

    def stop(self, *, at_once: bool = True) -> None:
        """End the process."""
        self.is_ready = False
        super().stop(at_once=at_once)


def start_early(backend: str) -> None:
    """Start the process that workers are forked from, which takes seconds, beside other work."""
    if sys.platform.startswith("linux"):
        process_context(backend)
        from multiprocessing import forkserver

        with safe_path():
            forkserver.ensure_running()


def process_context(backend: str) -> BaseContext:
    """Where processes come from: on Linux a fork of one that has read the default model."""
    if not sys.platform.startswith("linux"):
        return NEW_PROCESSES
    module = "api.compute.warm_onnx" if backend == "onnx" else "api.compute.warm"
    FORK_SERVER.set_forkserver_preload([module])
    return FORK_SERVER


# The worker process: takes orders over a pipe, one at a time, and never ends by an error.
#
# It is forked from a process that has imported the packages and read the models
# (`api.compute.warm`), so that a new one is ready in milliseconds after the old one was stopped.


KEPT = {-1: 128 * 2**20, -3: 32 * 2**20}
"""M_TRIM_THRESHOLD and M_MMAP_THRESHOLD: free bytes that a process keeps, and its largest block.

Memory that is given back after an order is taken again for the next one, page by page."""
LARGEST_FILE = 8 * 2**30
"""Bytes of a file that a worker may write."""


def work(connection: Connection, limits: Limits) -> None:
    """Answer orders until the other side closes the pipe."""
    begin_process()
    from api.compute.tasks import prepare

    prepare(limits)
    limit_memory(limits["memory_bytes"])
    _send(connection, {"progress": 0.0})
    while True:
        try:
            order: Order = json.loads(connection.recv_bytes())
        except (EOFError, OSError):
            return
        _send(connection, _answer(order, limits, connection))


def begin_process() -> None:
    """End with the server alone, and send what libraries print to nowhere: it may name files."""
    begin_worker()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    os.close(nowhere)
    with suppress(AttributeError, OSError, TypeError):  # of the GNU C library alone
        for option, n_bytes in KEPT.items():
            ctypes.CDLL(None).mallopt(option, n_bytes)


def _answer(order: Order, limits: Limits, connection: Connection) -> Answer:
    from api.compute.tasks import perform

    def report(share: float) -> None:
        _send(connection, {"progress": float(share)})

    try:
        os.chdir(order["folder"])
        return perform(order, limits, report)
    except TooLarge as error:
        return {"error": [TooLarge.__name__], "message": str(error)}
    except (MemoryError, RecursionError):
        return {"error": [TooLarge.__name__], "message": "the request needs too much memory"}
    except Exception as error:
        if is_disk_full(error):
            return {"error": [DISK_FULL], "message": describe(error)}
        if isinstance(error, UserError):
            return {"error": names_of(error), "message": str(error)}
        # Whether torch or a C library could not allocate.
        text = str(error).lower()
        if "allocate" in text or "out of memory" in text or "bad_alloc" in text:
            return {"error": [TooLarge.__name__], "message": "the request needs too much memory"}
        return {"error": ["Internal"], "message": describe(error)}
    finally:
        os.chdir(os.sep)


def _send(connection: Connection, answer: Answer) -> None:
    connection.send_bytes(json.dumps(answer).encode())


def limit_memory(n_bytes: int) -> None:
    """Limit the memory that this process may take beyond what it has now."""
    if not sys.platform.startswith("linux"):
        return
    import resource

    status: dict[str, Any] = dict(
        line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines()
    )
    limit = int(status["VmData"].split()[0]) * 1024 + n_bytes
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    resource.setrlimit(resource.RLIMIT_FSIZE, (LARGEST_FILE, LARGEST_FILE))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
