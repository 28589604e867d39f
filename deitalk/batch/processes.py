"""Worker processes of a batch, one model each: recordings to staged files.

One that ends takes one line with it at most.

Lines go to a process in chunks, so that those of one length are animated together. A pool of the
standard library loses all running tasks when a process ends. Here each process has its own pipe:
the lines of a chunk that ended it are given out alone, and the one that ends a process again is
given up.
"""

import os
import pickle
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Protocol

from deitalk.batch.orders import Order, Outcome
from deitalk.errors import DeitalkError
from deitalk.workers import NEW_PROCESSES, Worker, WorkerLost, begin_worker
from rig.errors import UserError
from rig.limits import MIB

Perform = Callable[[Sequence[Order]], Iterator[list[Outcome]]]
"""Animates lines; yields results as they come."""
Make = Callable[[], Perform]


class Pool(Protocol):
    """Interface of those that animate lines: `Workers`, or `deitalk.batch.cluster.Cluster`."""

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
        self._workers: list[_BatchWorker] = []

    def __enter__(self) -> "Workers":
        return self

    def __exit__(self, *error: object) -> None:
        for worker in self._workers:
            worker.stop(at_once=error[0] is not None)

    def run(self, orders: Sequence[Order]) -> Iterator[list[Outcome]]:
        """Yield results as they come, in any order, several at a time.

        Processes start with the first orders.

        Raises
        ------
        UserError
            If the model cannot be loaded.
        """
        while len(self._workers) < min(self._count, len(orders)):
            self._workers.append(_BatchWorker(self._make))
        waiting, attempts = deque(chunks(orders, self._count)), dict[str, int]()
        while waiting or any(worker.chunks for worker in self._workers):
            for worker in self._workers:
                while waiting and len(worker.chunks) < AHEAD:
                    worker.give(waiting.popleft())
            busy = {worker.pipe: worker for worker in self._workers if worker.chunks}
            results: list[Outcome] = []
            for pipe in wait(list(busy)):
                worker = busy[pipe]  # type: ignore[index]
                try:
                    results += worker.take()
                except WorkerLost:
                    if not worker.is_ready:
                        raise DeitalkError(
                            "a worker process ended while loading the model; use fewer workers"
                        ) from None
                    results += _given_up(worker.chunks, waiting, attempts)
                    worker.start()
            if results:
                yield results


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


class _BatchWorker(Worker):
    """A process and the chunks that it holds, which are answered in turn."""

    def __init__(self, make: Make) -> None:
        super().__init__(NEW_PROCESSES, _serve, make)
        self.chunks: deque[dict[str, Order]] = deque()
        self.start()

    def start(self) -> None:
        self.is_ready = False
        super().start()

    def give(self, orders: list[Order]) -> None:
        self.chunks.append({order.output: order for order in orders})
        with suppress(WorkerLost):  # `take` finds out
            self.send(pickle.dumps(orders))

    def take(self) -> list[Outcome]:
        """The next results.

        Raises
        ------
        WorkerLost
            If the process has ended.
        UserError
            If it could not load the model.
        """
        answer = pickle.loads(self.receive() or b"")
        if isinstance(answer, Exception):
            raise answer
        self.is_ready = True
        outcomes: list[Outcome] = answer
        for outcome in outcomes:
            del self.chunks[0][outcome.output]
            if not self.chunks[0]:
                self.chunks.popleft()
        return outcomes


def _serve(pipe: Connection, make: Make) -> None:
    """Loop of a process: orders in, results out, until the pipe is closed."""
    begin_worker()
    os.environ["OMP_NUM_THREADS"] = "1"
    try:
        perform = make()
    except UserError as error:
        pipe.send(type(error)(str(error)))
        return
    with suppress(EOFError, OSError):
        pipe.send(READY)
        while True:
            for outcomes in perform(pipe.recv()):
                pipe.send(outcomes)
