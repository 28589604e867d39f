"""The worker process: takes orders over a pipe, one at a time, and never ends by an error.

It is forked from a process that has imported the packages and read the models
(`api.compute.warm`), so that a new one is ready in milliseconds after the old one was stopped.
"""

import ctypes
import json
import os
import sys
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from api.compute.order import Answer, Limits, Order, TooLarge
from api.errors import DISK_FULL, describe, names_of
from deitalk.workers import begin_worker
from rig.errors import UserError, is_disk_full

KEPT = {-1: 128 * 2**20, -3: 32 * 2**20}
"""M_TRIM_THRESHOLD and M_MMAP_THRESHOLD: free bytes that a process keeps, and its largest block.

Memory that is given back after an order is taken again for the next one, page by page."""
LARGEST_FILE = 8 * 2**30
"""Bytes of a file that a worker may write."""


def work(connection: Connection, limits: Limits) -> None:
    """Answer orders until the other side closes the pipe."""
    begin_process()
    from api.compute.models import prepare

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
    except Exception as error:
        if is_disk_full(error):
            return {"error": [DISK_FULL], "message": describe(error)}
        if isinstance(error, UserError | TooLarge):
            return {"error": names_of(error), "message": str(error)}
        # Whether Python, torch or a C library could not allocate.
        text = str(error).lower()
        is_large = isinstance(error, MemoryError | RecursionError)
        if is_large or "allocate" in text or "out of memory" in text or "bad_alloc" in text:
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
