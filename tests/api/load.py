"""Measures the service: start, one client, ten clients, overhead over the library, memory.

::

    python -m tests.api.load                   # about two minutes
    python -m tests.api.load --soak 120        # mixed load for 120 minutes, memory at the end
"""

import argparse
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
from tests.api.kill import descendants
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


def resident_mb(server: Server) -> float:
    """Memory of the server and its processes; shared pages count in part."""
    total = 0
    for pid in (server.process.pid, *descendants(server.process.pid)):
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                total += int(line.split()[1])
    return total / 1024


def soak(server: Server, minutes: float) -> None:
    """Mixed load; print memory after a tenth of the time and at the end, and count of errors."""
    end = time.monotonic() + 60 * minutes
    first, asked, jobs = 0.0, 0, []
    with server.client() as client:
        while time.monotonic() < end:
            kinds = ("csv", "take", "livelink", "json")
            for kind in kinds:
                answer = client.post(f"/v1/animations?format={kind}", content=wav(3), headers=AUDIO)
                assert answer.status_code == 200, answer.text
            assert client.post("/v1/animations", content=b"noise" * 99).status_code == 422
            jobs.append(client.post("/v1/jobs", content=wav(5), headers=AUDIO).json()["id"])
            client.get("/metrics").raise_for_status()
            asked += len(kinds) + 3
            if not first and time.monotonic() > end - 54 * minutes:
                first = resident_mb(server)
        for job_id in jobs:
            while (state := client.get(f"/v1/jobs/{job_id}").json()["status"]) != "done":
                assert state in ("queued", "running"), state
                time.sleep(0.2)
    last = resident_mb(server)
    say(f"{asked} requests, {len(jobs)} jobs, all done; memory {first:.0f} MB after a tenth of the "
        f"time, {last:.0f} MB at the end ({100 * (last / first - 1):+.1f} %)")  # fmt: skip


def main() -> None:
    """Run from a command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.api.load", description=__doc__)
    parser.add_argument("--soak", type=float, default=0, metavar="MINUTES")
    given = parser.parse_args()
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
            if given.soak:
                soak(server, given.soak)
                return
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
