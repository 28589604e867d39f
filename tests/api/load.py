"""Measures the service: start, one client, ten clients, overhead over the library.

::

    python -m tests.api.load                   # about two minutes
"""

import os
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"

import httpx

from tests.api.conftest import wav
from tests.api.server import Server, start, stop, wait_until

SPEECH = wav(10.0)
AUDIO = {"Content-Type": "audio/wav"}


def say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def timed(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return 1000 * (time.perf_counter() - began)


def ask(client: httpx.Client) -> None:
    answer = client.post("/v1/animations?emotion=happy", content=SPEECH, headers=AUDIO)
    assert answer.status_code == 200, answer.text


def at_once(server: Server, clients: int, each: int) -> list[float]:
    """Times of requests, ms, of clients that send without a pause."""
    times: list[float] = []

    def work() -> None:
        with server.client() as client:
            times.extend(timed(lambda: ask(client)) for _ in range(each))

    threads = [threading.Thread(target=work) for _ in range(clients)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sorted(times)


def beside_the_library(server: Server, count: int) -> tuple[list[float], list[float]]:
    """Times of one client and of the same work by the package alone, ms, one after the other."""
    import torch

    import deitalk
    from rig import write_curves

    torch.set_num_threads(1)
    model = deitalk.load_model()

    def work() -> None:
        performance = deitalk.animate(SPEECH, "happy", model=model)
        with tempfile.TemporaryDirectory() as folder:
            write_curves(Path(folder) / "curves.json", performance.curves)

    work()
    pairs = [(at_once(server, 1, 1)[0], timed(work)) for _ in range(count)]
    return sorted(service for service, _ in pairs), sorted(alone for _, alone in pairs)


def main() -> None:
    """Run from a command line."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        server = start(
            Path(folder), ready=False, workers=2, requests_per_minute=1_000_000,
            queued_jobs=1_000_000,
        )  # fmt: skip
        try:
            answers = time.perf_counter() - began
            wait_until(server, "/readyz")
            say(f"answers after {answers:.1f} s, ready after {time.perf_counter() - began:.1f} s")
            at_once(server, 2, 2)
            one, alone = beside_the_library(server, 20)
            ten = at_once(server, 10, 6)
            overhead = statistics.median(one) - statistics.median(alone)
            say(f"one client: median {statistics.median(one):.0f} ms, p95 {one[18]:.0f} ms; library "
                f"{statistics.median(alone):.0f} ms; overhead {overhead:.0f} ms")  # fmt: skip
            say(f"ten clients: median {statistics.median(ten):.0f} ms, p95 {ten[56]:.0f} ms, "
                f"{ten[56] / one[18]:.1f} x one client's")  # fmt: skip
        finally:
            stop(server)


if __name__ == "__main__":
    main()
