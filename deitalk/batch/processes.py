"""Worker processes of a batch, one model each; one that ends takes one line with it at most.

Lines go to a process in chunks, so that those of one length are animated together. A pool of the
standard library loses all running tasks when a process ends. Here each process has its own pipe:
the lines of a chunk that ended it are given out alone, and the one that ends a process again is
given up.
"""

import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import Protocol

from deitalk.batch.lines import Order, Outcome
from deitalk.errors import DeitalkError
from deitalk.workers import end_with_parent
from rig.errors import UserError
from rig.limits import MIB

Perform = Callable[[Sequence[Order]], Iterator[list[Outcome]]]
"""Animates lines; yields results as they come."""
Make = Callable[[], Perform]


class Pool(Protocol):
    """What animates lines: `Workers`, or `deitalk.batch.cluster.Cluster`."""

    def run(self, orders: Sequence[Order]) -> Iterator[list[Outcome]]:
        """Yield results as they come, in any order, several at a time."""
        ...


CHUNK = 32
"""Most lines of a chunk; of neighbours by length, so many have mates of their own length."""
CHUNKS_EACH = 4
"""Fewest chunks for each process, so that all end at about the same time."""
CHUNK_BYTES = 16 * MIB
"""Most bytes of the recordings of a chunk."""
AHEAD = 2
"""Chunks that a process holds, so that it has work while a result is stored."""
ATTEMPTS = 2
READY: list[Outcome] = []
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
        waiting, attempts = deque(chunks(orders, self._count)), dict[str, int]()
        while waiting or any(process.chunks for process in self._processes):
            for process in self._processes:
                while waiting and len(process.chunks) < AHEAD:
                    process.give(waiting.popleft())
            busy = {process.pipe: process for process in self._processes if process.chunks}
            results: list[Outcome] = []
            for pipe in wait(list(busy)):
                process = busy[pipe]  # type: ignore[index]
                answer = process.take()
                if answer is None:
                    self._replace(process)
                    answer = _given_up(process.chunks, waiting, attempts)
                results += answer
            if results:
                yield results

    def _replace(self, ended: "_Process") -> None:
        """Start a process in the place of one that ended."""
        if not ended.is_ready:
            raise DeitalkError("a worker process ended while loading the model; use fewer workers")
        ended.end(at_once=True)
        self._processes[self._processes.index(ended)] = _Process(self._make)


def chunks(orders: Sequence[Order], processes: int) -> Iterator[list[Order]]:
    """Divide orders, the largest recordings first, into chunks."""
    most = max(min(CHUNK, len(orders) // (CHUNKS_EACH * processes)), 1)
    chunk: list[Order] = []
    size = 0.0
    for order in orders:
        if chunk and (len(chunk) >= most or size + order.size > CHUNK_BYTES):
            yield chunk
            chunk, size = [], 0.0
        chunk.append(order)
        size += order.size
    if chunk:
        yield chunk


def _given_up(
    held: deque[dict[str, Order]], waiting: deque[list[Order]], attempts: dict[str, int]
) -> list[Outcome]:
    """Return the orders of an ended process to the queue; the result of one given up."""
    first, *others = (list(chunk.values()) for chunk in held)
    held.clear()
    waiting.extendleft(reversed(others))
    if len(first) > 1:
        waiting.extend([order] for order in first)
        return []
    name = first[0].output
    attempts[name] = attempts.get(name, 0) + 1
    if attempts[name] >= ATTEMPTS:
        return [Outcome(name, "failed", ENDED)]
    waiting.append(first)
    return []


class _Process:
    """One process and its pipe; its chunks are answered in turn."""

    def __init__(self, make: Make) -> None:
        context = get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, make), daemon=True)
        self.process.start()
        theirs.close()
        self.chunks: deque[dict[str, Order]] = deque()
        self.is_ready = False

    def give(self, orders: list[Order]) -> None:
        self.chunks.append({order.output: order for order in orders})
        with suppress(OSError):  # it has ended; `take` finds out
            self.pipe.send(orders)

    def take(self) -> list[Outcome] | None:
        """The next results; None if the process has ended.

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
        outcomes: list[Outcome] = answer
        for outcome in outcomes:
            del self.chunks[0][outcome.output]
            if not self.chunks[0]:
                self.chunks.popleft()
        return outcomes

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
            for outcomes in perform(pipe.recv()):
                pipe.send(outcomes)
    except (EOFError, OSError):
        return
