"""Measures the service: start, one client, several clients, overhead over the library.

::

    python -m tests.api.load                   # about two minutes

Times are of the clock, and of the processors in brackets: on a machine with other work only the
second are the service's own.
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


def processor_ms(server: Server) -> float:
    """Processor time of the server and its processes since their start."""
    ticks = 0
    for pid in (server.process.pid, *descendants(server.process.pid)):
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        ticks += sum(map(int, fields[11:15]))
    return 1000 * ticks / os.sysconf("SC_CLK_TCK")


def library() -> Callable[[], None]:
    """The same work by the package alone."""
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
    return work


def compare(server: Server, count: int) -> float:
    """Print times of one client and of the library, in turns; return the client's 95th percentile."""
    work, service, alone = library(), [], []
    spent, own = 0.0, 0.0
    with server.client() as client:
        for _ in range(count):
            before = processor_ms(server)
            service.append(timed(lambda: ask(client)))
            spent += processor_ms(server) - before
            before = 1000 * time.process_time()
            alone.append(timed(work))
            own += 1000 * time.process_time() - before
    late = sorted(service)[int(0.95 * count)]
    say(f"one client: median {statistics.median(service):.0f} ms, p95 {late:.0f} ms "
        f"[{spent / count:.0f} ms]; library: {statistics.median(alone):.0f} ms "
        f"[{own / count:.0f} ms]; overhead "
        f"{statistics.median(service) - statistics.median(alone):+.0f} ms "
        f"[{(spent - own) / count:+.0f} ms]")  # fmt: skip
    return late


def main() -> None:
    """Run from a command line."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        server = start(
            Path(folder), ready=False, workers=os.cpu_count(), requests_per_minute=1_000_000
        )
        try:
            answers = time.perf_counter() - began
            wait_until(server, "/readyz")
            say(f"answers after {answers:.1f} s, ready after {time.perf_counter() - began:.1f} s "
                f"[{processor_ms(server) / 1000:.1f} s of all processes]")  # fmt: skip
            at_once(server, 4, 2)
            alone = compare(server, 40)
            for clients in (2, 5, 10):
                times = at_once(server, clients, 60 // clients)
                late = times[int(0.95 * len(times))]
                say(f"{clients} clients on {os.cpu_count()} processors: median "
                    f"{statistics.median(times):.0f} ms, p95 {late:.0f} ms, {late / alone:.1f} x "
                    "one client's")  # fmt: skip
        finally:
            stop(server)


if __name__ == "__main__":
    main()
