"""One process whose network reads for all requests of a server, those that wait in one pass.

Workers decode, prepare, finish and write in their own processes with their own limits; only the
network's part comes here. Requests that arrive during a pass form the next one; none is delayed to
fill a pass. Where the process does not answer, a worker reads by itself.
"""

import json
import logging
import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import AuthenticationError, connection, current_process
from pathlib import Path
from typing import Any

import numpy as np

from api.compute.order import Limits
from api.compute.shared import packed
from api.compute.worker import START_SECONDS, begin_process, limit_memory, process_context
from deitalk.audio.frames import FRAME_RATE
from deitalk.emotions import EMOTIONS
from deitalk.models.protocol import Reading
from rig.arrays import Float32

RESTART_SECONDS = 1.0
MOST_FAILURES = 3
"""Recordings in a row that fail, after which the process begins anew: a GPU may be lost."""
PASS_FRAMES = 240 * FRAME_RATE
"""Most frames of one pass, which bound its memory."""
MOST_BYTES = 2**26
"""Of a message: 600 s of sound are 38 MB."""
log = logging.getLogger("deitalk.service")


class Reader:
    """The process, seen from the server; it is started again when it ends.

    Parameters
    ----------
    limits : Limits
        Device, models and memory; ``reader`` is the address to listen at.
    most : int
        Recordings of one pass.
    """

    def __init__(self, limits: Limits, most: int) -> None:
        self.limits, self.most = limits, most
        self.process: Any = None
        self._ready, self._ending = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._keep, name="reader", daemon=True)

    def start(self) -> None:
        """Start the process; wait until it has read the models."""
        self._thread.start()
        self._ready.wait(START_SECONDS)

    def stop(self) -> None:
        """End the process at once."""
        self._ending.set()
        if self.process is not None:
            self.process.kill()

    def _keep(self) -> None:
        while not self._ending.is_set():
            context: Any = process_context(self.limits["backend"])
            ours, child = context.Pipe()
            process = context.Process(
                target=serve, args=(child, self.limits, self.most), daemon=True
            )
            process.start()
            self.process = process
            if self._ending.is_set():  # `stop` did not see this one
                process.kill()
            child.close()
            with suppress(EOFError, OSError):
                ours.recv_bytes()
                log.info("process %d reads for all requests", process.pid)
            self._ready.set()  # or not: then workers read by themselves
            process.join()
            ours.close()
            if not self._ending.wait(RESTART_SECONDS):
                log.warning("the process that reads for all requests ended; it starts again")


def new_address() -> str:
    """An address in a folder that only this user can enter."""
    return str(connection.arbitrary_address(connection.default_family))  # type: ignore[attr-defined]


# The process itself.


class Line:
    """A worker's connection."""

    def __init__(self, link: connection.Connection) -> None:
        self.link, self.is_open = link, True

    def receive(self, waiting: "queue.SimpleQueue[Request]") -> None:
        """Put the worker's requests into the queue until the connection ends."""
        with suppress(Exception):  # it ends, or is broken
            while True:
                given = json.loads(self.link.recv_bytes())
                flat = np.frombuffer(bytearray(self.link.recv_bytes(MOST_BYTES)), "<f4")
                sound, weights = np.split(flat, [given["samples"]])
                weights = weights.reshape(-1, len(EMOTIONS))
                waiting.put(Request(self, given["model"], given["actor"], sound, weights))
        self.is_open = False

    def send(self, result: Reading | Exception, together: int) -> None:
        """Send what was read, or that it was not; nothing where the worker has ended."""
        header, data = packed(result)
        with suppress(OSError):
            self.link.send_bytes(json.dumps(header | {"together": together}).encode())
            self.link.send_bytes(data)


@dataclass(frozen=True, eq=False)
class Request:
    """A recording that waits."""

    line: Line
    model: str
    actor: str
    sound: Float32
    weights: Float32


def serve(ready: connection.Connection, limits: Limits, most: int) -> None:
    """Read recordings until the server ends."""
    begin_process()
    from api.compute.tasks import model_of, placed, prepare

    here: Limits = {**limits, "reader": ""}
    prepare(here)
    limit_memory(limits["memory_bytes"])
    waiting: queue.SimpleQueue[Request] = queue.SimpleQueue()
    with suppress(OSError):  # there is none, or it is no file
        Path(limits["reader"]).unlink()
    listener = connection.Listener(limits["reader"], authkey=current_process().authkey)
    threading.Thread(target=_accept, args=(listener, waiting), daemon=True).start()
    ready.send_bytes(b"ready")
    failures = 0
    for group in groups(waiting, most):
        for request, result, together in answers(
            group, lambda name: placed(model_of(name, here), here)
        ):
            request.line.send(result, together)
            failures = failures + 1 if isinstance(result, Exception) else 0
        if failures >= MOST_FAILURES:
            return


def _accept(listener: connection.Listener, waiting: "queue.SimpleQueue[Request]") -> None:
    while True:
        with suppress(OSError, EOFError, AuthenticationError):
            line = Line(listener.accept())
            threading.Thread(target=line.receive, args=(waiting,), daemon=True).start()


def groups(waiting: "queue.SimpleQueue[Request]", most: int) -> Iterator[list[Request]]:
    """What waits, in passes: the oldest, and others of its model in their order.

    Parameters
    ----------
    waiting : SimpleQueue
        Requests as they come; those of workers that have ended are left out.
    most : int
        Requests of one pass, which has at most `PASS_FRAMES`.
    """
    kept: list[Request] = []
    while True:
        if not kept:
            kept.append(waiting.get())
        with suppress(queue.Empty):
            while True:
                kept.append(waiting.get_nowait())
        kept = [request for request in kept if request.line.is_open]
        group: list[Request] = []
        frames = 0
        for request in kept:
            more = frames + len(request.weights)
            if group and (
                request.model != group[0].model or len(group) == most or more > PASS_FRAMES
            ):
                continue
            group.append(request)
            frames = more
        kept = [request for request in kept if request not in group]
        if group:
            yield group


def answers(
    group: list[Request], network_of: Callable[[str], Any]
) -> Iterator[tuple[Request, Reading | Exception, int]]:
    """Each request with what was read or why not, and how many were read with it.

    Those that fail together are read one by one.
    """
    try:
        network = network_of(group[0].model)
        if len(group) == 1:
            (request,) = group
            readings = [network.read(request.sound, request.weights, request.actor)]
        else:
            readings = network.read_together(
                [request.sound for request in group],
                [request.weights for request in group],
                [request.actor for request in group],
            )
    except Exception as error:
        if len(group) == 1:
            yield group[0], error, 1
        else:
            for request in group:
                yield from answers([request], network_of)
        return
    for request, reading in zip(group, readings, strict=True):
        yield request, reading, len(group)
