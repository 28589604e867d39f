"""Measures the service: start, one client, several clients, overhead over the library.

::

    python -m tests.api.load                   # about two minutes; --json FILE writes the times

Times are of the clock, and of the processors in brackets: on a machine with other work only the
second are the service's own.
"""

import argparse
import os
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import chdir
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"

import httpx

from deitalk.errors import MissingError
from deitalk.research.arguments import new_file
from deitalk.research.evaluation.benchmark_curves import machine
from deitalk.research.evaluation.report import identified, write_json
from tests.api.conftest import wav
from tests.api.server import Server, start, stop, wait_until
from tests.api.test_worker import limits

SPEECH = wav(10.0)
AUDIO = {"Content-Type": "audio/wav"}


def say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def timed(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return 1000 * (time.perf_counter() - began)


def ask(client: httpx.Client, kind: str = "json") -> None:
    answer = client.post(
        f"/v1/animations?emotion=happy&format={kind}", content=SPEECH, headers=AUDIO
    )
    assert answer.status_code == 200, answer.text


def at_once(server: Server, clients: int, each: int, **given: Any) -> list[float]:
    """Times of requests, ms, of clients that send without a pause."""
    times: list[float] = []

    def work() -> None:
        with server.client(**given) as client:
            times.extend(timed(lambda: ask(client)) for _ in range(each))

    threads = [threading.Thread(target=work) for _ in range(clients)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sorted(times)


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


def compare(server: Server, count: int) -> dict[str, float]:
    """Times of one client and of the library, in turns, ms."""
    work, service, alone = library(), [], []
    spent, own = 0.0, 0.0
    with server.client() as client:
        for _ in range(count):
            before = server.processor_seconds
            service.append(timed(lambda: ask(client)))
            spent += 1000 * (server.processor_seconds - before)
            before = time.process_time()
            alone.append(timed(work))
            own += 1000 * (time.process_time() - before)
    late = sorted(service)[int(0.95 * count)]
    return {
        "median": statistics.median(service),
        "p95": late,
        "processors": spent / count,
        "library_median": statistics.median(alone),
        "library_processors": own / count,
    }


def format_costs() -> None:
    """Print the work for a second of sound, seconds of one processor, in each format."""
    import torch

    from api.compute.tasks import perform
    from api.messages.formats import ANIMATION_FORMATS, MESH_FORMATS

    torch.set_num_threads(1)
    seconds = 3.0
    for kind, formats in (("animation", ANIMATION_FORMATS), ("mesh", MESH_FORMATS)):
        for known in formats.values():
            with tempfile.TemporaryDirectory() as folder, chdir(folder):
                Path("recording").write_bytes(wav(seconds))
                Path("acting.json").write_text("{}")
                options = {"format": known.name, "suffix": known.suffix}
                order = {"kind": kind, "folder": folder, "options": options}
                order |= {"at_once_seconds": 60.0, "most_seconds": 60.0}
                try:
                    perform(order, limits(memory_bytes=2**33), lambda share: None)
                except MissingError as error:
                    say(f"{kind} {known.name}: {error}")
                    continue
                began = time.process_time()
                perform(order, limits(memory_bytes=2**33), lambda share: None)
                cost = (time.process_time() - began) / seconds
            say(f"{kind} {known.name}: {cost:.2f}, allowed for {known.cost:g}")


def main() -> None:
    """Run from a command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json", type=new_file, help="also write the times to this file")
    parser.add_argument("--formats", action="store_true", help="work by format instead")
    given = parser.parse_args()
    if given.formats:
        format_costs()
        return
    report: dict[str, Any] = identified("default") | {"machine": machine(), "threads": 1}
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        server = start(
            Path(folder), ready=False, workers=os.cpu_count(), requests_per_minute=1_000_000
        )
        try:
            answers = time.perf_counter() - began
            wait_until(server, "/readyz")
            report["start"] = {
                "answers_seconds": answers,
                "ready_seconds": time.perf_counter() - began,
                "processor_seconds": server.processor_seconds,
            }
            say(str(report["start"]))
            at_once(server, 4, 2)
            report["one_client_ms"] = compare(server, 40)
            say(str(report["one_client_ms"]))
            report["clients"] = {}
            for clients in (2, 5, 10):
                times = at_once(server, clients, 60 // clients)
                late = times[int(0.95 * len(times))]
                report["clients"][str(clients)] = {
                    "median_ms": statistics.median(times),
                    "p95_ms": late,
                    "p95_of_one": late / report["one_client_ms"]["p95"],
                }
                say(f"{clients} clients: {report['clients'][str(clients)]}")
        finally:
            stop(server)
    write_json(given.json, report)


if __name__ == "__main__":
    main()
