"""Worker processes: one is started, sent messages, waited for, ended and started again.

They end with their parent, and import nothing from the working folder (`deitalk.safe_path`).
"""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.context import BaseContext, SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from typing import Any

from deitalk.safe_path import safe_path


@contextmanager
def starting() -> Iterator[None]:
    """Processes that start in the block are safe (`safe_path`) and leave Ctrl-C to their parent.

    They inherit the blocked signal, so that they print nothing in their imports either.
    """
    with safe_path():
        if not hasattr(signal, "pthread_sigmask"):  # Windows
            yield
            return
        from multiprocessing import resource_tracker

        resource_tracker.ensure_running()  # up to Python 3.11 it unblocks the signal
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _NewProcess(SpawnProcess):
    def start(self) -> None:
        with starting():
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
            with starting():  # it may start the server again
                super().start()

    class _ForkServer(ForkServerContext):
        Process = _ForkedProcess

    FORK_SERVER = _ForkServer()
    """Context of processes that are forked from one that has imported what they need."""

DATA_WORKERS = multiprocessing.get_context("fork") if sys.platform == "linux" else NEW_PROCESSES
"""Context of the processes of a `DataLoader`: a fork has the data and what cannot be pickled. It is
Python's own choice up to 3.13."""


class WorkerLost(Exception):
    """The worker process ended before it answered."""


class Worker:
    """A process that takes messages from a pipe and answers on it.

    Messages are bytes, so that who reads them chooses how they are decoded.

    Parameters
    ----------
    context : BaseContext
        `NEW_PROCESSES` or `FORK_SERVER`.
    serve : callable
        Function of a module, called in the process with its end of the pipe, then `args`; it
        returns when the pipe is closed. `begin_worker` is what it calls first.
    *args : Any
        Can be pickled.

    Notes
    -----
    Not for several threads at once.
    """

    def __init__(self, context: BaseContext, serve: Callable[..., None], *args: Any) -> None:
        self._context, self._serve, self._args = context, serve, args
        self._process: BaseProcess | None = None
        self.pipe: Connection

    @property
    def pid(self) -> int | None:
        """Number of the process, if there is one."""
        return None if self._process is None else self._process.pid

    @property
    def is_alive(self) -> bool:
        """Whether the process has started and not ended."""
        return self._process is not None and self._process.is_alive()

    def start(self) -> None:
        """Start a process in the place of the one before.

        Raises
        ------
        WorkerLost
            If the process that it is forked from has ended.
        """
        self.stop()
        self.pipe, child = self._context.Pipe()
        with child:
            process = self._context.Process(  # type: ignore[attr-defined]
                target=self._serve, args=(child, *self._args), daemon=True
            )
            try:
                process.start()
            except (EOFError, OSError):
                self.pipe.close()
                raise WorkerLost("a worker process did not start") from None
        self._process = process

    def send(self, message: bytes) -> None:
        """Send a message.

        Raises
        ------
        WorkerLost
            If the process has ended.
        """
        try:
            self.pipe.send_bytes(message)
        except OSError:
            raise WorkerLost("the worker process ended") from None

    def receive(self, seconds: float | None = None) -> bytes | None:
        """Wait for a message; None if none comes in a number of seconds.

        Raises
        ------
        WorkerLost
            If the process has ended.
        """
        try:
            return self.pipe.recv_bytes() if self.pipe.poll(seconds) else None
        except (EOFError, OSError):
            raise WorkerLost("the worker process ended") from None

    def stop(self, *, at_once: bool = True) -> None:
        """End the process, at once or after the message that it works on."""
        if self._process is None:
            return
        if at_once:
            self._process.kill()
        else:
            self.pipe.close()
        self._process.join()
        self._process = None
        self.pipe.close()


def begin_worker() -> None:
    """Have this process end with its parent alone: Ctrl-C is the parent's."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()


def end_with_parent(worker_id: int = 0) -> None:
    """End this process when its parent does; as ``worker_init_fn`` of a `DataLoader`."""
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=exit_after, args=(parent.sentinel,), daemon=True).start()


def exit_after(end: Connection | int) -> None:
    """End this process when a pipe is closed or another process has ended."""
    wait([end])
    os._exit(1)
