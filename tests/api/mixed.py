"""Mixed load on two servers of one PostgreSQL, with kills and drains; what must hold, measured.

::

    python -m tests.api.mixed --minutes 120 --kills 50
    python -m tests.api.mixed --minutes 5 --kills 6 --beside ../other   # one server of a checkout

The second server is killed or drained and started again, workers of the first are killed. Four
keys send jobs without pause, and requests that they wait for. At the end every accepted job has
ended once, with the result of its own recording, and no request that a draining server had taken
is without an answer.
"""

import argparse
import json
import random
import signal
import statistics
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import sqlalchemy as sql

from api.guard.keys import digest_of
from api.jobs.table import JOBS
from tests.api.conftest import wav
from tests.api.database import serving_postgres
from tests.api.kill import kill
from tests.api.load import at_once
from tests.api.server import ROOT, Server, descendants, start, stop

NAMES = ("anna", "bert", "carl", "dora")
OUTSTANDING = 4
"""Jobs of each key that are queued or at work."""
PAUSE_SECONDS = 4.0
"""Between two requests of a key that it waits for."""


class Load:
    """What four keys send, and what came of it."""

    def __init__(self, rng: random.Random, servers: list[Server]) -> None:
        self.rng, self.servers = rng, servers
        self.over, self.lock = threading.Event(), threading.Lock()
        self.frames: dict[str, int] = {}
        self.counts: Counter[str] = Counter()
        self.killed_at = 0.0

    def send(self, name: str, path: str, tenths: int, **headers: str) -> httpx.Response | None:
        """Send a recording to one of the servers, until one takes it."""
        content = wav(tenths / 10)
        while not self.over.is_set():
            server = self.rng.choice(self.servers)
            given = {"Authorization": f"Bearer {name}", "Content-Type": "audio/wav", **headers}
            try:
                answer = httpx.post(
                    server.url + path, content=content, headers=given, timeout=120, trust_env=False
                )
            except httpx.HTTPError as error:
                is_lost = not isinstance(error, httpx.ConnectError)
                if is_lost and time.monotonic() - self.killed_at > 5:
                    self.counts["lost answers"] += 1
                time.sleep(0.3)
                continue
            if answer.status_code in (200, 202):
                return answer
            self.counts[f"{answer.status_code} {answer.json()['code']}"] += 1
            time.sleep(float(answer.headers.get("Retry-After", 1)))
        return None

    def jobs(self, name: str) -> None:
        """Keep jobs of a key in the queue."""
        waiting: list[str] = []
        for number in range(10**9):
            while len(waiting) >= OUTSTANDING and not self.over.wait(0.2):
                waiting = [job for job in waiting if not self.ended(name, job)]
            if self.over.is_set():
                return
            tenths = self.rng.randrange(20, 200)
            answer = self.send(
                name, "/v1/jobs?format=npz", tenths, **{"Idempotency-Key": f"{name}-{number}"}
            )
            if answer is not None:
                self.frames[answer.json()["id"]] = 3 * tenths
                waiting.append(answer.json()["id"])

    def ended(self, name: str, job_id: str) -> bool:
        """Whether a job has ended, as either server sees it."""
        with suppress(httpx.HTTPError, KeyError):
            job = self.get(name, f"/v1/jobs/{job_id}").json()
            return job["status"] not in ("queued", "running")
        return False

    def get(self, name: str, path: str) -> httpx.Response:
        """Ask the first server, which is never killed."""
        headers = {"Authorization": f"Bearer {name}"}
        return httpx.get(self.servers[0].url + path, headers=headers, timeout=60, trust_env=False)

    def requests(self, name: str) -> None:
        """Send requests of a key that it waits for."""
        while not self.over.wait(PAUSE_SECONDS):
            if self.send(name, "/v1/animations?format=csv", 30) is not None:
                self.counts["answers"] += 1


def run(minutes: float, kills: int, seed: int, beside: Path, data: Path) -> dict[str, Any]:
    """Run the load; return what was counted and measured."""
    rng = random.Random(seed)
    keys = [
        {"name": name, "sha256": digest_of(name), "requests_per_minute": 10**5, "jobs": 1000}
        for name in NAMES
    ]
    with serving_postgres() as url:
        shared = {"database": url, "storage": data / "files", "keys": json.dumps(keys)}
        shared |= {"lease_seconds": 2, "job_attempts": 20}

        def second() -> Server:
            return start(data / "b", root=beside, **shared)

        first = start(data / "a", **shared)
        load = Load(rng, [first, second()])
        try:
            report = _times(first)
            threads = [
                threading.Thread(target=work, args=(name,))
                for name in NAMES
                for work in (load.jobs, load.requests)
            ]
            for thread in threads:
                thread.start()
            memory = _disturb(load, rng, minutes * 60 / (kills + 1), kills, second)
            load.over.set()
            for thread in threads:
                thread.join()
            report |= {"counts": dict(load.counts), "memory_mb": memory}
            return report | _check(load, url)
        finally:
            load.over.set()
            for server in load.servers:
                stop(server)


def _times(server: Server) -> dict[str, Any]:
    """Times of ten seconds to CSV: alone, and four clients of the one worker."""
    given = {"headers": {"Authorization": f"Bearer {NAMES[0]}"}}
    alone = at_once(server, 1, 20, **given)
    four = at_once(server, 4, 10, **given)
    return {
        "alone_median_ms": statistics.median(alone),
        "four_p95_of_alone": four[int(0.95 * len(four))] / statistics.median(alone),
    }


def _disturb(load: Load, rng: random.Random, pause: float, kills: int, second: Any) -> list[float]:
    """Kill and drain; return the memory of the first server after each, MiB."""
    memory = []
    for number in range(kills):
        time.sleep(pause)
        memory.append(_memory(load.servers[0]))
        way = ("worker", "kill", "drain")[number % 3]
        load.counts[way] += 1
        if way == "worker":
            load.killed_at = time.monotonic()
            kill(rng.choice(descendants(load.servers[0].process.pid)))
            continue
        other = load.servers[1]
        if way == "kill":
            load.killed_at = time.monotonic()
            other.process.kill()
        else:
            other.process.send_signal(signal.SIGTERM)
        other.process.wait(60)
        load.servers[1] = second()
    time.sleep(pause)
    return [*memory, _memory(load.servers[0])]


def _memory(server: Server) -> float:
    status = Path(f"/proc/{server.process.pid}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024


def _check(load: Load, url: str) -> dict[str, Any]:
    """Wait for every job; return the counts of jobs, and the shares of the keys while all waited."""
    engine = sql.create_engine(url)
    columns = (JOBS.c.id, JOBS.c.owner, JOBS.c.status, JOBS.c.ends, JOBS.c.answer, JOBS.c.error)
    now = time.time()
    end = time.monotonic() + 900
    while True:
        with engine.connect() as connection:
            rows = connection.execute(sql.select(*columns, JOBS.c.finished)).all()
        if all(row.ends for row in rows):
            break
        assert time.monotonic() < end, [row for row in rows if not row.ends]
        time.sleep(1)
    engine.dispose()
    wrong = [(r.status, r.ends, r.error) for r in rows if r.ends != 1 or r.status != "done"]
    answers = {row.id: json.loads(row.answer or "{}") for row in rows}
    frames = {job: answer.get("facts", {}).get("frames", 0) for job, answer in answers.items()}
    others = [job for job, count in load.frames.items() if frames.get(job) != count]
    seconds: Counter[str] = Counter()
    for row in rows:
        if row.finished <= now:
            seconds[row.owner] += frames[row.id] / 30
    shares = {name: seconds[name] * len(NAMES) / seconds.total() for name in NAMES}
    return {
        "jobs": len(rows), "lost_or_twice": wrong, "without_row_or_of_another": others,
        "shares_of_an_equal_part": shares,
    }  # fmt: skip


def main() -> None:
    """Run from a command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.api.mixed")
    parser.add_argument("--minutes", type=float, default=120)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--beside", type=Path, default=ROOT, help="checkout of the second server")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="deitalk-mixed-") as data:
        report = run(given.minutes, given.kills, given.seed, given.beside, Path(data))
    sys.stdout.write(json.dumps(report, indent=1) + "\n")
    assert not report["lost_or_twice"] and not report["without_row_or_of_another"]
    assert not report["counts"].get("lost answers")


if __name__ == "__main__":
    main()
