"""Kills a server and its workers under load, and checks that every accepted job ends once.

::

    python -m tests.api.kill --rounds 50

Each round sends jobs, kills at a random moment the server (every second round) or one of its
workers by signal 9, starts the server again if need be, and goes on. At the end every job that was
accepted has ended once, with the result of its own recording.
"""

import argparse
import os
import random
import shutil
import signal
import sqlite3
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx

from tests.api.conftest import wav
from tests.api.server import Server, descendants, start, stop

JOBS_A_ROUND = 3
WAIT_SECONDS = 900.0


def kill(pid: int) -> None:
    """End a process by signal 9."""
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


@contextmanager
def frozen(server: Server) -> Iterator[None]:
    """Meanwhile its worker processes do nothing, so that what they have stays at work.

    Processes that are started meanwhile work.
    """
    workers = [pid for pid in descendants(server.process.pid) if not descendants(pid)]

    def signal_all(number: int) -> None:
        for pid in workers:
            with suppress(ProcessLookupError):  # the server ends one whose client has gone
                os.kill(pid, number)

    signal_all(signal.SIGSTOP)
    try:
        yield
    finally:
        signal_all(signal.SIGCONT)


class Load:
    """Sends jobs of different lengths and remembers those that were accepted."""

    def __init__(self, rng: random.Random) -> None:
        self.rng, self.frames, self.sent = rng, {}, 0

    def send(self, server: Server) -> None:
        """Send one job; an answer that is lost may have been accepted: the same key finds it."""
        self.sent += 1
        tenths = self.rng.randrange(10, 60)
        for _ in range(3):
            with suppress(httpx.HTTPError), server.client() as client:
                answer = client.post(
                    "/v1/jobs?format=json",
                    content=wav(tenths / 10),
                    headers={"Content-Type": "audio/wav", "Idempotency-Key": f"job-{self.sent}"},
                )
                assert answer.status_code == 202, answer.text
                self.frames[answer.json()["id"]] = 3 * tenths
                return
            time.sleep(0.2)


def run(rounds: int, seed: int, data: Path) -> dict[str, int]:
    """Run the rounds; return counts.

    Raises
    ------
    AssertionError
        If a job did not end, ended twice, or has another's result.
    """
    rng = random.Random(seed)
    load, kills = Load(rng), {"server": 0, "worker": 0}
    server = start(data, lease_seconds=1.0, job_attempts=20, live_sessions=0)
    try:
        for number in range(rounds):
            for _ in range(JOBS_A_ROUND):
                load.send(server)
            time.sleep(rng.uniform(0.0, 1.0))
            if number % 2:
                server.process.kill()
                server.process.wait()
                kills["server"] += 1
                server = start(
                    data, lease_seconds=1.0, job_attempts=20, live_sessions=0, ready=False
                )
            elif workers := descendants(server.process.pid):
                kill(rng.choice(workers))
                kills["worker"] += 1
        _check(server, load)
    finally:
        stop(server)
    with sqlite3.connect(data / "jobs.sqlite") as table:
        ends = table.execute("SELECT count(*), min(ends), max(ends) FROM deitalk_jobs").fetchone()
    assert ends == (load.sent, 1, 1), ends
    return kills | {"jobs": load.sent}


def wait(client: httpx.Client, job_id: str, **given: Any) -> dict[str, Any]:
    """Return a job once it has ended."""
    end, path = time.monotonic() + WAIT_SECONDS, f"/v1/jobs/{job_id}"
    while (job := client.get(path, **given).json())["status"] in ("queued", "running"):
        assert time.monotonic() < end, job
        time.sleep(0.2)
    return job


def _check(server: Server, load: Load) -> None:
    with server.client() as client:
        for job_id, frames in load.frames.items():
            job = wait(client, job_id)
            assert job["status"] == "done", job
            assert client.get(job["result"]).json()["n_frames"] == frames


def main() -> None:
    """Run from a command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.api.kill", description=__doc__)
    parser.add_argument("--rounds", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    data = Path(tempfile.mkdtemp(prefix="deitalk-kill-"))
    sys.stdout.write(f"{run(given.rounds, given.seed, data)}\n")
    shutil.rmtree(data)


if __name__ == "__main__":
    main()
