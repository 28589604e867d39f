"""A real server in a process of its own, on a free port, for tests."""

import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import httpx

ROOT = Path(__file__).resolve().parents[2]
START_SECONDS = 900.0
PATIENCE = 300
"""Seconds for what a busy machine does late: a bound for what hangs; no test expects it to pass."""


def descendants(pid: int) -> list[int]:
    """Processes below one, of all its threads."""
    found, parents = [], [pid]
    while parents:
        parent = parents.pop()
        with suppress(OSError):
            for children in Path(f"/proc/{parent}/task").glob("*/children"):
                listed = [int(child) for child in children.read_text().split()]
                found += listed
                parents += listed
    return found


def processor_seconds(*pids: int) -> float:
    """Processor time of processes up to now."""
    ticks = 0
    for pid in pids:
        with suppress(OSError):  # it has ended
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


@dataclass
class Server:
    url: str
    process: "subprocess.Popen[bytes]"
    log: Path

    @property
    def address(self) -> tuple[str, int]:
        host, _, port = self.url.removeprefix("http://").partition(":")
        return host, int(port)

    def client(self, **given) -> httpx.Client:
        # without certificates, which take 25 ms to read and are not of HTTP
        plain = {"verify": False, "trust_env": False}
        return httpx.Client(base_url=self.url, timeout=PATIENCE, **plain, **given)

    @property
    def processor_seconds(self) -> float:
        """Of the server and its processes up to now."""
        return processor_seconds(self.process.pid, *descendants(self.process.pid))

    def metric(self, name: str, headers: dict[str, str] | None = None) -> float:
        """Value of a metric without labels, whose prefix is left out."""
        with self.client(headers=headers) as client:
            text = client.get("/metrics").text
        return float(re.search(rf"^deitalk_{name} (.*)$", text, re.M)[1])


def wait_for(check: Callable[[], bool], seconds: float = PATIENCE) -> None:
    """Wait until it is true; an AssertionError after some seconds."""
    end = time.monotonic() + seconds
    while not check():
        assert time.monotonic() < end, f"not within {seconds:g} s"
        time.sleep(0.02)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def start(
    data: Path, port: int | None = None, *, ready: bool = True, root: Path = ROOT, **settings
) -> Server:
    """Start a server of a checkout whose settings are variables of its environment."""
    port = port or free_port()
    given = {"workers": 1, "job_workers": 1, "data": data, "port": port} | settings
    environment = {k: v for k, v in os.environ.items() if not k.startswith("DEITALK_")}
    environment |= {f"DEITALK_{name.upper()}": str(value) for name, value in given.items()}
    environment |= {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(root), "PYTHONWARNINGS": "ignore"}
    data.mkdir(exist_ok=True)
    log = data / "server.log"
    with log.open("ab") as out:
        process = subprocess.Popen(
            [sys.executable, "-m", "deitalk", "serve"],
            cwd=root,  # `-m` looks there first
            env=environment,
            stdout=out,
            stderr=out,
        )
    server = Server(f"http://127.0.0.1:{port}", process, log)
    wait_until(server, "/readyz" if ready else "/healthz")
    return server


def wait_until(server: Server, path: str) -> None:
    end = time.monotonic() + START_SECONDS
    with server.client() as client:
        while time.monotonic() < end:
            assert server.process.poll() is None, server.log.read_text()
            with suppress(httpx.HTTPError):
                if client.get(path).is_success:
                    return
            time.sleep(0.1)
    raise AssertionError(f"no server: {server.log.read_text()}")


def stop(server: Server) -> None:
    if server.process.poll() is None:
        server.process.terminate()
        server.process.wait(120)


@contextmanager
def serving(data: Path, **settings) -> Iterator[Server]:
    server = start(data, **settings)
    try:
        yield server
    finally:
        stop(server)
