"""One worker process and its owner, who gives it an order, waits, and stops it at a limit."""

import json
import sys
from collections.abc import Callable
from multiprocessing.context import BaseContext
from time import monotonic

from api.compute.order import Answer, Limits, Order
from api.compute.process import work
from deitalk.workers import (
    FORK_SERVER,
    NEW_PROCESSES,
    Worker,
    WorkerLost,
    starting,
)

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

        with starting():
            forkserver.ensure_running()


def process_context(backend: str) -> BaseContext:
    """Start method of processes: on Linux a fork of one that has read the default model."""
    if not sys.platform.startswith("linux"):
        return NEW_PROCESSES
    module = "api.compute.warm_onnx" if backend == "onnx" else "api.compute.warm"
    FORK_SERVER.set_forkserver_preload([module])
    return FORK_SERVER
