"""Worker processes of a batch, one model each; one that ends takes one line with it at most.

A pool of the standard library loses all running tasks when a process ends. Here each process has
its own pipe, so the line that ended it is known: it is tried a second time, then given up.
"""

import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import Protocol

from deitalk.batch.messages import Order, Outcome
from deitalk.errors import DeitalkError
from deitalk.workers import end_with_parent
from rig.errors import UserError

Make = Callable[[], Callable[[Order], Outcome]]


class Pool(Protocol):
    """What animates lines: `Workers`, or `deitalk.batch.cluster.Cluster`."""

    def run(self, orders: Sequence[Order]) -> Iterator[list[Outcome]]:
        """Yield results as they come, in any order, several at a time."""
        ...


AHEAD = 2
"""Orders that a process holds, so that it has work while a result is stored."""
ATTEMPTS = 2
READY = "ready"
"""First message of a process: its model is loaded."""
ENDED = "the process ended while animating it, perhaps for lack of memory; use fewer workers"


class Workers:
    """Processes that animate lines; a context manager.

    Parameters
    ----------
    count : int
        Processes, 1 or more.
    make : callable
        Makes what animates a line, such as a `deitalk.batch.performer.Performer`; called once in
        each process.
    """

    def __init__(self, count: int, make: Make) -> None:
        self._count, self._make = count, make
        self._processes: list[_Process] = []

    def __enter__(self) -> "Workers":
        return self

    def __exit__(self, *error: object) -> None:
        for process in self._processes:
            process.end(at_once=error[0] is not None)

    def run(self, orders: Sequence[Order]) -> Iterator[list[Outcome]]:
        """Yield results as they come, in any order, several at a time.

        Processes start with the first orders.

        Raises
        ------
        UserError
            If the model cannot be loaded.
        """
        while len(self._processes) < min(self._count, len(orders)):
            self._processes.append(_Process(self._make))
        waiting, attempts = deque(orders), dict[str, int]()
        while waiting or any(process.orders for process in self._processes):
            for process in self._processes:
                while waiting and len(process.orders) < AHEAD:
                    process.give(waiting.popleft())
            busy = {process.pipe: process for process in self._processes if process.orders}
            results = []
            for pipe in wait(list(busy)):
                process = busy[pipe]  # type: ignore[index]
                answer = process.take()
                if answer is None:
                    self._replace(process)
                    answer = _given_up(process.orders, waiting, attempts)
                if isinstance(answer, Outcome):
                    results.append(answer)
            if results:
                yield results

    def _replace(self, ended: "_Process") -> None:
        """Start a process in the place of one that ended."""
        if not ended.is_ready:
            raise DeitalkError("a worker process ended while loading the model; use fewer workers")
        ended.end(at_once=True)
        self._processes[self._processes.index(ended)] = _Process(self._make)


def _given_up(
    orders: deque[Order], waiting: deque[Order], attempts: dict[str, int]
) -> Outcome | None:
    """Return the orders of an ended process to the queue; the result of one given up."""
    first, *others = orders
    orders.clear()
    waiting.extendleft(reversed(others))
    attempts[first.output] = attempts.get(first.output, 0) + 1
    if attempts[first.output] >= ATTEMPTS:
        return Outcome(first.output, "failed", ENDED)
    waiting.append(first)
    return None


class _Process:
    """One process and its pipe; its orders are answered in turn."""

    def __init__(self, make: Make) -> None:
        context = get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, make), daemon=True)
        self.process.start()
        theirs.close()
        self.orders: deque[Order] = deque()
        self.is_ready = False

    def give(self, order: Order) -> None:
        self.orders.append(order)
        try:
            self.pipe.send(order)
        except OSError:
            pass  # it has ended; `take` finds out

    def take(self) -> Outcome | str | None:
        """The next result, or `READY`; None if the process has ended.

        Raises
        ------
        UserError
            If it could not load the model.
        """
        try:
            answer = self.pipe.recv()
        except (EOFError, OSError):
            return None
        if isinstance(answer, Exception):
            raise answer
        self.is_ready = True
        if isinstance(answer, Outcome):
            self.orders.popleft()
            return answer
        return READY

    def end(self, *, at_once: bool) -> None:
        self.pipe.close()  # ends its loop
        if at_once:
            self.process.kill()
        self.process.join()


def _serve(pipe: Connection, make: Make) -> None:
    """Loop of a process: an order in, a result out, until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's
    end_with_parent()
    os.environ["OMP_NUM_THREADS"] = "1"
    try:
        perform = make()
    except UserError as error:
        pipe.send(type(error)(str(error)))
        return
    try:
        pipe.send(READY)
        while True:
            pipe.send(perform(pipe.recv()))
    except (EOFError, OSError):
        return
