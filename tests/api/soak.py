"""Hours of mixed load on one server: memory, errors, jobs that are lost or carried out twice.

::

    python -m tests.api.soak                            # two hours at a quarter of a core
    python -m tests.api.soak --minutes 10 --share 1     # without pauses

Each round asks for results of several formats, a mesh, a moving picture, jobs that are waited for,
cancelled or deleted, a live session, and requests that are refused. The share of time in which the
server works on them is kept by pauses. The last line compares the memory of the last tenth of the
time with that of the second tenth, when every route has been used.
"""

import argparse
import itertools
import json
import os
import sqlite3
import statistics
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"

from websockets.sync.client import connect

from tests.api.conftest import wav
from tests.api.kill import wait
from tests.api.server import Server, descendants, start, stop

AUDIO = {"Content-Type": "audio/wav"}
FORMATS = ("csv", "take", "livelink", "json")
SAMPLE_SECONDS = 60.0
KEPT_MB = 20


def say(text: str) -> None:
    sys.stdout.write(f"{time.strftime('%H:%M:%S')} {text}\n")
    sys.stdout.flush()


def resident_mb(server: Server) -> float:
    """Memory of the server and its processes that is no file's; shared pages count in part."""
    total = 0
    for pid in (server.process.pid, *descendants(server.process.pid)):
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss_Anon:"):
                total += int(line.split()[1])
    return total / 1024


class Load:
    """Rounds of requests, with a count of each kind; every answer is checked."""

    def __init__(self, server: Server, table: Path) -> None:
        self.server, self.table, self.client = server, table, server.client()
        self.counts: Counter[str] = Counter()
        self.jobs: set[str] = set()

    def steps(self, number: int):
        """Yield the requests of one round, to be called."""
        for kind in FORMATS:
            yield lambda kind=kind: self.ask(kind, 1 + number % 5)
        yield lambda: self.refused(number)
        yield lambda: self.job(number)
        yield lambda: self.names()
        if number % 4 == 0:
            yield lambda: self.live("json" if number % 8 else "binary")
        if number % 10 == 0:
            yield lambda: self.ask("glb", 1, "/v1/meshes")
            yield lambda: self.other_jobs(number)
        if number % 40 == 0:
            yield lambda: self.ask("mp4", 1)

    def ask(self, kind: str, seconds: int, path: str = "/v1/animations") -> None:
        answer = self.client.post(
            f"{path}?format={kind}&emotion=happy", content=wav(seconds), headers=AUDIO
        )
        assert answer.status_code == 200, (kind, answer.text)
        if kind == "json":
            assert answer.json()["n_frames"] == 30 * seconds
        self.counts[kind] += 1

    def names(self) -> None:
        for path in ("/v1/models", "/v1/emotions", "/healthz", "/readyz", "/metrics", "/"):
            self.client.get(path).raise_for_status()
            self.counts["names"] += 1

    def refused(self, number: int) -> None:
        """Requests that are wrong, each in its own way."""
        cases = [
            ("/v1/animations", b"noise" * 999),
            ("/v1/animations?emotion=hungry", wav(1)),
            ("/v1/animations?model=none", wav(1)),
            ("/v1/animations?format=none", wav(1)),
            ("/v1/animations", wav(1)[:40]),
        ]
        path, body = cases[number % len(cases)]
        answer = self.client.post(path, content=body, headers=AUDIO)
        assert 400 <= answer.status_code < 500, (path, answer.status_code)
        self.counts["refused"] += 1

    def send(self, seconds: int, key: str) -> str:
        answer = self.client.post(
            "/v1/jobs?format=json", content=wav(seconds), headers=AUDIO | {"Idempotency-Key": key}
        )
        assert answer.status_code == 202, answer.text
        found: str = answer.json()["id"]
        return found

    def job(self, number: int) -> None:
        """A job sent twice with one key: one job, that ends once, with its own result."""
        seconds = 2 + number % 7
        job_id = self.send(seconds, f"soak-{number}")
        assert self.send(seconds, f"soak-{number}") == job_id and job_id not in self.jobs
        self.jobs.add(job_id)
        with self.client.stream("GET", f"/v1/jobs/{job_id}/events") as events:
            lines = [line for line in events.iter_lines() if line.startswith("data: ")]
        job = json.loads(lines[-1].removeprefix("data: "))
        assert job["status"] == "done", job
        assert self.client.get(job["result"]).json()["n_frames"] == 30 * seconds
        assert self.ends(job_id) == 1
        self.counts["jobs"] += 1

    def ends(self, job_id: str) -> int:
        with sqlite3.connect(self.table) as table:
            row = table.execute("SELECT ends FROM deitalk_jobs WHERE id = ?", (job_id,)).fetchone()
        return int(row[0])

    def other_jobs(self, number: int) -> None:
        """A job that is cancelled, and one that is deleted after its end."""
        for what in ("cancelled", "deleted"):
            job_id = self.send(3, f"soak-{what}-{number}")
            self.jobs.add(job_id)
            if what == "cancelled":
                self.client.post(f"/v1/jobs/{job_id}/cancel").raise_for_status()
            job = wait(self.client, job_id)
            assert job["status"] in ("cancelled", "done") and self.ends(job_id) == 1, job
            if what == "deleted":
                assert self.client.delete(f"/v1/jobs/{job_id}").status_code == 204
                assert self.client.get(f"/v1/jobs/{job_id}").status_code == 404
            self.counts[what] += 1

    def live(self, frames: str) -> None:
        """A live session of 2 s: 60 frames, each once."""
        host, port = self.server.address
        with connect(f"ws://{host}:{port}/v1/live", proxy=None, max_size=None) as session:
            session.send(json.dumps({"type": "start", "sample_rate": 16000, "frames": frames}))
            header = json.loads(session.recv())
            size = 16 + 4 * len(header["names"])
            session.send(wav(2)[44:])
            session.send(json.dumps({"type": "stop"}))
            n_frames = 0
            while True:
                message = session.recv()
                if isinstance(message, bytes):
                    assert len(message) % size == 0
                    n_frames += len(message) // size
                elif (found := json.loads(message))["type"] == "end":
                    break
                else:
                    n_frames += len(found["frames"])
        assert n_frames == found["frames"] == 60, (n_frames, found)
        self.counts["live"] += 1

    def check_table(self) -> None:
        """No job in the table that was not sent, none that has not ended once."""
        with sqlite3.connect(self.table) as table:
            rows = table.execute("SELECT id, ends FROM deitalk_jobs").fetchall()
        assert all(job_id in self.jobs and ends == 1 for job_id, ends in rows), rows


def soak(server: Server, table: Path, minutes: float, share: float) -> list[float]:
    """Load a server; return its memory, MB, at each minute."""
    load, memory = Load(server, table), []
    began = sampled = time.monotonic()
    for number in itertools.count():
        for step in load.steps(number):
            start_of_step = time.monotonic()
            step()
            now = time.monotonic()
            time.sleep((now - start_of_step) * (1 / share - 1))
            if now - sampled >= min(SAMPLE_SECONDS, minutes):
                sampled = now
                memory.append(resident_mb(server))
                say(f"{(now - began) / 60:.0f} min: {memory[-1]:.0f} MB, {dict(load.counts)}")
        if time.monotonic() - began > 60 * minutes:
            break
    load.check_table()
    load.client.close()
    say(f"{dict(load.counts)}; {len(load.jobs)} jobs accepted, each ended once")
    return memory


def main() -> None:
    """Run from a command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.api.soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=120)
    parser.add_argument("--share", type=float, default=0.25, help="of the time, 0 to 1")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        server = start(Path(folder), workers=1, keep_mb=KEPT_MB, requests_per_minute=1_000_000)
        try:
            memory = soak(server, Path(folder) / "jobs.sqlite", given.minutes, given.share)
        finally:
            stop(server)
    tenth = max(len(memory) // 10, 1)
    first, last = (statistics.median(part) for part in (memory[tenth : 2 * tenth], memory[-tenth:]))
    say(f"memory {first:.0f} MB in the second tenth of the time, {last:.0f} MB in the last "
        f"({100 * (last / first - 1):+.1f} %), at most {max(memory):.0f} MB")  # fmt: skip


if __name__ == "__main__":
    main()
