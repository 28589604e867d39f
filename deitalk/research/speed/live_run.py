"""`deitalk live --mic` as a whole, for hours.

``python -m deitalk.research.speed.live_run --minutes 120``.

The command runs in a process of its own with a stand-in for the microphone, whose clock differs
from the computer's, and sends to a socket here. A line of every period has the time from a frame's
sound to its datagram, and the memory and processor time of the command; the last line has the
drift. Frame k is k / 30 s after the microphone's first sample.
"""

import argparse
import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.research.arguments import new_file

SAMPLE = Path(__file__).resolve().parents[3] / "docs/samples/amiable.flac"
RATE, FPS = 48_000, 30
LOOK_AHEAD_MS = 199.0


class StandIn:
    """The part of sounddevice that the command needs; one input that repeats a sample."""

    PortAudioError = OSError

    def __init__(self, slower: float) -> None:
        import soxr

        from deitalk import load_audio

        self.slower = slower
        self.sound = soxr.resample(load_audio(SAMPLE).waveform, 16_000, RATE)

    def query_devices(self, device: Any, kind: str) -> dict[str, float]:
        """The input's rate."""
        return {"default_samplerate": float(RATE)}

    def InputStream(self, *, callback: Callable[..., None], blocksize: int, **options: Any) -> Any:
        """A stream whose blocks come in a thread, each when its last sample is due."""
        self.callback, self.size = callback, blocksize
        return self

    def start(self) -> None:
        """Begin, and print when."""
        threading.Thread(target=self._run, daemon=True).start()

    def close(self, *, ignore_errors: bool) -> None:
        """Nothing is to be let go."""

    def _run(self) -> None:
        start, count = time.monotonic(), 0
        period = self.size / RATE * (1 + self.slower)
        sys.stdout.write(f"{start}\n")
        sys.stdout.flush()
        while True:
            at = np.arange(count * self.size, (count + 1) * self.size) % len(self.sound)
            count += 1
            time.sleep(max(start + count * period - time.monotonic(), 0))
            self.callback(self.sound[at][:, None], self.size, None, None)


class Run:
    """The command, its datagrams, and what it uses.

    Parameters
    ----------
    slower : float
        How much longer a second of the microphone is than one of this computer, a share.
    backend : str
        ``torch`` or ``onnx``.
    """

    def __init__(self, slower: float, backend: str) -> None:
        self.slower = slower
        self.first: int | None = None
        self.delays: list[float] = []
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(30)
        port = str(self.socket.getsockname()[1])
        module = "deitalk.research.speed.live_run"
        command = [sys.executable, "-P", "-m", module, "--command", str(slower), port, backend]
        where = os.environ | {"OMP_NUM_THREADS": "1"}  # whatever is set here
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=where)
        assert self.process.stdout is not None
        self.start = float(self.process.stdout.readline())

    def receive(self, seconds: float) -> np.ndarray:
        """Delays of the frames that come in the next seconds, ms, one row of (number, delay)."""
        from rig.livelink import decode

        rows, end = [], time.monotonic() + seconds
        while (now := time.monotonic()) < end:
            frame = decode(self.socket.recv(2048)).frame
            now = time.monotonic()
            self.first = frame if self.first is None else self.first
            number = frame - self.first
            spoken = self.start + number / FPS * (1 + self.slower)
            rows.append((number, 1e3 * (now - spoken)))
        return np.array(rows)

    def memory(self) -> float:
        """Resident memory, MB."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        found = re.search(r"VmRSS:\s+(\d+)", status)
        return int(found[1]) / 1024 if found else 0.0

    def processor_seconds(self) -> float:
        """Processor time so far."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def close(self) -> None:
        """End the command."""
        self.process.terminate()
        self.process.wait()
        self.socket.close()


def measure(minutes: float, period: float, slower: float, backend: str) -> dict[str, Any]:
    """Run, print a line every `period` minutes, and return all of them."""
    run, periods, spent = Run(slower, backend), [], 0.0
    try:
        for _ in range(max(round(minutes / period), 1)):
            rows, used = run.receive(60 * period), run.processor_seconds()
            delays, expected = rows[:, 1], rows[-1, 0] - rows[0, 0] + 1
            periods.append(
                {
                    "median_ms": float(np.median(delays)),
                    "p99_ms": float(np.percentile(delays, 99)),
                    "most_ms": float(delays.max()),
                    "frames": int(expected),
                    "skipped": int(expected) - len(rows),
                    "megabytes": run.memory(),
                    "cores": (used - spent) / (60 * period),
                }
            )
            sys.stdout.write(f"{len(periods) * period:5.1f} min: {periods[-1]}\n")
            sys.stdout.flush()
            spent = used
    finally:
        run.close()
    medians = [row["median_ms"] for row in periods]
    seconds = 60 * period * max(len(medians) - 1, 1)
    whole = {
        "beyond_look_ahead_ms": float(np.median(medians)) - LOOK_AHEAD_MS,
        "p99_beyond_look_ahead_ms": max(row["p99_ms"] for row in periods) - LOOK_AHEAD_MS,
        "drift_frames_in_30_minutes": (medians[-1] - medians[0]) / 1e3 * FPS / seconds * 1800,
        "memory_growth_mb": periods[-1]["megabytes"] - periods[0]["megabytes"],
    }
    sys.stdout.write(f"{whole}\n")
    return {"backend": backend, "minutes": minutes, **whole, "periods": periods}


def command(slower: float, port: str, backend: str) -> None:
    """`deitalk live` with the stand-in."""
    sys.modules["sounddevice"] = StandIn(slower)  # type: ignore[assignment]
    sys.argv = ["deitalk", "live", "--mic", "--port", port, "-e", "happy", "--backend", backend]
    from deitalk.cli import main

    main()


def main() -> None:
    """Measure, or be the measured command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=120)
    parser.add_argument("--period", type=float, default=5, help="minutes")
    parser.add_argument("--ppm", type=float, default=100, help="difference of the clocks")
    parser.add_argument("--backend", default="torch", help="torch or onnx")
    parser.add_argument("--json", type=new_file, help="also write the measures to this file")
    parser.add_argument("--command", nargs=3, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.command:
        command(float(given.command[0]), *given.command[1:])
        return
    from deitalk.research.evaluation.benchmark_curves import machine
    from deitalk.research.evaluation.report import identified, write_json

    found = measure(given.minutes, given.period, 1e-6 * given.ppm, given.backend)
    write_json(given.json, identified("live") | {"machine": machine(), "threads": 1, **found})


if __name__ == "__main__":
    main()
